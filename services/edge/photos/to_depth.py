"""A capture of photos -> the same capture as posed depth images, which the rest of the pipeline knows already."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from services.edge.arrays import Floats, Tick, no_tick
from services.edge.capture.nouns import MIN_PHOTOS, Capture, Photo, PhotoVerdict
from services.edge.errors import CaptureError
from services.edge.photos.align import align
from services.edge.photos.crop import cropped
from services.edge.photos.depths import depth_frames
from services.edge.photos.nouns import Alignment, View
from services.edge.photos.screen import screen
from services.edge.photos.turntable import axis_up, thing_box, without_background

_ARMS_LENGTH = 0.6
"""Metres from a phone to the thing that it is pointed at, for photos that nothing tells the scale of: a cup and a chair
come out within a factor of two or three, which is a place to start from and no measurement."""
_MASKED, _SCREENED, _ALIGNED = 0.01, 0.05, 0.35
"""Where on the bar masking, screening and aligning end; the sweep takes the rest. From 20 photos on two cores."""
_TURNTABLE = "A turntable: the still background was left out."


def to_depth(capture: Capture, *, device: str = "cpu", tick: Tick = no_tick) -> Capture:
    """The capture of kind "rgbd" that its photos show, with a verdict on every photo.

    device: where the plane sweep computes, "cpu" or a GPU as PyTorch names it.
    Poses that came with the photos keep their units; solved ones are scaled so that the thing is at arm's length.
    Raises CaptureError: CAPTURE_LOW_OVERLAP where the photos do not hang together, with what to shoot next.
    """
    taken = without_background(capture.photos, lambda fraction: tick(_MASKED * fraction))
    turned = bool(taken)
    photos, refused = _screened(taken or capture.photos, lambda part: tick(_MASKED + (_SCREENED - _MASKED) * part))
    if refused and len(photos) < MIN_PHOTOS:
        raise _too_few(len(capture.photos), refused)
    aligned = align(photos, tick=lambda fraction: tick(_SCREENED + (_ALIGNED - _SCREENED) * fraction))
    if any(photo.camera_to_world is None for photo in photos):
        aligned = _at_arms_length(aligned)
    frames = depth_frames(aligned, device=device, tick=lambda fraction: tick(_ALIGNED + (1 - _ALIGNED) * fraction))
    up = axis_up(frames) if turned else None
    verdicts = _in_order(capture, (*capture.verdicts, *refused, *aligned.verdicts))
    return replace(
        capture,
        kind="rgbd",
        photos=(),
        frames=frames,
        verdicts=verdicts,
        turntable=turned,
        up=capture.up if up is None else up,
        warnings=(*capture.warnings, *_told(verdicts), *aligned.warnings, *((_TURNTABLE,) if turned else ())),
    )


def _screened(photos: Sequence[Photo], tick: Tick) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...]]:
    """The photos that are worth aligning; where a still background is masked, the thing alone decides."""
    if all(photo.mask is None for photo in photos):
        return screen(photos, tick=tick)
    box = thing_box(photos)
    kept, refused = screen([cropped(photo, box) for photo in photos], tick=tick)
    names = {photo.name for photo in kept}
    return tuple(photo for photo in photos if photo.name in names), refused


def _too_few(count: int, refused: Sequence[PhotoVerdict]) -> CaptureError:
    first = refused[0]
    reason = f"of {count} photos {len(refused)} are of no use: {_kinds(refused)}"
    return CaptureError("CAPTURE_LOW_OVERLAP", reason, file=first.name, hints=(first.advice,))


def _at_arms_length(aligned: Alignment) -> Alignment:
    """Scaled so that the median point is `_ARMS_LENGTH` from those that saw it; the first camera at the origin."""
    eyes = np.stack([view.camera_to_world[:3, 3] for view in aligned.views])
    reach = np.linalg.norm(aligned.xyz[aligned.seen_point] - eyes[aligned.seen_view], axis=1)
    scale, origin = _ARMS_LENGTH / float(np.median(reach)), eyes[0]
    return replace(
        aligned, views=tuple(_moved(view, origin, scale) for view in aligned.views), xyz=(aligned.xyz - origin) * scale
    )


def _moved(view: View, origin: Floats, scale: float) -> View:
    pose = view.camera_to_world.copy()
    pose[:3, 3] = (pose[:3, 3] - origin) * scale
    return replace(view, camera_to_world=pose)


def _in_order(capture: Capture, verdicts: Sequence[PhotoVerdict]) -> tuple[PhotoVerdict, ...]:
    """In the order of the capture's files, the unreadable ones last."""
    place = {photo.name: number for number, photo in enumerate(capture.photos)}
    return tuple(sorted(verdicts, key=lambda verdict: place.get(verdict.name, len(place))))


def _told(verdicts: Sequence[PhotoVerdict]) -> tuple[str, ...]:
    left = [verdict for verdict in verdicts if verdict.verdict != "ok"]
    if not left:
        return ()
    return (f"{len(left)} of {len(verdicts)} photos were not used: {_kinds(left)}.",)


def _kinds(verdicts: Sequence[PhotoVerdict]) -> str:
    """As "2 blur, 1 no overlap"."""
    count = Counter(verdict.verdict.replace("_", " ") for verdict in verdicts)
    return ", ".join(f"{number} {kind}" for kind, number in count.most_common())
