"""Turn the normals of points towards the cameras that see them, and tell how certainly points lie on a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import pixels_at

_NEIGHBOURS, _WIDE = 12, 32
"""Neighbours that a normal is estimated from, and among which a point is judged: they reach three spacings far."""
_SAME = 0.02  # relative depth within which a point is the surface that a photo sees
_EXACT = 0.004
"""Relative difference from a photo's depth at which its word counts half: photos from beyond an outline see the same
depth, roughly, at points of its other side. Of real fruit 3.3 % of the points had normals that point inwards before."""
_GRAZING = 0.3  # cosine of the angle to a photo from which on its word counts fully: 73 degrees
_SPARSE, _DENSE = 0.15, 0.5
"""Density of points, over the median, at which a point is none of a surface, and from which on it may be one: at a
straight border half of it is left, in specks and strips much less."""


@dataclass(frozen=True, slots=True)
class OrientedPoints:
    """Points with normals that point out of the surface, to where cameras are.

    xyz, normal (N,3); weight (N,) in [0,1]: how surely the normal's side is known, 0 where photos saw both sides alike
    """

    xyz: Floats
    normal: Floats
    weight: Floats

    def subset(self, which: Bools) -> OrientedPoints:
        """Return the points of a mask (N,)."""
        return OrientedPoints(self.xyz[which], self.normal[which], self.weight[which])


def orient_points(xyz: Floats, tree: cKDTree, pictures: Sequence[PosedPicture]) -> tuple[OrientedPoints, Floats]:
    """Estimate the normals of points (N,3) in the pictures' frame, and turn each to the cameras that see its point.

    Returned with how certainly each is of a surface, (N,), about 1 where it is: the mean cosine between its normal and
    those around it, over the median, as fur and leaves are rough everywhere; times the density, where that is low. In
    specks, strips and noise, which stereo leaves at the border of what it sees, it is less.

    tree  KD-tree of the points
    """
    away, around = tree.query(xyz, k=range(1, 1 + min(_WIDE, len(xyz))), workers=-1)
    near = xyz[around[:, :_NEIGHBOURS]]
    relative = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.matmul(relative.transpose(0, 2, 1), relative))[1][:, :, 0]
    cosine = np.abs(np.einsum("nkx,nx->nk", normal[around], normal))
    side = seen_sides(xyz, normal, pictures)
    density = _over_median(1 / np.maximum(np.square(away[:, -1]), 1e-300))
    certain: Floats = _over_median(cosine.mean(axis=1)) * ramp(density, _SPARSE, _DENSE)
    return OrientedPoints(xyz, normal * np.sign(side)[:, None], np.abs(side)), certain


def seen_sides(xyz: Floats, normal: Floats, pictures: Sequence[PosedPicture]) -> Floats:
    """Tell to which side (N,) in [−1,1] of points (N,3) with normals (N,3) the cameras are that see them; 0 if none."""
    towards, seen = np.zeros(len(xyz)), np.zeros(len(xyz))
    for picture in pictures:
        inside, at, z = picture.in_view(xyz)
        found = pixels_at(picture.depth(), at)
        off = np.abs(found - z) / z
        known = (found > 0) & (off < _SAME)
        inside, certain = inside[known], 1 / (1 + np.square(off[known] / _EXACT))
        ray = picture.eye - xyz[inside]
        cosine = np.einsum("nx,nx->n", ray, normal[inside]) / np.maximum(np.linalg.norm(ray, axis=1), 1e-30)
        share = certain * np.clip(cosine / _GRAZING, -1, 1)
        towards[inside] += share
        seen[inside] += np.abs(share)
    side: Floats = towards / np.maximum(seen, 1e-9)
    return side


def _over_median(values: Floats) -> Floats:
    over: Floats = values / max(float(np.median(values)), 1e-300)
    return over


def ramp(values: Floats, none: float, full: float) -> Floats:
    """Return values (N,) as they rise from 0 at `none` to 1 at `full`."""
    risen: Floats = np.clip((values - none) / (full - none), 0, 1)
    return risen
