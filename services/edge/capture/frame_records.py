"""Check the frames that a format's reader found (`FrameRecord`) and build an RGB-D capture; common to all formats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.depth import ColourSource, DepthSource, ImageColour, confidence_image, depth_file
from capture2vr.edge.capture.files import MAX_FILES, Folder, unreadable
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, ShownPicture
from capture2vr.edge.capture.poses import Axes, checked_pose
from capture2vr.edge.capture.upright_places import StoredPlaces
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import in_row, say

MAX_BAD_SHARE = 0.1  # of the frames may have a broken pose or depth; they are dropped with a warning
_FOCAL_RANGE = (0.05, 50.0)  # focal length over the image's longer side: a field of view of 170 degrees to 1 degree
_FAR_M = 50.0  # metres; phones measure up to 5 m, so a larger median depth means another unit
_NAME_LETTERS = 200  # of a file's name in a warning; a hostile list has names of megabytes
_FRAMES_TO_WARN_OF = 3  # files that a warning names; of the others it gives the number


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One frame as read from a format, before it is checked.

    intrinsics       for images of any resolution with the depth image's field of view
    camera_to_world  (3,4) or (4,4), translation in metres, in the axes that the reader names
    """

    name: str
    intrinsics: Intrinsics
    camera_to_world: Floats
    depth: DepthSource
    load_confidence: Callable[[], Floats] | None = None
    colour: ColourSource | None = None


def frame_of_files(
    folder: Folder,
    depth: str,
    camera: Intrinsics,
    camera_to_world: Floats,
    metres_per_step: float,
    *,
    colour: str | None = None,
    confidence: str | None = None,
) -> FrameRecord:
    """Make the record of a frame whose depth, colours and ARKit confidence are files of their own."""
    return FrameRecord(
        depth,
        camera,
        camera_to_world,
        depth_file(folder.path(depth), depth, metres_per_step),
        None if confidence is None else partial(confidence_image, folder.path(confidence), confidence),
        None if colour is None else ImageColour(folder.path(colour), colour),
    )


def pinhole(fx_fy_cx_cy: Floats, size: tuple[int, int]) -> Intrinsics:
    """Make intrinsics from (4,) fx, fy, cx, cy in pixels, and the image's (width, height)."""
    fx, fy, cx, cy = (float(value) for value in fx_fy_cx_cy)
    return Intrinsics(fx, fy, cx, cy, *size)


def matrix_pinhole(k: Floats, size: tuple[int, int]) -> Intrinsics:
    """Make intrinsics from a camera matrix (3,3), and the image's (width, height)."""
    return pinhole(k[[0, 1, 0, 1], [0, 1, 2, 2]], size)


def image_dimensions(width: float, height: float, file: str) -> tuple[int, int]:
    """Return width and height as `file` has them; CAPTURE_UNREADABLE for what no image can have."""
    if not (1 <= width <= 1e6 and 1 <= height <= 1e6):
        raise unreadable(file, say("has_impossible_image_size_x", width=width, height=height))
    return int(width), int(height)


