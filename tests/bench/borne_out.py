"""Tell which of two surfaces the photos bear out: patches of the true one look alike in all photos that see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.sample_image import bilinear

_SIDE = 7  # samples along a patch
_STEP = 1.5  # photo's pixels from one to the next
_LEAST_COSINE = 0.5  # 60°: a patch seen more aslant is foreshortened to half
_EDGE = 0.03  # of the photo's sides: patches nearer to its edge are left out
_FLAT = 2.0  # grey levels: a patch of less contrast is noise
_VIEWS = 4  # photos that see a patch best, which are compared
_LIFT = 0.02  # of the thing's size: what hides a place less far before it is the other surface


def likeness_of_patches(
    places: Floats, normals: Floats, pictures: Sequence[PosedPicture], scene: RaycastingScene
) -> Floats:
    """Normalised cross-correlation (N,) of the photos' patches at places (N,3) with unit normals: the mean over pairs
    of the photos that see each best; NaN where fewer than two see it with contrast.

    scene  the surface that hides places from photos
    """
    count = len(places)
    grey, weight = np.zeros((len(pictures), _SIDE**2, count), np.float32), np.zeros((len(pictures), count))
    for number, picture in enumerate(pictures):
        rgb = picture.load_rgb()
        towards = picture.eye - places
        away = np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.einsum("nx,nx->n", towards / away, normals)
        pixel = away / (picture.focal[0] * rgb.shape[1])
        at = picture.project(places)[0]
        patch = bilinear(rgb, picture.project(_patches(places, normals, _STEP * pixel).reshape(-1, 3))[0])
        tones = patch.mean(axis=1).reshape(_SIDE**2, count)
        tones -= tones.mean(axis=0)
        contrast = tones.std(axis=0)
        seen = (cosine > _LEAST_COSINE) & (np.minimum(at, 1 - at).min(axis=1) > _EDGE) & (contrast > _FLAT)
        start = places + _LIFT * scene.longest * towards / away
        seen &= ~scene.blocked(start, picture.eye - start, 1.0)
        grey[number], weight[number] = tones / np.maximum(contrast, 1e-6), np.where(seen, cosine, 0)
    best = np.argsort(-weight, axis=0)[:_VIEWS]
    total, pairs, every = np.zeros(count), np.zeros(count), np.arange(count)
    for one in range(len(best)):
        for other in range(one):
            a, b = best[one], best[other]
            both = (weight[a, every] > 0) & (weight[b, every] > 0)
            total += both * np.mean(grey[a, :, every] * grey[b, :, every], axis=1)
            pairs += both
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def _patches(places: Floats, normals: Floats, step: Floats) -> Floats:
    """Samples (_SIDE²,N,3) of square patches around places, square to their normals; step (N,1)."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    right = np.cross(normals, axis)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(normals, right)
    across, along = (each.ravel()[:, None, None] for each in np.mgrid[:_SIDE, :_SIDE] - _SIDE // 2)
    return places + step * (across * right + along * up)
