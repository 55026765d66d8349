"""Say which photos structure from motion could not place, and what to shoot next."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise

import numpy as np

from capture2vr.edge.arrays import Ints
from capture2vr.edge.cameras.learned_matches import is_installed
from capture2vr.edge.cameras.placement_attempts import ENOUGH, Attempt
from capture2vr.edge.capture.nouns import WALK_AROUND_ADVICE, Photo, PhotoVerdict
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

HOW_TO_SHOOT = say("with_textured_things_beside", advice=WALK_AROUND_ADVICE)
_UNTEXTURED = 100  # key points; a photo with fewer cannot be placed because of its own lack of texture
_SEEN_BY = 3.0
"""Mean number of photos that see a point, below which distances between cameras are hardly known: what only two see
tells a direction. Of photos ten degrees apart 3.6 to 5.5 do; of rendered ones 28 degrees apart, whose cameras came out
in wrong places, 2.3 to 2.9."""
_NAMED = 8  # most photos that a sentence names
_COULD_BE_INSTALLED = say("worker_with_extra_capture2vr_learned")


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
        return say("shows_too_little_texture_take")
    placed = attempt.answer.placed
    if not len(placed):
        return HOW_TO_SHOOT
    nearest = photos[int(placed[np.abs(placed - index).argmin()])].name
    return say("take_two_three_more_pictures", nearest=nearest)


def placement_warnings(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    """Return warnings that name the photos that could not be placed, and tell where the places of others are unsure."""
    return (*_left_out_warnings(photos, attempt), *_unsure_warnings(photos, attempt))


def _unsure_warnings(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    if _have_poses(photos):
        return ()
    if any(len(each.xy) > len(each.descriptors) for each in attempt.features):  # a network's, which it finds by pairs
        return ()
    seen_by = len(attempt.answer.seen_point) / max(len(attempt.answer.xyz), 1)
    return (say("places_seen_by_few_photos", seen_by=seen_by),) if seen_by < _SEEN_BY else ()


def _have_poses(photos: Sequence[Photo]) -> bool:
    return all(photo.camera_to_world is not None for photo in photos)


def _left_out_warnings(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    placed, count = attempt.answer.placed, len(photos)
    if len(placed) == count:
        return ()
    left_out = _names(photos, attempt.left_out)
    pieces = _pieces(attempt)
    if len(pieces) > 1:
        sizes = reduce(lambda first, more: say("one_and_more", what=first, more=more), map(str, pieces))
        what = say("photos_form_separate_groups_without", sizes=sizes)
        return (say("without_left_out", what=what, left_out=left_out), *_more_matches(attempt))
    return (
        say("only_photos_could_be_placed", placed=len(placed), count=count, names=left_out),
        *_more_matches(attempt),
    )


def _more_matches(attempt: Attempt) -> tuple[str, ...]:
    """Return sentences on why no more photos were placed: a further try failed, or the network, or it is missing."""
    failed = (say("further_try_to_place_photos", failed=attempt.failed),) if attempt.failed else ()
    if attempt.trouble:
        return (*failed, say("network_looks_more_matches_failed", trouble=attempt.trouble))
    return failed if is_installed() else (*failed, _COULD_BE_INSTALLED)


def _pieces(attempt: Attempt) -> list[int]:
    """Return the number of photos of each model, the largest first."""
    model_of = attempt.answer.model_of
    return [size for size in np.bincount(model_of[model_of >= 0]).tolist() if size]


def _names(photos: Sequence[Photo], chosen: Ints) -> str:
    """List the names of the chosen photos, at most _NAMED of them."""
    names = [photos[index].name for index in chosen[:_NAMED].tolist()]
    listed = ", ".join(names)
    more = len(chosen) - _NAMED
    return say("names_and_more", names=listed, count=more) if more > 0 else listed


def low_overlap(photos: Sequence[Photo], attempt: Attempt) -> CaptureError:
    """Return CAPTURE_LOW_OVERLAP: which photos could not be placed, where photos are missing, how to shoot."""
    placed = attempt.answer.placed
    left_out = attempt.left_out
    hints = (say("not_placed", names=_names(photos, left_out)), *_gaps(photos, attempt), HOW_TO_SHOOT)
    if _have_poses(photos):
        hints = (*hints, say("check_poses_belong_to_these"))
    hints = (*hints, *_more_matches(attempt))
    plain = sum(len(features.descriptors) < _UNTEXTURED for features in attempt.features)
    if plain > (1 - ENOUGH) * len(photos):
        hints = (say("photos_show_hardly_any_texture", count=plain), *hints)
    message = say("only_photos_overlap_enough", placed=len(placed), count=len(photos))
    return CaptureError("CAPTURE_LOW_OVERLAP", message, hints=hints)


def _gaps(photos: Sequence[Photo], attempt: Attempt) -> tuple[str, ...]:
    """Return hints where, in the order of the capture, one model ends and another begins."""
    model_of = attempt.answer.model_of.tolist()
    ends = [
        say("take_two_three_more_pictures_between", first=photos[first].name, second=photos[second].name)
        for first, second in pairwise(range(len(photos)))
        if model_of[first] != model_of[second]
    ]
    return tuple(ends[:_NAMED])