def checked_intrinsics(intrinsics: Intrinsics, file: str) -> Intrinsics:
    """Return the intrinsics; raise CAPTURE_BAD_INTRINSICS for an impossible focal length or principal point."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    width, height = intrinsics.width, intrinsics.height
    longer = max(width, height, 1)
    low, high = _FOCAL_RANGE
    focal = all(low * longer <= f <= high * longer for f in (fx, fy))  # NaN fails
    inside = -width < cx < 2 * width and -height < cy < 2 * height
    if width < 1 or height < 1 or not focal or not inside:
        what = say("has_impossible_camera_intrinsics_focal", fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)
        hint = (say("export_capture_again_intrinsics_broken"),)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=file, hints=hint)
    return intrinsics


def rgbd_capture(
    kind: str, records: Sequence[FrameRecord], *, axes: Axes, up: Floats | None, file: str, warnings: Sequence[str] = ()
) -> Capture:
    """Check every pose, camera and depth header, decode the first and the last depth image, and build the capture.

    kind  the format's name; up (3,) in the world of the poses, or None where the format does not define it;
    file  is named in errors about the recording as a whole.
    """
    if not records:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_frames_with_both"), file=file)
    if len(records) > MAX_FILES:  # a list that names one image again and again: each entry is checked anew
        hints = (say("send_fewer_frames_example_every"),)
        raise CaptureError("CAPTURE_TOO_LARGE", say("has_more_than_frames", most=MAX_FILES), file=file, hints=hints)
    frames, dropped = _valid_frames(records, axes)
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


def _valid_frames(records: Sequence[FrameRecord], axes: Axes) -> tuple[list[Frame], list[str]]:
    """Return the frames with a valid pose and depth header, and warnings about the others.

    Raises the first error when more than MAX_BAD_SHARE of the frames are broken.
    """
    frames: list[Frame] = []
    errors: list[CaptureError] = []
    colourless: list[CaptureError] = []
    for record in records:
        try:
            frames.append(_frame(record, axes, colourless))
        except CaptureError as error:
            if error.code in ("IMAGE_TOO_LARGE", "CAPTURE_BAD_INTRINSICS"):
                raise
            errors.append(error)
    if len(errors) > MAX_BAD_SHARE * len(records):
        raise errors[0]
    return frames, [*as_warnings(say("frame_skipped"), errors), *as_warnings(say("colours_skipped"), colourless)]


def as_warnings(what: str, errors: Sequence[CaptureError]) -> list[str]:
    """Return the first few errors as warnings, and the number of the others."""
    more = len(errors) - _FRAMES_TO_WARN_OF
    warnings: list[str] = [in_row(": ", (what, error.sentence)) for error in errors[:_FRAMES_TO_WARN_OF]]
    return [*warnings, say("and_more_of_kind", what=what, count=more)] if more > 0 else warnings


def _frame(record: FrameRecord, axes: Axes, colourless: list[CaptureError]) -> Frame:
    """Check one record and make its frame; an unreadable colour image is added to `colourless`, not raised."""
    pose = checked_pose(record.camera_to_world, axes=axes, file=record.name)
    width, height = record.depth.size()
    camera = checked_intrinsics(record.intrinsics, record.name)
    if not _same_shape((width, height), (camera.width, camera.height)):
        what = say("x_but_intrinsics_x_aspect", width=width, height=height, w=camera.width, h=camera.height)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=record.depth.file)
    scaled = camera.scaled_to(width, height)
    load_rgb = None
    try:
        load_rgb = _colour_loader(record.colour, (width, height))
    except CaptureError as error:
        if error.code == "IMAGE_TOO_LARGE":
            raise
        colourless.append(error)  # a frame without colours still has its depth
    confidence = (
        None if record.load_confidence is None else partial(_resized_confidence, record.load_confidence, width, height)
    )
    shown = _shown_picture(record.colour) if load_rgb else None
    return Frame(record.name, scaled, pose, record.depth.load, confidence, load_rgb, shown=shown)


def _shown_picture(colour: ColourSource | None) -> ShownPicture | None:
    """Return the picture that a person sees of a frame whose colours are a file of their own."""
    if not isinstance(colour, ImageColour):
        return None
    return ShownPicture(colour.file, StoredPlaces(colour.path, colour.file))


def _resized_confidence(load: Callable[[], Floats], width: int, height: int) -> Floats:
    """Load the confidence and resize it to the depth image's size: apps that enlarge depth keep ARKit's confidence."""
    confidence = load()
    rows = np.arange(height) * confidence.shape[0] // height
    columns = np.arange(width) * confidence.shape[1] // width
    return confidence if confidence.shape == (height, width) else confidence[rows[:, None], columns]


def _colour_loader(colour: ColourSource | None, depth_size: tuple[int, int]) -> Callable[[], Bytes] | None:
    """Return the function that loads the colours, after checking that they have the depth image's aspect ratio."""
    if colour is None:
        return None
    width, height = colour.size()
    if not _same_shape((width, height), depth_size):
        what = say("x_but_depth_x_aspect", width=width, height=height, w=depth_size[0], h=depth_size[1])
        raise CaptureError("IMAGE_UNREADABLE", what, file=colour.file)
    return colour.load


