"""Refine photos' poses on the mesh, so that their pictures lie on each other to a fraction of a pixel.

Q.-Y. Zhou, V. Koltun, "Color map optimization for 3D reconstruction with consumer depth cameras", 2014: every place on
the mesh gets the mean grey of the photos that see it, and every photo moves to where it differs least from these means
(Gauss-Newton over six parameters, robust); by turns, from blurred pictures to sharp ones. Exposures may differ: each
photo's greys are fitted to the means by a gain and an offset.

Symbols: p a place, X its position in the camera, I(u) the photo's grey where it projects to, a, b the photo's gain and
offset, c the mean of the place. The residual is r = a·I(u(X)) + b − c, and a small motion (ω, v) of the camera changes
X by ω × X + v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import bilinear

LONGEST_PX = 800
"""Longer side of the pictures that are aligned: a quarter of a pixel is then half a texel of a texture of 2048."""
_BLURS = (4.0, 2.0, 1.0)
"""Standard deviations in pixels of the blur, one after the other: motions of up to twice as much are found."""
_ROUNDS = 6
"""Motions for each blur."""
_ROBUST = 2.0
"""Residuals of more than so many standard deviations count less (Cauchy)."""
_DAMPING = 1e-3
"""Share of its diagonal that is added to the normal matrix: a plain wall does not tell all six parameters."""
_USUAL_SHIFT, _TIE = 0.004, 0.05
"""Usual motion, in focal lengths: 3 pixels of 800; and how strongly each photo is drawn back to its given pose."""
_FEWEST = 300
"""Places that a photo must see to be moved."""
_FARTHEST = 0.03
"""Most motion of a place in the picture, as a share of its longer side: a photo that moves farther keeps its pose."""


@dataclass(frozen=True, slots=True)
class SeenPlaces:
    """Places that one photo sees: index (M,) among all places, weight (M,) of what it shows there."""

    index: Ints
    weight: Floats


def refine_poses(
    pictures: Sequence[PosedPicture],
    greys: Sequence[Floats],
    places: Floats,
    seen: Sequence[SeenPlaces],
    tick: Tick = no_tick,
) -> list[PosedPicture]:
    """Move the pictures to where they lie on each other best.

    greys: each picture's brightness (h,w) float32, at most `LONGEST_PX` pixels long; places (N,3) on the mesh, in the
    pictures' frame; seen: the places that each of them sees. A picture that sees too little, or that would move too
    far, keeps its pose; so does one that is not `tracked`, because structure from motion has placed it better.
    """
    if sum(picture.tracked for picture in pictures) < 2:
        return list(pictures)
    moved, numbers = list(pictures), [*range(len(pictures))]
    for level, blur in enumerate(_BLURS):
        layers = in_threads(partial(_with_slopes, blur=blur), greys)
        means = _means(
            [_sample(moved[number], layers[number], places, seen[number]) for number in numbers], seen, len(places)
        )
        register = partial(_register, pictures, moved, layers, means, places, seen)
        moved = in_threads(register, numbers, part_of(tick, level / len(_BLURS), (level + 1) / len(_BLURS)))
    return [
        new if old.tracked and _shift(old, new, places[each.index]) <= _FARTHEST else old
        for old, new, each in zip(pictures, moved, seen, strict=True)
    ]


def _register(
    given: Sequence[PosedPicture],
    moved: Sequence[PosedPicture],
    layers: Sequence[Floats],
    means: Floats,
    places: Floats,
    seen: Sequence[SeenPlaces],
    number: int,
) -> PosedPicture:
    """Move one photo to where it lies on the means best; they stay meanwhile, or all photos would drift together."""
    picture = moved[number]
    for _ in range(_ROUNDS):
        sampled = _sample(picture, layers[number], places, seen[number])
        picture = _moved(picture, given[number], sampled, means, places, seen[number])
    return picture


def _with_slopes(grey: Floats, blur: float) -> Floats:
    """Blur a picture; return it with its slopes along x and y (h,w,3) float32."""
    import cv2

    soft = cv2.GaussianBlur(grey, (0, 0), blur)
    slopes = [cv2.Scharr(soft, cv2.CV_32F, *order, scale=1 / 32) for order in ((1, 0), (0, 1))]
    return np.asarray(cv2.merge([soft, *slopes]))


def _sample(picture: PosedPicture, layers: Floats, places: Floats, seen: SeenPlaces) -> Floats:
    """Sample grey, and its slopes per share of the picture's sides, at the places: (M,3), NaN outside the picture."""
    height, width = layers.shape[:2]
    at, z = picture.project(places[seen.index])
    sampled = bilinear(layers, at)
    sampled[:, 1:] *= (width, height)
    sampled[(z <= 0) | (np.minimum(at, 1 - at).min(axis=1) < 0)] = np.nan
    return sampled


