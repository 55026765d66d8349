"""Photos -> cameras: structure from motion in a child process, or triangulation where every photo knows its pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.capture.nouns import AROUND, MIN_PHOTOS, Intrinsics, Photo, PhotoVerdict
from services.edge.errors import CaptureError
from services.edge.photos.features import FAST, FINE, Features, Setting, find_features, pixel_of
from services.edge.photos.nouns import Alignment, View
from services.edge.photos.pairs import exhaustive, sequential
from services.edge.photos.solve import Answer, Lens, Problem, solve

_GOOD = 0.9  # share of the photos placed with which nothing more is tried
_ENOUGH = 0.6  # share with which the capture is used, with a warning
_ENOUGH_OF_PIECES = 1 / 3  # share that the largest piece must hold where the pieces together hold _ENOUGH
_USUAL_FOCAL = 1.2  # longer sides; a phone's main camera has 0.7 to 0.8, and the mapper finds its way from either side
_FEATURES = 0.35  # of a rung's time goes into the key points
_UNTEXTURED = 100  # key points below which a photo itself is why it cannot be placed
_NAMED = 8  # photos that a sentence names at most
_AROUND = f"{AROUND}, with textured things beside it"


@dataclass(frozen=True, slots=True)
class _Rung:
    """One way to try. share: its part of the progress bar; most captures need only the first, which gets nearly all."""

    setting: Setting
    pairs: Callable[[int], Ints]
    share: tuple[float, float]


_LADDER = (
    _Rung(FAST, sequential, (0.0, 0.9)),
    _Rung(FAST, exhaustive, (0.9, 0.94)),
    _Rung(FINE, exhaustive, (0.94, 1.0)),
)


@dataclass(frozen=True, slots=True)
class _Attempt:
    """What one rung gave."""

    setting: Setting
    features: Sequence[Features]
    answer: Answer

    @property
    def share(self) -> float:
        return len(self.answer.placed) / len(self.features)

    @property
    def enough(self) -> bool:
        placed_somewhere = float((self.answer.model_of >= 0).mean())
        return self.share >= _ENOUGH or (placed_somewhere >= _ENOUGH and self.share >= _ENOUGH_OF_PIECES)


def align(photos: Sequence[Photo], *, tick: Tick = no_tick) -> Alignment:
    """Cameras and sparse points of the photos, in units of the given poses, or else of the first two cameras.

    Where all photos have intrinsics and camera_to_world these are kept, and only the points are found.
    Raises CaptureError CAPTURE_LOW_OVERLAP, EdgeError ALIGN_FAILED, and what `tick` and `Photo.load` raise.
    """
    if len(photos) < MIN_PHOTOS:
        raise CaptureError("CAPTURE_LOW_OVERLAP", f"holds {len(photos)} photos of {MIN_PHOTOS}", hints=(_AROUND,))
    attempt = _climb(photos, tick)
    if not attempt.enough:
        raise _low_overlap(photos, attempt)
    return _alignment(photos, attempt)


def _climb(photos: Sequence[Photo], tick: Tick) -> _Attempt:
    """The first attempt that is good, or the best of all."""
    attempts: list[_Attempt] = []
    features: list[Features] = []
    tried: set[tuple[Setting, bytes]] = set()
    for rung in _LADDER:
        pairs = rung.pairs(len(photos))
        if (rung.setting, pairs.tobytes()) in tried:  # few photos are held against each other at once
            continue
        tried.add((rung.setting, pairs.tobytes()))
        if not attempts or attempts[-1].setting != rung.setting:
            features = find_features(photos, rung.setting, _between(tick, rung, 0.0, _FEATURES))
        problem = _problem(photos, features, pairs, rung.setting)
        answer = solve(problem, _between(tick, rung, _FEATURES, 1.0))
        attempts.append(_Attempt(rung.setting, features, answer))
        if attempts[-1].share >= _GOOD:
            break
    tick(1.0)
    return max(attempts, key=lambda attempt: attempt.share)


def _between(tick: Tick, rung: _Rung, low: float, high: float) -> Tick:
    """The tick of a part of a rung."""
    start, end = rung.share
    return lambda fraction: tick(start + (end - start) * (low + (high - low) * fraction))


def _problem(photos: Sequence[Photo], features: Sequence[Features], pairs: Ints, setting: Setting) -> Problem:
    pixel = float(np.median([pixel_of(photo, setting) for photo in photos]))
    poses = [photo.camera_to_world for photo in photos if photo.camera_to_world is not None]
    given = [_given_lens(photo.intrinsics, photo.distortion) for photo in photos if photo.intrinsics is not None]
    if len(poses) == len(given) == len(photos):
        return Problem(tuple(given), np.arange(len(photos)), tuple(features), pairs, pixel, np.array(poses, np.float64))
    cameras = list(dict.fromkeys(photo.camera for photo in photos))
    lenses = [_first_guess([photo for photo in photos if photo.camera == camera]) for camera in cameras]
    lens_of = np.array([cameras.index(photo.camera) for photo in photos])
    return Problem(tuple(lenses), lens_of, tuple(features), pairs, pixel)


def _given_lens(intrinsics: Intrinsics, distortion: Sequence[float]) -> Lens:
    k1, k2, p1, p2, k3 = (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return Lens(intrinsics, (k1, k2, p1, p2, k3), known=True)


def _first_guess(photos: Sequence[Photo]) -> Lens:
    """The lens that photos of one camera start from."""
    width, height = photos[0].size
    told = [photo.focal_px or (photo.intrinsics.fx if photo.intrinsics else None) for photo in photos]
    known = next((focal for focal in told if focal), None)
    focal = known or _USUAL_FOCAL * max(width, height)
    intrinsics = Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    return Lens(intrinsics, known=known is not None)


def _alignment(photos: Sequence[Photo], attempt: _Attempt) -> Alignment:
    answer = attempt.answer
    views = tuple(
        View(photos[photo], lens.intrinsics, lens.distortion, pose)
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


def _error_px(views: Sequence[View], attempt: _Attempt) -> float:
    """Mean distance of the observations from their points' projections, pixels of the features' pictures."""
    answer = attempt.answer
    distances = []
    for number, view in enumerate(views):
        mine = answer.seen_view == number
        observed = attempt.features[answer.placed[number]].xy[answer.seen_feature[mine]]
        offset = _projected(view, answer.xyz[answer.seen_point[mine]]) - observed
        distances.append(np.linalg.norm(offset, axis=1) / pixel_of(view.photo, attempt.setting))
    return float(np.concatenate(distances).mean())


def _projected(view: View, xyz: Floats) -> Floats:
    """(K,3) points -> (K,2) pixels of the stored photo."""
    at, world_to_camera = view.intrinsics, np.linalg.inv(view.camera_to_world)
    turn, _ = cv2.Rodrigues(world_to_camera[:3, :3])
    matrix = np.array([[at.fx, 0, at.cx], [0, at.fy, at.cy], [0, 0, 1]])
    xy, _ = cv2.projectPoints(xyz, turn, world_to_camera[:3, 3], matrix, np.array(view.distortion))
    return np.asarray(xy, np.float64).reshape(-1, 2)


def _verdicts(photos: Sequence[Photo], attempt: _Attempt) -> tuple[PhotoVerdict, ...]:
    placed = attempt.answer.placed
    return tuple(
        PhotoVerdict(photo.name, "ok")
        if index in placed
        else PhotoVerdict(photo.name, "no_overlap", _advice(photos, attempt, index))
        for index, photo in enumerate(photos)
    )


def _advice(photos: Sequence[Photo], attempt: _Attempt, index: int) -> str:
    """What to shoot so that a photo that was left out finds its place."""
    if len(attempt.features[index].xy) < _UNTEXTURED:
        return "it shows too little texture: take it from where more of the surroundings is in view, in good light"
    placed = attempt.answer.placed
    if not len(placed):
        return _AROUND
    nearest = photos[int(placed[np.abs(placed - index).argmin()])].name
    return f"take two or three more pictures between {nearest} and this one, each overlapping the last by two thirds"


def _warnings(photos: Sequence[Photo], attempt: _Attempt) -> tuple[str, ...]:
    placed, count = attempt.answer.placed, len(photos)
    if len(placed) == count:
        return ()
    left_out = _names(photos, np.setdiff1d(np.arange(count), placed))
    pieces = _pieces(attempt)
    if len(pieces) > 1:
        sizes = " and ".join(str(size) for size in pieces)
        return (f"the photos fall into pieces of {sizes} that do not meet; the largest was used, without {left_out}",)
    return (f"{len(placed)} of {count} photos could be placed, but not {left_out}",)


def _pieces(attempt: _Attempt) -> list[int]:
    """Photos of each model, the largest first."""
    model_of = attempt.answer.model_of
    return [size for size in np.bincount(model_of[model_of >= 0]).tolist() if size]


def _names(photos: Sequence[Photo], chosen: Ints) -> str:
    names = [photos[index].name for index in chosen[:_NAMED].tolist()]
    more = f" and {len(chosen) - _NAMED} more" if len(chosen) > _NAMED else ""
    return ", ".join(names) + more


def _low_overlap(photos: Sequence[Photo], attempt: _Attempt) -> CaptureError:
    """The verdicts as an error: which photos were left out, where pictures are missing, how to shoot."""
    placed = attempt.answer.placed
    left_out = np.setdiff1d(np.arange(len(photos)), placed)
    hints = (f"not placed: {_names(photos, left_out)}", *_gaps(photos, attempt), _AROUND)
    if all(photo.camera_to_world is not None for photo in photos):
        hints = (*hints, "look whether the poses belong to these photos, and are camera-to-world")
    message = f"only {len(placed)} of {len(photos)} photos show enough of the same to be placed"
    return CaptureError("CAPTURE_LOW_OVERLAP", message, hints=hints)


def _gaps(photos: Sequence[Photo], attempt: _Attempt) -> tuple[str, ...]:
    """Where, in the order of the capture, one piece ends and another begins."""
    model_of = attempt.answer.model_of.tolist()
    ends = [
        f"take two or three more pictures between {photos[first].name} and {photos[second].name}"
        for first, second in pairwise(range(len(photos)))
        if model_of[first] != model_of[second]
    ]
    return tuple(ends[:_NAMED])
