"""Turn the normals of points towards the cameras that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import pixels_at

_NEIGHBOURS = 12
_SAME = 0.02  # relative depth within which a point is the surface that a photo sees
_GRAZING = 0.3  # cosine of the angle to a photo from which on its word counts fully: 73 degrees


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


def orient_points(xyz: Floats, tree: cKDTree, pictures: Sequence[PosedPicture]) -> OrientedPoints:
    """Estimate the normals of points (N,3) in the pictures' frame, and turn each to the cameras that see its point.

    tree  KD-tree of the points
    """
    near = xyz[tree.query(xyz, k=min(_NEIGHBOURS, len(xyz)), workers=-1)[1]]
    relative = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.matmul(relative.transpose(0, 2, 1), relative))[1][:, :, 0]
    towards, seen = np.zeros(len(xyz)), np.zeros(len(xyz))
    for picture in pictures:
        inside, at, z = picture.in_view(xyz)
        found = pixels_at(picture.depth(), at)
        inside = inside[(found > 0) & (np.abs(found - z) < _SAME * z)]
        ray = picture.eye - xyz[inside]
        cosine = np.einsum("nx,nx->n", ray, normal[inside]) / np.maximum(np.linalg.norm(ray, axis=1), 1e-30)
        share = np.clip(cosine / _GRAZING, -1, 1)
        towards[inside] += share
        seen[inside] += np.abs(share)
    side = towards / np.maximum(seen, 1e-9)
    return OrientedPoints(xyz, normal * np.sign(side)[:, None], np.abs(side))
