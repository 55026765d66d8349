"""Compute camera poses and sparse points of photos by structure from motion, in a child process.

Where every photo comes with its pose, only the points are triangulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.capture.nouns import MIN_PHOTOS, WALK_AROUND_ADVICE, Intrinsics, Photo, PhotoVerdict
from services.edge.errors import CaptureError
from services.edge.photos.features import FAST, FINE, Features, SiftSettings, find_features, pixel_ratio
from services.edge.photos.match_pairs import MANY, exhaustive, sequential, with_all
from services.edge.photos.nouns import Alignment, PhotoView
from services.edge.photos.sfm_process import Lens, SfmProblem, SfmResult, solve

_GOOD = 0.9  # share of the photos placed, from which on only the photos that were left out are tried again
_ENOUGH = 0.6  # least share of the photos placed for the capture to be used, with a warning
_ENOUGH_OF_PIECES = 1 / 3  # least share of the largest model, where all models together have _ENOUGH
_USUAL_FOCAL = 1.2  # initial focal length in longer sides; a phone's main camera has 0.7 to 0.8, the mapper corrects it
_FEATURES = 0.35  # share of a strategy's time that feature detection takes
_UNTEXTURED = 100  # key points; a photo with fewer cannot be placed because of its own lack of texture
_NAMED = 8  # most photos that a sentence names
_HOW_TO_SHOOT = f"{WALK_AROUND_ADVICE}, with textured things beside it"


@dataclass(frozen=True, slots=True)
class _Strategy:
    """A strategy to align photos: feature settings and the pairs to match.

    share: start and end on the progress bar. Most captures need only the first strategy, which gets most of it."""

    setting: SiftSettings
    pairs: Callable[[int], Ints]
    share: tuple[float, float]


_STRATEGIES = (
    _Strategy(FAST, sequential, (0.0, 0.9)),
    _Strategy(FAST, exhaustive, (0.9, 0.94)),
    _Strategy(FINE, exhaustive, (0.94, 1.0)),
)


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Result of one strategy."""

    setting: SiftSettings
    features: Sequence[Features]
    answer: SfmResult

    @property
    def share(self) -> float:
        """Share of the photos that the largest model placed."""
        return len(self.answer.placed) / len(self.features)

    @property
    def enough(self) -> bool:
        """Whether enough photos were placed for the capture to be used."""
        placed_somewhere = float((self.answer.model_of >= 0).mean())
        return self.share >= _ENOUGH or (placed_somewhere >= _ENOUGH and self.share >= _ENOUGH_OF_PIECES)


def align(photos: Sequence[Photo], *, tick: Tick = no_tick) -> Alignment:
    """Compute cameras and sparse points of photos, in units of the given poses, or else of the first two cameras.

    Where all photos have intrinsics and camera_to_world these are kept, and only the points are triangulated.
    Raises CaptureError CAPTURE_LOW_OVERLAP, EdgeError ALIGN_FAILED, and what `tick` and `Photo.load` raise.
    """
    if len(photos) < MIN_PHOTOS:
        reason = f"the capture has only {len(photos)} photos; at least {MIN_PHOTOS} are needed"
        raise CaptureError("CAPTURE_LOW_OVERLAP", reason, hints=(_HOW_TO_SHOOT,))
    attempt = _try_strategies(photos, tick)
    if not attempt.enough:
        raise _low_overlap(photos, attempt)
    return _alignment(photos, attempt)


def _try_strategies(photos: Sequence[Photo], tick: Tick) -> _Attempt:
    """Try the strategies in their order until one places enough photos (_GOOD); return the best result.

    Where that leaves a few photos out, they are matched with all others once more, by more key points.
    """
    attempts: list[_Attempt] = []
    tried: set[tuple[SiftSettings, bytes]] = set()
    for strategy in _STRATEGIES:
        pairs = strategy.pairs(len(photos))
        if (strategy.setting, pairs.tobytes()) in tried:  # for few photos, sequential pairs are all pairs
            continue
        tried.add((strategy.setting, pairs.tobytes()))
        known = attempts[-1].features if attempts and attempts[-1].setting == strategy.setting else ()
        attempts.append(_try(photos, strategy, known, tick))
        if attempts[-1].share >= _GOOD:
            break
    best = max(attempts, key=lambda attempt: attempt.share)
    if _GOOD <= best.share < 1 and best.setting != FINE and len(photos) <= MANY:
        left_out = np.setdiff1d(np.arange(len(photos)), best.answer.placed)
        strategy = _Strategy(FINE, lambda count: with_all(sequential(count), left_out, count), _STRATEGIES[-1].share)
        attempts.append(_try(photos, strategy, (), tick))
    tick(1.0)
    return max(attempts, key=lambda attempt: attempt.share)


