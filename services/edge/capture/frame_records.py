"""From what a format's reader found (shots) to a checked capture of frames; the checks are the same for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.capture.depth import ColourSource, DepthSource
from services.edge.capture.nouns import Capture, Frame, Intrinsics
from services.edge.capture.poses import Axes, checked_pose
from services.edge.errors import CaptureError

MAX_BAD_SHARE = 0.1  # of the frames whose pose or depth may be broken; they are dropped with a warning
_FOCAL_RANGE = (0.05, 50.0)  # of the image's longer side; 170 degrees of view to 1 degree
_FAR_M = 50.0  # metres; phones measure 5 m, so a median beyond this means another unit
_FRAMES_TO_WARN_OF = 3  # names in a warning; the rest is a number


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame as its format tells it, unchecked.

    intrinsics       at any resolution with the depth image's field of view
    camera_to_world  (3,4) or (4,4), translation in metres, in the axes that the reader names
    """

    name: str
    intrinsics: Intrinsics
    camera_to_world: Floats
    depth: DepthSource
    load_confidence: Callable[[], Floats] | None = None
    colour: ColourSource | None = None


def pinhole(fx_fy_cx_cy: Floats, size: tuple[int, int]) -> Intrinsics:
    """From (4,) pixels and the (width, height) of the image that they hold for."""
    fx, fy, cx, cy = (float(value) for value in fx_fy_cx_cy)
    return Intrinsics(fx, fy, cx, cy, *size)


def matrix_pinhole(k: Floats, size: tuple[int, int]) -> Intrinsics:
    """From a camera matrix (3,3), row-major."""
    return pinhole(k[[0, 1, 0, 1], [0, 1, 2, 2]], size)


def checked_intrinsics(intrinsics: Intrinsics, file: str) -> Intrinsics:
    """CAPTURE_BAD_INTRINSICS unless the focal length and the principal point are ones that a camera can have."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    width, height = intrinsics.width, intrinsics.height
    longer = max(width, height, 1)
    low, high = _FOCAL_RANGE
    focal = all(low * longer <= f <= high * longer for f in (fx, fy))  # NaN fails
    inside = -width < cx < 2 * width and -height < cy < 2 * height
    if width < 1 or height < 1 or not focal or not inside:
        what = (
            f"has a camera that cannot be: focal {fx:.4g} x {fy:.4g}, centre ({cx:.4g}, {cy:.4g}), {width} x {height}"
        )
        hint = ("the file's intrinsics are broken; export the capture again",)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=file, hints=hint)
    return intrinsics


def rgbd_capture(
    kind: str, shots: Sequence[Shot], *, axes: Axes, up: Floats | None, file: str, warnings: Sequence[str] = ()
) -> Capture:
    """Check every pose, camera and depth header, decode the first and the last depth image, and make the capture.

    kind  the format's name; up (3,) in the world of the poses, or None where the format does not tell;
    file  names the recording in errors that concern all of it.
    """
    if not shots:
        raise CaptureError("CAPTURE_EMPTY", "holds no frames with depth and pose", file=file)
    frames, dropped = _sound_frames(shots, axes)
    _check_sizes(frames)
    _check_depth(frames, file)
    return Capture(
        "rgbd",
        kind,
        frames=tuple(frames),
        scale_confidence="metric",
        up=up,
        warnings=(*warnings, *dropped, *_unit_warning(frames)),
    )


def _sound_frames(shots: Sequence[Shot], axes: Axes) -> tuple[list[Frame], list[str]]:
    """Frames whose pose and depth header are sound; the first error is raised when over MAX_BAD_SHARE are not."""
    frames: list[Frame] = []
    errors: list[CaptureError] = []
    colourless: list[CaptureError] = []
    for shot in shots:
        try:
            frames.append(_frame(shot, axes, colourless))
        except CaptureError as error:
            if error.code in ("IMAGE_TOO_LARGE", "CAPTURE_BAD_INTRINSICS"):
                raise
            errors.append(error)
    if len(errors) > MAX_BAD_SHARE * len(shots):
        raise errors[0]
    return frames, [*_told("frame skipped", errors), *_told("colours skipped", colourless)]


def _told(what: str, errors: Sequence[CaptureError]) -> list[str]:
    """The first few errors as warnings, and how many more there are."""
    more = len(errors) - _FRAMES_TO_WARN_OF
    told = [f"{what}: {error}" for error in errors[:_FRAMES_TO_WARN_OF]]
    return [*told, f"{what}: {more} more"] if more > 0 else told


def _frame(shot: Shot, axes: Axes, colourless: list[CaptureError]) -> Frame:
    pose = checked_pose(shot.camera_to_world, axes=axes, file=shot.name)
    width, height = shot.depth.size()
    camera = checked_intrinsics(shot.intrinsics, shot.name)
    if not _same_shape((width, height), (camera.width, camera.height)):
        what = f"is {width} x {height}, and its camera {camera.width} x {camera.height}: another shape"
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=shot.depth.file)
    scaled = camera.scaled_to(width, height)
    load_rgb = None
    try:
        load_rgb = _colour_loader(shot.colour, (width, height))
    except CaptureError as error:
        if error.code == "IMAGE_TOO_LARGE":
            raise
        colourless.append(error)  # a frame without colours still has its depth
    confidence = None if shot.load_confidence is None else partial(_fitted, shot.load_confidence, width, height)
    return Frame(shot.name, scaled, pose, shot.depth.load, confidence, load_rgb)


def _fitted(load: Callable[[], Floats], width: int, height: int) -> Floats:
    """Confidence at the depth image's size: apps that enlarge depth leave ARKit's confidence as it was."""
    confidence = load()
    rows = np.arange(height) * confidence.shape[0] // height
    columns = np.arange(width) * confidence.shape[1] // width
    return confidence if confidence.shape == (height, width) else confidence[rows[:, None], columns]


def _colour_loader(colour: ColourSource | None, depth_size: tuple[int, int]) -> Callable[[], Bytes] | None:
    if colour is None:
        return None
    width, height = colour.size()
    if not _same_shape((width, height), depth_size):
        what = f"is {width} x {height}, its depth {depth_size[0]} x {depth_size[1]}: another field of view"
        raise CaptureError("IMAGE_UNREADABLE", what, file=colour.file)
    return colour.load


def _same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether width to height agree within 2 %: scaling to 256 x 192 rounds to a pixel."""
    return abs(a[0] * b[1] - a[1] * b[0]) <= 0.02 * a[0] * b[1]


