"""Photos that come with their cameras: the checks that are the same for every format that tells poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from services.edge.arrays import Floats
from services.edge.capture.nouns import Capture, Intrinsics, Photo, PhotoVerdict, ScaleConfidence
from services.edge.capture.photos import refused, spread, spread_warning
from services.edge.capture.poses import Axes, checked_pose
from services.edge.capture.shots import MAX_BAD_SHARE, checked_intrinsics
from services.edge.errors import CaptureError

_SAME_SHAPE = 0.02  # by which the sides' ratio may differ: copies at another scale have rounded sides


@dataclass(frozen=True, slots=True)
class GivenCamera:
    """What a format says of the camera of a photo, unchecked.

    name             the same for all photos that share the lens
    intrinsics       at any resolution of the photo's shape
    distortion       OpenCV's (k1, k2, p1, p2, k3)
    camera_to_world  (4,4), in the axes named
    """

    name: str
    intrinsics: Intrinsics
    distortion: tuple[float, ...]
    camera_to_world: Floats
    axes: Axes


def posed(photo: Photo, given: GivenCamera) -> Photo:
    """The photo with its camera. Raises CAPTURE_BAD_INTRINSICS for another shape, and CAPTURE_BAD_POSE."""
    width, height = photo.size
    camera = given.intrinsics
    if abs(camera.width * height - width * camera.height) > _SAME_SHAPE * camera.width * height:
        what = f"is {width} x {height}, and its camera {camera.width} x {camera.height}: another shape"
        hint = ("send the photos that the poses were made from",)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=photo.name, hints=hint)
    return replace(
        photo,
        camera=f"{given.name} {width} x {height}",
        focal_px=None,
        intrinsics=camera.scaled_to(width, height),
        distortion=given.distortion,
        camera_to_world=checked_pose(given.camera_to_world, axes=given.axes, file=photo.name),
    )


def app_camera(photo: Photo, intrinsics: Intrinsics, camera_to_world: Floats, axes: Axes) -> Photo:
    """The photo with its camera as a scanning app tells it: without distortion, and the lens refocused on the way.

    Raises what `posed` raises.
    """
    at = checked_intrinsics(intrinsics, photo.name)
    name = f"{at.fx:.2f} {at.cx:.2f} {at.cy:.2f}"
    return posed(photo, GivenCamera(name, at, (0.0,) * 5, camera_to_world, axes))


def posed_capture(
    kind: str,
    tries: Sequence[Callable[[], Photo]],
    *,
    scale: ScaleConfidence = "unknown",
    up: Floats | None = None,
    warnings: Sequence[str] = (),
) -> Capture:
    """Of a format's photos, each read by its call: at most MAX_PHOTOS of them, spread evenly.

    kind, scale, up: as `Capture` has them. Of more errors than one and than MAX_BAD_SHARE, the first is raised.
    """
    photos, verdicts, dropped = _sound_photos(spread(tries))
    told = (*warnings, *spread_warning(len(tries)), *dropped)
    return Capture("photos", kind, photos=photos, verdicts=verdicts, scale_confidence=scale, up=up, warnings=told)


def _sound_photos(
    tries: Sequence[Callable[[], Photo]],
) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...], list[str]]:
    """The photos, verdicts on those that cannot be read, and warnings of broken poses."""
    photos: list[Photo] = []
    errors: list[CaptureError] = []
    for each in tries:
        try:
            photos.append(each())
        except CaptureError as error:
            errors.append(error)
    if len(errors) > max(1, MAX_BAD_SHARE * len(tries)) or not photos:
        raise errors[0]
    verdicts = tuple(refused(error) for error in errors if error.code.startswith("IMAGE"))
    return (
        tuple(photos),
        verdicts,
        [f"photo skipped: {error}" for error in errors if not error.code.startswith("IMAGE")],
    )
