"""Check photos that come with camera intrinsics and poses, and build their capture; common to all such formats."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.frame_records import MAX_BAD_SHARE, checked_intrinsics, first_names
from capture2vr.edge.capture.images import same_shape
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo, PhotoVerdict, ScaleConfidence
from capture2vr.edge.capture.photos import evenly_spaced, left_out_warning, pictures, unreadable_verdict
from capture2vr.edge.capture.poses import Axes, checked_pose
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say


@dataclass(frozen=True, slots=True)
class GivenCamera:
    """Camera of a photo as read from a format, before it is checked.

    name             equal for all photos that share the lens
    intrinsics       for any resolution with the photo's aspect ratio
    distortion       OpenCV's (k1, k2, p1, p2, k3)
    camera_to_world  (4,4), in `axes`
    """

    name: str
    intrinsics: Intrinsics
    distortion: tuple[float, ...]
    camera_to_world: Floats
    axes: Axes


def with_camera(photo: Photo, given: GivenCamera) -> Photo:
    """Attach intrinsics and pose to a photo.

    Raises CAPTURE_BAD_POSE, and CAPTURE_BAD_INTRINSICS for intrinsics of another aspect ratio.
    """
    width, height = photo.size
    camera = given.intrinsics
    if not same_shape(photo.size, (camera.width, camera.height)):
        what = say("x_but_intrinsics_x_aspect", width=width, height=height, w=camera.width, h=camera.height)
        hint = (say("send_photos_from_poses_computed"),)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=photo.name, hints=hint)
    return replace(
        photo,
        camera=f"{given.name} {width} x {height}",
        focal_px=None,
        intrinsics=camera.scaled_to(width, height),
        distortion=given.distortion,
        camera_to_world=checked_pose(given.camera_to_world, axes=given.axes, file=photo.name),
    )


def with_app_camera(photo: Photo, intrinsics: Intrinsics, camera_to_world: Floats, axes: Axes) -> Photo:
    """Attach a scanning app's intrinsics and pose to a photo.

    The app gives no distortion. Its focus changes during the scan, so only photos of equal intrinsics share a camera.
    Raises what `with_camera` raises.
    """
    at = checked_intrinsics(intrinsics, photo.name)
    name = f"{at.fx:.2f} {at.cx:.2f} {at.cy:.2f}"
    return with_camera(photo, GivenCamera(name, at, (0.0,) * 5, camera_to_world, axes))


def unlisted_warning(folder: Folder, listed: Collection[str], file: str) -> tuple[str, ...]:
    """Return a warning about the photos beside the listed ones whose cameras `file` does not tell, if any."""
    places = set(map(posixpath.dirname, listed))
    left = [name for name in pictures(folder) if name not in listed and posixpath.dirname(name) in places]
    if not left:
        return ()
    return (say("photos_not_used_because_does", count=len(left), file=file, names=first_names(left)),)


def posed_capture(
    kind: str,
    tries: Sequence[Callable[[], Photo]],
    *,
    scale: ScaleConfidence = "unknown",
    up: Floats | None = None,
    warnings: Sequence[str] = (),
) -> Capture:
    """Build a capture from the photos that `tries` read, one per call: at most MAX_PHOTOS of them, evenly spaced.

    kind: the format's name; scale, up: as in `Capture`. Raises the first error when more than MAX_BAD_SHARE of the
    photos (and more than one) are broken.
    """
    photos, verdicts, dropped = _valid_photos(evenly_spaced(tries))
    everything = (*warnings, *left_out_warning(len(tries)), *dropped)
    return Capture("photos", kind, photos=photos, verdicts=verdicts, scale_confidence=scale, up=up, warnings=everything)


def _valid_photos(
    tries: Sequence[Callable[[], Photo]],
) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...], list[str]]:
    """Return the valid photos, verdicts on the unreadable ones, and warnings about broken poses."""
    photos: list[Photo] = []
    errors: list[CaptureError] = []
    for each in tries:
        try:
            photos.append(each())
        except CaptureError as error:
            errors.append(error)
    if len(errors) > max(1, MAX_BAD_SHARE * len(tries)) or not photos:
        raise errors[0]
    verdicts = tuple(unreadable_verdict(error) for error in errors if error.code.startswith("IMAGE"))
    return (
        tuple(photos),
        verdicts,
        [say("photo_skipped", why=error) for error in errors if not error.code.startswith("IMAGE")],
    )
