"""Say which photos structure from motion could not place, and what to shoot next."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from capture2vr.edge.arrays import Ints
from capture2vr.edge.cameras.learned_matches import is_installed
from capture2vr.edge.cameras.placement_attempts import ENOUGH, Attempt
from capture2vr.edge.capture.nouns import WALK_AROUND_ADVICE, Photo, PhotoVerdict
from capture2vr.edge.errors import CaptureError

HOW_TO_SHOOT = f"{WALK_AROUND_ADVICE}, with textured things beside it"
_UNTEXTURED = 100  # key points; a photo with fewer cannot be placed because of its own lack of texture
_NAMED = 8  # most photos that a sentence names
_COULD_BE_INSTALLED = (
    "a worker with the extra capture2vr[learned-matching] installed looks for more matches by a network, which helps "
    "where there is little texture, or a wide step between photos"
)


def verdicts_on(photos: Sequence[Photo], attempt: Attempt) -> tuple[PhotoVerdict, ...]:
    """Return a verdict on every photo: ok, or no overlap with advice."""
    placed = attempt.answer.placed
    return tuple(
        PhotoVerdict(photo.name, "ok")
        if index in placed
        else PhotoVerdict(photo.name, "no_overlap", _advice(photos, attempt, index))
        for index, photo in enumerate(photos)
    )


def _advice(photos: Sequence[Photo], attempt: Attempt, index: int) -> str:
    """Return advice on what to shoot so that a photo that was left out can be placed."""
    if len(attempt.features[index].descriptors) < _UNTEXTURED:
        return "it shows too little texture: take it again in good light, with more of the surroundings in view"
    placed = attempt.answer.placed
    if not len(placed):
        return HOW_TO_SHOOT
    nearest = photos[int(placed[np.abs(placed - index).argmin()])].name
    return f"take two or three more pictures between {nearest} and this one, each overlapping the last by two thirds"


def placement_warnings(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    """Return a warning that names the photos that could not be placed, if any."""
    placed, count = attempt.answer.placed, len(photos)
    if len(placed) == count:
        return ()
    left_out = _names(photos, attempt.left_out)
    pieces = _pieces(attempt)
    if len(pieces) > 1:
        sizes = " and ".join(str(size) for size in pieces)
        what = f"the photos form separate groups of {sizes} without overlap; only the largest was used"
        return (f"{what}, without {left_out}", *_more_matches(attempt))
    return (
        f"only {len(placed)} of {count} photos could be placed; these could not: {left_out}",
        *_more_matches(attempt),
    )


def _more_matches(attempt: Attempt) -> tuple[str, ...]:
    """Return sentences on why no more photos were placed: a further try failed, or the network, or it is missing."""
    failed = (f"a further try to place photos failed: {attempt.failed}",) if attempt.failed else ()
    if attempt.trouble:
        return (*failed, f"the network that looks for more matches failed: {attempt.trouble}")
    return failed if is_installed() else (*failed, _COULD_BE_INSTALLED)


def _pieces(attempt: Attempt) -> list[int]:
    """Return the number of photos of each model, the largest first."""
    model_of = attempt.answer.model_of
    return [size for size in np.bincount(model_of[model_of >= 0]).tolist() if size]


def _names(photos: Sequence[Photo], chosen: Ints) -> str:
    """List the names of the chosen photos, at most _NAMED of them."""
    names = [photos[index].name for index in chosen[:_NAMED].tolist()]
    more = f" and {len(chosen) - _NAMED} more" if len(chosen) > _NAMED else ""
    return ", ".join(names) + more


def low_overlap(photos: Sequence[Photo], attempt: Attempt) -> CaptureError:
    """Return CAPTURE_LOW_OVERLAP: which photos could not be placed, where photos are missing, how to shoot."""
    placed = attempt.answer.placed
    left_out = attempt.left_out
    hints = (f"not placed: {_names(photos, left_out)}", *_gaps(photos, attempt), HOW_TO_SHOOT)
    if all(photo.camera_to_world is not None for photo in photos):
        hints = (*hints, "check that the poses belong to these photos, and that they are camera-to-world")
    hints = (*hints, *_more_matches(attempt))
    plain = sum(len(features.descriptors) < _UNTEXTURED for features in attempt.features)
    if plain > (1 - ENOUGH) * len(photos):
        hints = (f"{plain} photos show hardly any texture, as sky, mirrors, glass and plain walls do not", *hints)
    message = f"only {len(placed)} of {len(photos)} photos overlap enough to be placed"
    return CaptureError("CAPTURE_LOW_OVERLAP", message, hints=hints)


def _gaps(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    """Return hints where, in the order of the capture, one model ends and another begins."""
    model_of = attempt.answer.model_of.tolist()
    ends = [
        f"take two or three more pictures between {photos[first].name} and {photos[second].name}"
        for first, second in pairwise(range(len(photos)))
        if model_of[first] != model_of[second]
    ]
    return tuple(ends[:_NAMED])
