"""Convert a capture of photos to posed depth images: screening, structure from motion, and multi-view stereo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.parallax import require_parallax
from capture2vr.edge.cameras.screening import screen
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.masks import with_masks
from capture2vr.edge.capture.nouns import MIN_PHOTOS, Capture, Frame, Photo, PhotoVerdict, UpSource
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.photos.crop import crop_photo
from capture2vr.edge.photos.depth_maps import depth_frames
from capture2vr.edge.photos.gravity import gravity_up
from capture2vr.edge.photos.turntable import axis_up, mask_background, thing_box
from capture2vr.sentences.sentence import in_row, say

_ARMS_LENGTH = 0.6
"""Assumed metres from phone to object, for photos of unknown scale. The size of a cup or a chair is then right within a
factor of two or three: a start, not a measurement."""
_MASKED, _SCREENED, _ALIGNED = 0.01, 0.05, 0.35
"""Shares of the progress at which masking, screening and aligning end; the plane sweep takes the rest. Measured with 20
photos on two cores."""
_UNITLESS = say("poses_came_with_photos_tell")
_TURNTABLE_UP = UpSource("turntable", 0.95)  # 0.03 to 0.05 degrees on rendered turntables; real plates wobble
_CONTRADICTED = say("poses_came_with_photos_contradict")
_NAMED = 8
_COUNTED = {
    "blur": "count_blur",
    "dark": "count_dark",
    "duplicate": "count_duplicate",
    "no_overlap": "no_overlap",
    "unreadable": "count_unreadable",
}
"""Most photos that a sentence names."""
_TURNTABLE = say("thing_turns_in_front_still")


def to_depth(capture: Capture, *, device: str = "cpu", tick: Tick = no_tick) -> Capture:
    """Convert a capture of photos to kind "rgbd", with a verdict on every photo.

    device: where the plane sweep computes, "cpu" or a GPU as PyTorch names it.
    Poses that came with the photos keep their units, and where nothing tells what these are, the capture's
    `metres_per_unit` puts the object at arm's length; computed poses are scaled so.
    Poses that contradict the photos are not used.
    Raises CaptureError: CAPTURE_LOW_OVERLAP where the photos do not overlap enough, with what to shoot next;
    CAPTURE_DEGENERATE where the camera turned, but did not move.
    """
    masked, turntable, mask_warnings = _masked_photos(capture.photos, lambda part: tick(_MASKED * part))
    photos, refused = _screen_photos(masked, turntable, lambda part: tick(_MASKED + (_SCREENED - _MASKED) * part))
    if refused and len(photos) < MIN_PHOTOS:
        raise _too_few_photos(len(capture.photos), refused)
    try:
        alignment = _align(photos, lambda fraction: tick(_SCREENED + (_ALIGNED - _SCREENED) * fraction))
    except CaptureError as error:
        raise _with_refused(error, len(capture.photos), refused) from error
    require_parallax(alignment)
    if alignment.contradicted:
        capture = replace(capture, metres_per_unit=1.0, scale_confidence="unknown", up=None)
    metres_per_unit, unitless = capture.metres_per_unit, ""
    if alignment.contradicted or any(photo.camera_to_world is None for photo in photos):
        alignment = _scale_to_arms_length(alignment)
    elif capture.scale_confidence == "unknown":
        metres_per_unit, unitless = _ARMS_LENGTH / _median_reach(alignment), _UNITLESS
    frames = depth_frames(alignment, device=device, tick=lambda fraction: tick(_ALIGNED + (1 - _ALIGNED) * fraction))
    up, up_source = _which_way_is_up(capture, alignment, frames, turntable)
    verdicts = _sort_verdicts(capture, (*capture.verdicts, *refused, *alignment.verdicts))
    return replace(
        capture,
        kind="rgbd",
        photos=(),
        frames=frames,
        verdicts=verdicts,
        metres_per_unit=metres_per_unit,
        turntable=turntable,
        up=up,
        up_source=up_source,
        warnings=(
            *capture.warnings,
            *mask_warnings,
            *_unused_warning(verdicts),
            *((_CONTRADICTED,) if alignment.contradicted else ()),
            *alignment.warnings,
            *((unitless,) if unitless else ()),
            *((_TURNTABLE,) if turntable else ()),
        ),
    )


def _masked_photos(photos: Sequence[Photo], tick: Tick) -> tuple[tuple[Photo, ...], bool, tuple[str, ...]]:
    """Return the photos with their masks, or without a turntable's background; whether it is one; and warnings."""
    given, warnings = with_masks(photos, lambda _: tick(0.0))
    if any(photo.mask is not None for photo in given):
        return given, False, warnings
    masked = mask_background(given, tick)
    return masked or given, bool(masked), warnings