def _same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Return whether two sizes have the same aspect ratio within 2 %: scaling to 256 x 192 rounds to a pixel."""
    return abs(a[0] * b[1] - a[1] * b[0]) <= 0.02 * a[0] * b[1]


def _check_sizes(frames: Sequence[Frame]) -> None:
    """Raise CAPTURE_BAD_INTRINSICS unless all depth images have the same size."""
    first = frames[0].intrinsics
    for frame in frames:
        width, height = frame.intrinsics.width, frame.intrinsics.height
        if (width, height) != (first.width, first.height):
            what = say("has_depth_image_x_first", width=width, height=height, w=first.width, h=first.height)
            raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=frame.name)


def _check_depth(frames: Sequence[Frame], file: str) -> None:
    """Raise CAPTURE_EMPTY when no depth image has depth, CAPTURE_DEGENERATE when all have one value at every pixel.

    The first and the last are decoded; the others only until one has depth that differs. Raises the first error when
    more than MAX_BAD_SHARE of them cannot be decoded; fewer are passed over, here as when the frames are used.
    """
    broken: list[CaptureError] = []
    ranges = [_depth_range_m(frames[place], broken) for place in sorted({0, len(frames) - 1})]
    for frame in frames[1:-1]:
        if len(broken) > MAX_BAD_SHARE * len(frames):
            raise broken[0]
        if any(low < high for low, high in ranges):
            return
        ranges.append(_depth_range_m(frame, broken))
    if len(broken) > MAX_BAD_SHARE * len(frames):
        raise broken[0]
    if not any(high > 0 for _, high in ranges):
        hint = (say("record_again_keep_thing_within"),)
        raise CaptureError("CAPTURE_EMPTY", say("has_depth_images_in_every"), file=file, hints=hint)
    if all(low == high for low, high in ranges):
        what = say("has_depth_images_say_m", depth=max(ranges)[1])
        hints = (say("record_again_with_app_saves"), say("send_pictures_alone_as_photos"))
        raise CaptureError("CAPTURE_DEGENERATE", what, file=file, hints=hints)


def _depth_range_m(frame: Frame, broken: list[CaptureError]) -> tuple[float, float]:
    """Return the least and the largest depth, 0 for both without any.

    The error of a damaged image is added to `broken`. Raises IMAGE_UNREADABLE for a size unlike the header's.
    """
    try:
        depth_m = frame.load_depth_m()
    except CaptureError as error:
        broken.append(error)
        return 0.0, 0.0
    if depth_m.shape != (frame.intrinsics.height, frame.intrinsics.width):
        header = f"{frame.intrinsics.width} x {frame.intrinsics.height}"
        what = say("decodes_to_x_pixels", width=depth_m.shape[1], height=depth_m.shape[0], header=header)
        raise CaptureError("IMAGE_UNREADABLE", what, file=frame.name)
    known = depth_m[depth_m > 0]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)


def _unit_warning(frames: Sequence[Frame]) -> tuple[str, ...]:
    """Return a warning when the first frame is so far away that its depth is probably not in the expected unit."""
    try:
        depth_m = frames[0].load_depth_m()
    except CaptureError:  # it is damaged, which is said when the frames are used
        return ()
    median = float(np.median(depth_m[depth_m > 0])) if (depth_m > 0).any() else 0.0
    if median <= _FAR_M:
        return ()
    return (say("median_depth_first_frame_m", depth=median),)


def without_poses(capture: Capture) -> Capture:
    """Remove the placeholder poses (identity) of a capture without a trajectory, which only passed the checks."""
    return replace(capture, frames=tuple(replace(frame, camera_to_world=None) for frame in capture.frames))


def check_counts_match(depths: int, others: int, *, file: str, what: str) -> None:
    """Raise CAPTURE_COUNT_MISMATCH unless there are as many depth images as `others`, which pair by their order."""
    if depths != others:
        hint = (say("send_whole_recording_every_file"),)
        raise CaptureError(
            "CAPTURE_COUNT_MISMATCH",
            say("depth_images", depths=depths, others=others, what=what),
            file=file,
            hints=hint,
        )


def check_mostly_paired(
    both: int, images: int, poses: int, *, file: str, what: str, of: str = say("word_depth_images")
) -> tuple[str, ...]:
    """Return a warning when some images have no pose or the reverse: recordings often lose a few at their end.

    Raises CAPTURE_COUNT_MISMATCH when more than MAX_BAD_SHARE (and more than one) have no partner.
    """
    if both == 0 or max(images, poses) - both > max(1, MAX_BAD_SHARE * max(images, poses)):
        reason = say("but_only_match_each_other", images=images, of=of, poses=poses, what=what, both=both)
        hint = (say("send_whole_recording_every_file"),)
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=file, hints=hint)
    if both == images == poses:
        return ()
    return (say("only_match_each_other_used", images=images, of=of, poses=poses, what=what, both=both),)


def missing_warning(names: Sequence[str], what: str) -> tuple[str, ...]:
    """Return a warning about files that a recording lists but does not contain; none for an empty list."""
    if not names:
        return ()
    return (say("missing_of_kind", count=len(names), what=what, names=first_names(names)),)


def first_names(names: Sequence[str]) -> str:
    """Return the first names of a list, for a warning, and dots where there are more."""
    more = ", ..." if len(names) > _FRAMES_TO_WARN_OF else ""
    return ", ".join(name[:_NAME_LETTERS] for name in names[:_FRAMES_TO_WARN_OF]) + more


def no_poses(file: str, expected: str) -> CaptureError:
    """Return a CAPTURE_NO_POSES error; `expected` is the missing file or row."""
    hint = (say("send_with_depth_images_format", expected=expected),)
    return CaptureError("CAPTURE_NO_POSES", say("depth_images_but_no_camera", expected=expected), file=file, hints=hint)