def _check_sizes(frames: Sequence[Frame]) -> None:
    first = frames[0].intrinsics
    for frame in frames:
        width, height = frame.intrinsics.width, frame.intrinsics.height
        if (width, height) != (first.width, first.height):
            what = f"has depth of {width} x {height}, others of {first.width} x {first.height}"
            raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=frame.name)


def _check_depth(frames: Sequence[Frame], file: str) -> None:
    """Decode the first and last depth image, and the middle one when those are empty."""
    measured = [_measures(frames[index]) for index in {0, len(frames) - 1}]
    if not any(measured) and not _measures(frames[len(frames) // 2]):
        hint = ("keep the thing within the sensor's range, 0.3 to 5 m",)
        raise CaptureError("CAPTURE_EMPTY", "its depth images hold no depth", file=file, hints=hint)


def _measures(frame: Frame) -> bool:
    """Whether the depth image, which must decode to the size in its header, knows any depth."""
    depth_m = frame.load_depth_m()
    if depth_m.shape != (frame.intrinsics.height, frame.intrinsics.width):
        what = f"decodes to {depth_m.shape[1]} x {depth_m.shape[0]}, not what its header says"
        raise CaptureError("IMAGE_UNREADABLE", what, file=frame.name)
    return bool((depth_m > 0).any())


def _unit_warning(frames: Sequence[Frame]) -> tuple[str, ...]:
    depth_m = frames[0].load_depth_m()
    median = float(np.median(depth_m[depth_m > 0])) if (depth_m > 0).any() else 0.0
    if median <= _FAR_M:
        return ()
    return (f"the median depth of the first frame is {median:.0f} m; its unit may be another",)


def matched(depths: int, others: int, *, file: str, what: str) -> None:
    """CAPTURE_COUNT_MISMATCH unless there are as many depth images as `others`: they pair by their order."""
    if depths != others:
        hint = ("send the whole recording, every file of it",)
        raise CaptureError(
            "CAPTURE_COUNT_MISMATCH", f"{depths} depth images and {others} {what}", file=file, hints=hint
        )


def mostly_matched(
    both: int, images: int, poses: int, *, file: str, what: str, of: str = "depth images"
) -> tuple[str, ...]:
    """Recordings stop raggedly: up to MAX_BAD_SHARE of one may lack the other, with a warning; more is a mismatch."""
    if both == 0 or max(images, poses) - both > max(1, MAX_BAD_SHARE * max(images, poses)):
        reason = f"{images} {of} and {poses} {what}, of which {both} belong together"
        hint = ("send the whole recording, every file of it",)
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=file, hints=hint)
    if both == images == poses:
        return ()
    return (f"{images} {of} and {poses} {what}; the {both} that belong together are used",)


def missing_warning(names: Sequence[str], what: str) -> tuple[str, ...]:
    """A sentence about files that a recording lists and does not hold."""
    if not names:
        return ()
    shown = ", ".join(names[:_FRAMES_TO_WARN_OF]) + (", ..." if len(names) > _FRAMES_TO_WARN_OF else "")
    return (f"{len(names)} {what} missing: {shown}",)


def no_poses(file: str, expected: str) -> CaptureError:
    hint = (f"send {expected} with the depth images; structure from motion is not run on them",)
    return CaptureError(
        "CAPTURE_NO_POSES", f"has depth images and no poses ({expected} is missing)", file=file, hints=hint
    )
