"""Try to place photos by structure from motion, with ever more key points and pairs, until enough are placed.

SIFT comes first. Where it leaves photos out, a network looks for matches, if the extra `learned-matching` is installed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Ints, Tick, part_of
from capture2vr.edge.cameras.features import FAST, FINE, Features, SiftSettings, find_features, pixel_ratio
from capture2vr.edge.cameras.learned_matches import LONGEST_PX, find_matches, is_installed, with_learned
from capture2vr.edge.cameras.match_pairs import MANY, exhaustive, sequential, with_all
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem, SfmResult, solve
from capture2vr.edge.capture.nouns import FEW_PHOTOS, MIN_PHOTOS, Intrinsics, Photo
from capture2vr.edge.errors import EdgeError

_GOOD = 0.9  # share of the photos placed, from which on only the photos that were left out are tried again
ENOUGH = 0.6  # least share of the photos placed for the capture to be used, with a warning
_ENOUGH_OF_PIECES = 1 / 3  # least share of the largest model, where all models together have ENOUGH
_USUAL_FOCAL = 1.2  # initial focal length in longer sides; a phone's main camera has 0.7 to 0.8, the mapper corrects it
_FEATURES = 0.35  # share of a strategy's time that feature detection takes
_LEARNED = (0.95, 1.0)  # of the progress bar
_LEARNED_MATCHES = 0.8  # share of that part's time that the network takes; the mapper takes the rest


@dataclass(frozen=True, slots=True)
class _Strategy:
    """A strategy to align photos: feature settings and the pairs to match.

    share: start and end on the progress bar. Most captures need only the first strategy, which gets most of it."""

    setting: SiftSettings
    pairs: Callable[[int], Ints]
    share: tuple[float, float]


_STRATEGIES = (
    _Strategy(FAST, sequential, (0.0, 0.9)),
    _Strategy(FAST, exhaustive, (0.91, 0.92)),
    _Strategy(FINE, exhaustive, (0.92, 0.95)),
)
_WITHOUT_POSES = (0.9, 0.91)  # of the progress bar: the first strategy once more


@dataclass(frozen=True, slots=True)
class Attempt:
    """Result of one strategy; `features` are those that the answer's observations refer to.

    trouble       why the network that looks for more matches failed, or the mapper with these, "" where neither did
    failed        why a further strategy failed after one that had placed enough photos, "" where none did
    contradicted  whether the poses that came with the photos contradict them, and were not used
    """

    setting: SiftSettings
    features: Sequence[Features]
    pairs: Ints
    answer: SfmResult
    trouble: str = ""
    failed: str = ""
    contradicted: bool = False

    @property
    def share(self) -> float:
        """Share of the photos that the largest model placed."""
        return len(self.answer.placed) / len(self.features)

    @property
    def enough(self) -> bool:
        """Whether enough photos were placed for the capture to be used; of a few, whichever could be."""
        if MIN_PHOTOS <= len(self.answer.placed) <= len(self.features) <= FEW_PHOTOS:
            return True
        placed_somewhere = float((self.answer.model_of >= 0).mean())
        return self.share >= ENOUGH or (placed_somewhere >= ENOUGH and self.share >= _ENOUGH_OF_PIECES)

    @property
    def left_out(self) -> Ints:
        """The photos that the largest model did not place."""
        return np.setdiff1d(np.arange(len(self.features)), self.answer.placed)


def place(photos: Sequence[Photo], tick: Tick) -> Attempt:
    """Try the strategies in their order until one places enough photos (_GOOD); return the best result.

    Where that leaves a few photos out, they are matched with all others once more, by more key points; where that
    leaves any out, by a network. Poses that came with the photos are not used where the first strategy places too few
    by them, and nearly all without them. A strategy that fails does not lose what one before it has placed.
    """
    first, contradicted = _try(photos, _STRATEGIES[0], (), tick), False
    if not first.enough and _are_posed(photos):
        without_poses = [replace(photo, camera_to_world=None) for photo in photos]
        computed = _try(without_poses, replace(_STRATEGIES[0], share=_WITHOUT_POSES), first.features, tick)
        if contradicted := computed.share >= _GOOD:
            photos, first = without_poses, computed
    attempts = [first]
    failed = _try_further(photos, attempts, tick) or _try_left_out(photos, attempts, tick)
    best = _best(attempts)
    if best.share < 1 and is_installed():
        best = _try_learned(photos, best, tick)
    tick(1.0)
    return replace(best, contradicted=contradicted, failed=failed)


def _try_further(photos: Sequence[Photo], attempts: list[Attempt], tick: Tick) -> str:
    """Add attempts by the strategies after the first one, until one places enough photos (_GOOD).

    Returns why a strategy failed after one that had placed enough to be used, "" where none did. Raises EdgeError where
    one fails before that.
    """
    tried = {_identity(_STRATEGIES[0], len(photos))}
    for strategy in _STRATEGIES[1:]:
        identity = _identity(strategy, len(photos))
        if attempts[-1].share >= _GOOD or identity in tried:  # for few photos, sequential pairs are all pairs
            continue
        tried.add(identity)
        known = attempts[-1].features if attempts[-1].setting == strategy.setting else ()
        try:
            attempts.append(_try(photos, strategy, known, tick))
        except EdgeError as error:
            if not _best(attempts).enough:
                raise
            return error.message
    return ""


def _identity(strategy: _Strategy, count: int) -> tuple[SiftSettings, bytes]:
    """What makes a strategy another one than those before it, for so many photos."""
    return strategy.setting, strategy.pairs(count).tobytes()


def _try_left_out(photos: Sequence[Photo], attempts: list[Attempt], tick: Tick) -> str:
    """Add an attempt that matches the few photos that were left out with all others, by more key points.

    Returns why it failed, "" where it did not or is not worth while.
    """
    best = _best(attempts)
    if not _GOOD <= best.share < 1 or best.setting == FINE or len(photos) > MANY:
        return ""
    left_out = best.left_out
    strategy = _Strategy(FINE, lambda count: with_all(sequential(count), left_out, count), _STRATEGIES[-1].share)
    try:
        attempts.append(_try(photos, strategy, (), tick))
    except EdgeError as error:
        return error.message
    return ""


def _best(attempts: Sequence[Attempt]) -> Attempt:
    """Return the attempt that placed most photos; the first of equals."""
    return max(attempts, key=lambda attempt: attempt.share)


def _try(photos: Sequence[Photo], strategy: _Strategy, features: Sequence[Features], tick: Tick) -> Attempt:
    """Try a strategy; features: those of its setting, or () if they are to be found."""
    tick = part_of(tick, *strategy.share)
    features = features or find_features(photos, strategy.setting, part_of(tick, 0.0, _FEATURES))
    pairs = strategy.pairs(len(photos))
    answer = solve(_problem(photos, features, pairs, strategy.setting), part_of(tick, _FEATURES, 1.0))
    return Attempt(strategy.setting, features, pairs, answer)


def _try_learned(photos: Sequence[Photo], before: Attempt, tick: Tick) -> Attempt:
    """Try once more with what was matched before and with a network's matches.

    It matches the photos that were left out, or all of them where most were, as SIFT's own matches are then few.
    Returns `before` where that places no more photos, with its trouble where the network or the mapper fails."""
    tick = part_of(tick, *_LEARNED)
    try:
        wanted = before.left_out if before.share >= _GOOD else np.arange(len(photos))
        found = find_matches(photos, wanted, part_of(tick, 0.0, _LEARNED_MATCHES))
        if not len(found.table):
            return before
        features, table = with_learned(before.features, found)
        problem = _problem(photos, features, before.pairs, before.setting, table)
        answer = solve(problem, part_of(tick, _LEARNED_MATCHES, 1.0))
    except EdgeError as error:
        return replace(before, trouble=error.message)
    return _best([before, Attempt(before.setting, features, before.pairs, answer)])


def _problem(
    photos: Sequence[Photo],
    features: Sequence[Features],
    pairs: Ints,
    setting: SiftSettings,
    learned: Ints | None = None,
) -> SfmProblem:
    """Collect the solver's input."""
    longest = setting.longest if learned is None else min(setting.longest, LONGEST_PX)
    pixel = float(np.median([pixel_ratio(photo, longest) for photo in photos]))
    if _are_posed(photos):
        poses = [photo.camera_to_world for photo in photos if photo.camera_to_world is not None]
        given = [_given_lens(photo.intrinsics, photo.distortion) for photo in photos if photo.intrinsics is not None]
        known = np.array(poses, np.float64)
        return SfmProblem(tuple(given), np.arange(len(photos)), tuple(features), pairs, pixel, known, learned)
    thorough = setting == FINE or learned is not None  # by then the incremental mapper alone has failed
    lenses, lens_of = _initial_lenses(photos)
    return SfmProblem(lenses, lens_of, tuple(features), pairs, pixel, learned=learned, thorough=thorough)