def _align(photos: Sequence[Photo], tick: Tick) -> Alignment:
    """Align the photos; where the poses that came with them cannot be used, without these."""
    try:
        return align(photos, tick=tick)
    except CaptureError as error:
        if any(photo.camera_to_world is None for photo in photos):
            raise
        try:
            computed = align([replace(photo, camera_to_world=None) for photo in photos], tick=tick)
        except CaptureError:
            raise error from None
        return replace(computed, contradicted=True)


def _which_way_is_up(
    capture: Capture, alignment: Alignment, frames: Sequence[Frame], turntable: bool
) -> tuple[Floats | None, UpSource]:
    """Return the unit vector (3,) against gravity and what told it: the turntable's axis, the capture, the photos."""
    axis = axis_up(frames) if turntable else None
    if axis is not None:
        return axis, _TURNTABLE_UP
    if capture.up is not None:
        return capture.up, capture.up_source
    return gravity_up(alignment.views) or (None, capture.up_source)


def _screen_photos(
    photos: Sequence[Photo], turntable: bool, tick: Tick
) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...]]:
    """Return the photos worth aligning, and verdicts on the others; on a turntable only the object is judged."""
    if not turntable:
        return screen(photos, tick=tick)
    box = thing_box(photos)
    accepted, refused = screen([crop_photo(photo, box) for photo in photos], tick=tick)
    names = {photo.name for photo in accepted}
    return tuple(photo for photo in photos if photo.name in names), refused


def _too_few_photos(count: int, refused: Sequence[PhotoVerdict]) -> CaptureError:
    """Return CAPTURE_LOW_OVERLAP for a capture of which screening left fewer than MIN_PHOTOS photos."""
    first = refused[0]
    reason = say("photos_cannot_be_used", refused=len(refused), count=count, kinds=_count_kinds(refused))
    return CaptureError("CAPTURE_LOW_OVERLAP", reason, file=first.name, hints=(first.advice,))


def _with_refused(error: CaptureError, count: int, refused: Sequence[PhotoVerdict]) -> CaptureError:
    """Return an error of the alignment, which knows only the photos that screening left, with why it left no more."""
    if not refused:
        return error
    before = say("photos_left_out_before", left=len(refused), count=count, kinds=_count_kinds(refused))
    return CaptureError(error.code, error.message, file=error.file, hints=(before, *error.hints))


def _scale_to_arms_length(alignment: Alignment) -> Alignment:
    """Scale so that the median distance between cameras and their points is `_ARMS_LENGTH`; first camera at 0."""
    scale, origin = _ARMS_LENGTH / _median_reach(alignment), alignment.views[0].camera_to_world[:3, 3]
    return replace(
        alignment,
        views=tuple(_rescale_view(view, origin, scale) for view in alignment.views),
        xyz=(alignment.xyz - origin) * scale,
    )


def _median_reach(alignment: Alignment) -> float:
    """Return the median distance between cameras and the points that they see."""
    eyes = np.stack([view.camera_to_world[:3, 3] for view in alignment.views])
    reach = np.linalg.norm(alignment.xyz[alignment.seen_point] - eyes[alignment.seen_view], axis=1)
    return float(np.median(reach))


def _rescale_view(view: PhotoView, origin: Floats, scale: float) -> PhotoView:
    """Return the view with its position relative to `origin`, scaled."""
    pose = view.camera_to_world.copy()
    pose[:3, 3] = (pose[:3, 3] - origin) * scale
    return replace(view, camera_to_world=pose)


def _sort_verdicts(capture: Capture, verdicts: Sequence[PhotoVerdict]) -> tuple[PhotoVerdict, ...]:
    """Sort verdicts in the order of the capture's photos, unreadable ones last."""
    place = {photo.name: number for number, photo in enumerate(capture.photos)}
    return tuple(sorted(verdicts, key=lambda verdict: place.get(verdict.name, len(place))))


def _unused_warning(verdicts: Sequence[PhotoVerdict]) -> tuple[str, ...]:
    """Return a warning about the photos that were not used, if any."""
    left = [verdict for verdict in verdicts if verdict.verdict != "ok"]
    if not left:
        return ()
    named = [verdict.name for verdict in left if verdict.verdict != "no_overlap"]  # the alignment's warning names those
    names, more = ", ".join(named[:_NAMED]), len(named) - _NAMED
    names = say("names_and_more", names=names, count=more) if more > 0 else names
    kinds = say("with_brackets", what=_count_kinds(left), names=names) if named else _count_kinds(left)
    return (say("photos_not_used", left=len(left), count=len(verdicts), kinds=kinds),)


def _count_kinds(verdicts: Sequence[PhotoVerdict]) -> str:
    """Count the kinds of verdicts, as "2 blur, 1 no overlap"."""
    count = Counter(verdict.verdict for verdict in verdicts)
    return in_row(", ", (say(_COUNTED[kind], count=number) for kind, number in count.most_common()))