def _try(photos: Sequence[Photo], strategy: _Strategy, features: Sequence[Features], tick: Tick) -> _Attempt:
    """Try a strategy; features: those of its setting, or () if they are to be found."""
    features = features or find_features(photos, strategy.setting, _part_tick(tick, strategy, 0.0, _FEATURES))
    problem = _problem(photos, features, strategy.pairs(len(photos)), strategy.setting)
    return _Attempt(strategy.setting, features, solve(problem, _part_tick(tick, strategy, _FEATURES, 1.0)))


def _part_tick(tick: Tick, strategy: _Strategy, low: float, high: float) -> Tick:
    """Return a tick for a part, `low` to `high`, of a strategy's share of the progress bar."""
    start, end = strategy.share
    return lambda fraction: tick(start + (end - start) * (low + (high - low) * fraction))


def _problem(photos: Sequence[Photo], features: Sequence[Features], pairs: Ints, setting: SiftSettings) -> SfmProblem:
    """Collect the solver's input; given poses are used only if every photo has pose and intrinsics."""
    pixel = float(np.median([pixel_ratio(photo, setting) for photo in photos]))
    poses = [photo.camera_to_world for photo in photos if photo.camera_to_world is not None]
    given = [_given_lens(photo.intrinsics, photo.distortion) for photo in photos if photo.intrinsics is not None]
    if len(poses) == len(given) == len(photos):
        return SfmProblem(
            tuple(given), np.arange(len(photos)), tuple(features), pairs, pixel, np.array(poses, np.float64)
        )
    cameras = list(dict.fromkeys(photo.camera for photo in photos))
    lenses = [_initial_lens([photo for photo in photos if photo.camera == camera]) for camera in cameras]
    lens_of = np.array([cameras.index(photo.camera) for photo in photos])
    return SfmProblem(tuple(lenses), lens_of, tuple(features), pairs, pixel)


def _given_lens(intrinsics: Intrinsics, distortion: Sequence[float]) -> Lens:
    """Make a lens from given intrinsics; missing distortion coefficients are 0."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return Lens(intrinsics, (k1, k2, p1, p2, k3), known=True)


def _initial_lens(photos: Sequence[Photo]) -> Lens:
    """Return the initial lens for the photos of one camera: a focal length from the files, or the usual one."""
    width, height = photos[0].size
    focals = [photo.focal_px or (photo.intrinsics.fx if photo.intrinsics else None) for photo in photos]
    known = next((focal for focal in focals if focal), None)
    focal = known or _USUAL_FOCAL * max(width, height)
    intrinsics = Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    return Lens(intrinsics, known=known is not None)


def _alignment(photos: Sequence[Photo], attempt: _Attempt) -> Alignment:
    """Convert the solver's answer to an `Alignment`, with verdicts and warnings."""
    answer = attempt.answer
    views = tuple(
        PhotoView(photos[photo], lens.intrinsics, lens.distortion, pose)
        for photo, lens, pose in zip(answer.placed.tolist(), answer.lenses, answer.poses, strict=True)
    )
    return Alignment(
        views,
        answer.xyz,
        answer.seen_point,
        answer.seen_view,
        _error_px(views, attempt),
        _verdicts(photos, attempt),
        _warnings(photos, attempt),
    )


def _error_px(views: Sequence[PhotoView], attempt: _Attempt) -> float:
    """Return the mean reprojection error, in pixels of the pictures that features were found in."""
    answer = attempt.answer
    distances = []
    for number, view in enumerate(views):
        mine = answer.seen_view == number
        observed = attempt.features[answer.placed[number]].xy[answer.seen_feature[mine]]
        offset = project(view, answer.xyz[answer.seen_point[mine]]) - observed
        distances.append(np.linalg.norm(offset, axis=1) / pixel_ratio(view.photo, attempt.setting))
    return float(np.concatenate(distances).mean())