def _means(shown: Sequence[Floats], seen: Sequence[SeenPlaces], count: int) -> Floats:
    """Mean grey (N,) of the places over the photos that see them; NaN where fewer than two do."""
    total, weight, views = np.zeros(count), np.zeros(count), np.zeros(count)
    for sampled, each in zip(shown, seen, strict=True):
        known = np.isfinite(sampled[:, 0])
        index, w = each.index[known], each.weight[known]
        total[index] += w * sampled[known, 0]
        weight[index] += w
        views[index] += 1
    return np.where(views >= 2, total / np.maximum(weight, 1e-12), np.nan)


def _moved(
    picture: PosedPicture, given: PosedPicture, sampled: Floats, means: Floats, places: Floats, seen: SeenPlaces
) -> PosedPicture:
    """Move a photo by one Gauss-Newton step; it is drawn back to its given pose, or all would drift together."""
    mean = means[seen.index]
    known = np.flatnonzero(np.isfinite(mean) & np.isfinite(sampled[:, 0]))
    if len(known) < _FEWEST:
        return picture
    grey, slope, mean = sampled[known, 0].astype(np.float64), sampled[known, 1:].astype(np.float64), mean[known]
    gain, offset = _exposure(grey, mean)
    residual = gain * grey + offset - mean
    spread = 1.4826 * float(np.median(np.abs(residual))) + 1e-6
    weight = seen.weight[known] / (1 + np.square(residual / (_ROBUST * spread)))
    local = places[seen.index[known]] @ picture.to_camera[:3, :3].T + picture.to_camera[:3, 3]
    x, y, z = local.T
    by_x = gain * slope[:, 0] * picture.focal[0] / z
    by_y = gain * slope[:, 1] * picture.focal[1] / z
    by_place = np.stack([by_x, by_y, -(by_x * x + by_y * y) / z], axis=1)
    jacobian = np.hstack([np.cross(local, by_place), by_place])
    normal = jacobian.T @ (weight[:, None] * jacobian)
    right = -jacobian.T @ (weight * residual)
    ties = weight.mean() * (spread / _USUAL_SHIFT) ** 2 * _TIE
    away = (picture.project(places[seen.index[known]])[0] - given.project(places[seen.index[known]])[0]) / given.focal
    for axis, (by_x, by_z) in enumerate(((1 / z, -x / z**2), (1 / z, -y / z**2))):
        by_place = np.zeros((len(known), 3))
        by_place[:, axis], by_place[:, 2] = by_x, by_z
        shift = np.hstack([np.cross(local, by_place), by_place])
        normal += ties * shift.T @ shift
        right -= ties * shift.T @ away[:, axis]
    normal[np.diag_indices(6)] *= 1 + _DAMPING
    step = np.linalg.lstsq(normal, right, rcond=None)[0]
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
    motion[:3, 3] = step[3:]
    return replace(picture, to_camera=motion @ picture.to_camera)


def _exposure(grey: Floats, mean: Floats) -> tuple[float, float]:
    """Gain and offset that fit greys (M,) to the means (M,) best."""
    spread = float(grey.var())
    gain = float(((grey - grey.mean()) * (mean - mean.mean())).mean()) / spread if spread > 1e-9 else 1.0
    gain = float(np.clip(gain, 0.3, 3.0))
    return gain, float(mean.mean() - gain * grey.mean())


def _shift(old: PosedPicture, new: PosedPicture, places: Floats) -> float:
    """Median motion of places in the picture, in shares of its longer side."""
    if not len(places):
        return 0.0
    apart = (old.project(places)[0] - new.project(places)[0]) / old.focal * old.focal.min()
    return float(np.median(np.linalg.norm(apart, axis=1)))