def _are_posed(photos: Sequence[Photo]) -> bool:
    """Return whether every photo has a pose and intrinsics, without which given poses are not used."""
    return all(photo.camera_to_world is not None and photo.intrinsics is not None for photo in photos)


def _given_lens(intrinsics: Intrinsics, distortion: Sequence[float]) -> Lens:
    """Make a lens from given intrinsics; missing distortion coefficients are 0."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return Lens(intrinsics, (k1, k2, p1, p2, k3), known=True)


def _initial_lenses(photos: Sequence[Photo]) -> tuple[tuple[Lens, ...], Ints]:
    """Return the initial lens of each camera, and for each photo (N,) the number of its one."""
    cameras = list(dict.fromkeys(photo.camera for photo in photos))
    lenses = (_initial_lens([photo for photo in photos if photo.camera == camera]) for camera in cameras)
    return tuple(lenses), np.array([cameras.index(photo.camera) for photo in photos])


def _initial_lens(photos: Sequence[Photo]) -> Lens:
    """Return the initial lens for the photos of one camera: a focal length from the files, or the usual one."""
    width, height = photos[0].size
    focals = [photo.focal_px or (photo.intrinsics.fx if photo.intrinsics else None) for photo in photos]
    known = next((focal for focal in focals if focal), None)
    focal = known or _USUAL_FOCAL * max(width, height)
    intrinsics = Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    return Lens(intrinsics, known=known is not None)
