"""Make the best of two to eight photos: of what structure from motion cannot place, one becomes a relief.

A relief is a guess, and says so: which photo it is of, why the others were not used, and what would make it measured.
Where some photos are placed, these are used as ever, and the others are named with what they are still good for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture.nouns import FEW_PHOTOS, Capture, Photo, PhotoVerdict
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.edge.single_photo.proposal import merit
from capture2vr.order.photo_box import WHOLE, PhotoBox
from capture2vr.sentences.sentence import in_row, say

_MISPLACED = frozenset(
    {
        "CAPTURE_LOW_OVERLAP",
        "CAPTURE_DEGENERATE",
        "CAPTURE_TOO_FEW_POINTS",
        "CAPTURE_NOTHING_LEFT",
        "ALIGN_FAILED",
    }
)
"""What says that photos gave no shape; all else, such as a broken file or a full disk, ends a job."""
_PLAIN = 0.05
"""Least merit of a cut-out that is worth a relief: below it, nothing in the photo stands out."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A photo, and how much the object in it stands out; 0 where none is found."""

    photo: Photo
    merit: float


def depth_or_guess(
    capture: Capture,
    *,
    box: PhotoBox | None = None,
    models: ModelFolder | None = None,
    device: str = "cpu",
    tick: Tick = no_tick,
) -> Capture:
    """Convert a capture of photos to posed depth images, as `to_depth`; of a few that nothing places, choose one.

    The answer is of kind "rgbd", or of kind "image" with the photo that a relief is to be made of: the one that the
    rectangle is in, else the one whose object stands out most. Raises what `to_depth` raises where there are more than
    a few photos, or no photo shows an object.
    """
    try:
        placed = to_depth(capture, device=device, tick=tick)
    except EdgeError as error:
        return guess_instead(capture, error, box=box, models=models)
    return _with_best_use(placed, capture.photos, models) if _are_few(capture) else placed


def guess_instead(
    capture: Capture, error: EdgeError, *, box: PhotoBox | None = None, models: ModelFolder | None = None
) -> Capture:
    """Return the capture of one of a few photos, of kind "image", where `error` says that they gave no shape.

    Raises the error itself where that is no remedy: for many photos, for other errors, and where no photo shows an
    object.
    """
    if not _are_few(capture) or error.code not in _MISPLACED:
        raise error
    best = _clearest(capture.photos, error, box, models)
    name = best.photo.name
    others = [photo.name for photo in capture.photos if photo is not best.photo]
    chosen = say("relief_of_marked_photo" if box else "relief_of_clearest_photo", name=name)
    warning = say(
        "few_photos_became_relief",
        count=len(capture.photos),
        why=error.message,
        chosen=chosen,
        others=", ".join(others),
    )
    return replace(
        capture,
        kind="image",
        photos=(best.photo,),
        verdicts=(
            *(_verdict_on(photo, best.photo, capture) for photo in capture.photos),
            *(each for each in capture.verdicts if each.verdict == "unreadable"),
        ),
        warnings=(*capture.warnings, warning),
    )


def _clearest(
    photos: Sequence[Photo], error: EdgeError, box: PhotoBox | None, models: ModelFolder | None
) -> _Candidate:
    """The photo that a person marked, or whose object stands out most. Raises the error where none shows an object."""
    asked = [photo for photo in photos if box is None or photo.name == box.photo]
    best = max(_candidates(asked, box, models), key=lambda each: each.merit)
    if not best.merit:
        hints = (*error.hints, say("none_of_few_photos_shows_object"))
        raise CaptureError(error.code, error.message, file=error.file, hints=hints) from error
    return best


def _are_few(capture: Capture) -> bool:
    """Whether a capture is of two to eight photos: no frames of a video, and no views of a panorama."""
    whole = all(photo.part == WHOLE.values for photo in capture.photos)
    return capture.format == "photos" and whole and 1 < len(capture.photos) <= FEW_PHOTOS


def _verdict_on(photo: Photo, best: Photo, capture: Capture) -> PhotoVerdict:
    if photo is best:
        return PhotoVerdict(photo.name, "ok")
    return PhotoVerdict(photo.name, "no_overlap", say("shares_too_little_with_others", count=len(capture.photos)))


def _candidates(photos: Sequence[Photo], box: PhotoBox | None, models: ModelFolder | None) -> list[_Candidate]:
    return [_Candidate(photo, _merit_of(photo, box, models)) for photo in photos]


def _merit_of(photo: Photo, box: PhotoBox | None, models: ModelFolder | None) -> float:
    """How much the object in a photo stands out, over 0; 0 where there is none, or the photo cannot be read."""
    try:
        cut = cut_out(photo, box, models=models)
    except CaptureError:
        return 0.0
    return 1e-9 + merit(cut.rgb, cut.mask)


def _with_best_use(placed: Capture, photos: Sequence[Photo], models: ModelFolder | None) -> Capture:
    """Tell of the photos that were not placed which may still become the relief of a side, and name them."""
    by_name = {photo.name: photo for photo in photos}
    unplaced = [by_name[each.name] for each in placed.verdicts if each.verdict == "no_overlap" and each.name in by_name]
    useful = {each.photo.name for each in _candidates(unplaced, None, models) if each.merit > _PLAIN}
    if not useful:
        return placed
    verdicts = tuple(
        replace(each, advice=in_row("; ", (each.advice, say("sent_alone_it_becomes_relief"))))
        if each.name in useful
        else each
        for each in placed.verdicts
    )
    named = ", ".join(each.name for each in verdicts if each.name in useful)
    told = say("unplaced_best_used_as_front", names=named)
    return replace(placed, verdicts=verdicts, warnings=(*placed.warnings, told))