def project(view: PhotoView, xyz: Floats) -> Floats:
    """Project points (K,3) to pixels (K,2) of the stored photo."""
    at, world_to_camera = view.intrinsics, np.linalg.inv(view.camera_to_world)
    turn, _ = cv2.Rodrigues(world_to_camera[:3, :3])
    matrix = np.array([[at.fx, 0, at.cx], [0, at.fy, at.cy], [0, 0, 1]])
    xy, _ = cv2.projectPoints(xyz, turn, world_to_camera[:3, 3], matrix, np.array(view.distortion))
    return np.asarray(xy, np.float64).reshape(-1, 2)


def _verdicts(photos: Sequence[Photo], attempt: _Attempt) -> tuple[PhotoVerdict, ...]:
    """Return a verdict on every photo: ok, or no overlap with advice."""
    placed = attempt.answer.placed
    return tuple(
        PhotoVerdict(photo.name, "ok")
        if index in placed
        else PhotoVerdict(photo.name, "no_overlap", _advice(photos, attempt, index))
        for index, photo in enumerate(photos)
    )


def _advice(photos: Sequence[Photo], attempt: _Attempt, index: int) -> str:
    """Return advice on what to shoot so that a photo that was left out can be placed."""
    if len(attempt.features[index].xy) < _UNTEXTURED:
        return "it shows too little texture: take it again in good light, with more of the surroundings in view"
    placed = attempt.answer.placed
    if not len(placed):
        return _HOW_TO_SHOOT
    nearest = photos[int(placed[np.abs(placed - index).argmin()])].name
    return f"take two or three more pictures between {nearest} and this one, each overlapping the last by two thirds"


def _warnings(photos: Sequence[Photo], attempt: _Attempt) -> tuple[str, ...]:
    """Return a warning that names the photos that could not be placed, if any."""
    placed, count = attempt.answer.placed, len(photos)
    if len(placed) == count:
        return ()
    left_out = _names(photos, np.setdiff1d(np.arange(count), placed))
    pieces = _pieces(attempt)
    if len(pieces) > 1:
        sizes = " and ".join(str(size) for size in pieces)
        what = f"the photos form separate groups of {sizes} without overlap; only the largest was used"
        return (f"{what}, without {left_out}",)
    return (f"only {len(placed)} of {count} photos could be placed; these could not: {left_out}",)


def _pieces(attempt: _Attempt) -> list[int]:
    """Return the number of photos of each model, the largest first."""
    model_of = attempt.answer.model_of
    return [size for size in np.bincount(model_of[model_of >= 0]).tolist() if size]


def _names(photos: Sequence[Photo], chosen: Ints) -> str:
    """List the names of the chosen photos, at most _NAMED of them."""
    names = [photos[index].name for index in chosen[:_NAMED].tolist()]
    more = f" and {len(chosen) - _NAMED} more" if len(chosen) > _NAMED else ""
    return ", ".join(names) + more


def _low_overlap(photos: Sequence[Photo], attempt: _Attempt) -> CaptureError:
    """Return CAPTURE_LOW_OVERLAP: which photos could not be placed, where photos are missing, how to shoot."""
    placed = attempt.answer.placed
    left_out = np.setdiff1d(np.arange(len(photos)), placed)
    hints = (f"not placed: {_names(photos, left_out)}", *_gaps(photos, attempt), _HOW_TO_SHOOT)
    if all(photo.camera_to_world is not None for photo in photos):
        hints = (*hints, "check that the poses belong to these photos, and that they are camera-to-world")
    plain = sum(len(features.xy) < _UNTEXTURED for features in attempt.features)
    if plain > (1 - _ENOUGH) * len(photos):
        hints = (f"{plain} photos show hardly any texture, as sky, mirrors, glass and plain walls do not", *hints)
    message = f"only {len(placed)} of {len(photos)} photos overlap enough to be placed"
    return CaptureError("CAPTURE_LOW_OVERLAP", message, hints=hints)


def _gaps(photos: Sequence[Photo], attempt: _Attempt) -> tuple[str, ...]:
    """Return hints where, in the order of the capture, one model ends and another begins."""
    model_of = attempt.answer.model_of.tolist()
    ends = [
        f"take two or three more pictures between {photos[first].name} and {photos[second].name}"
        for first, second in pairwise(range(len(photos)))
        if model_of[first] != model_of[second]
    ]
    return tuple(ends[:_NAMED])
