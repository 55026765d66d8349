"""Interpolate the colours of captured points at other places, in linear light, by their nearest neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.srgb import to_linear, to_srgb

_NEIGHBOURS = 6  # about one ring of a surface sample: smooths the noise of single pixels without washing out a print
_NEAR = 0.05  # of the neighbours' mean distance: its square is added to d² in the weight 1/d², a bound for d = 0
_AROUND = 32  # nearest points that tell whether surface was inferred


@dataclass(frozen=True, slots=True)
class ColouredPoints:
    """Coloured points with a KD-tree: xyz (N,3), light (N,3) float32 linear, N ≥ 1; inferred (N,): mask of those that
    were not measured, or None; kept (N,): mask of those of them whose colours are their own, or None."""

    xyz: Floats
    light: Floats
    tree: cKDTree
    inferred: Bools | None = None
    kept: Bools | None = None

    @classmethod
    def of(cls, xyz: Floats, rgb: Bytes, inferred: Bools | None = None, kept: Bools | None = None) -> ColouredPoints:
        """Index points with rgb (N,3) uint8 sRGB. Raises ValueError where the two differ in length or are empty."""
        if len(xyz) != len(rgb) or len(xyz) == 0:
            raise ValueError(f"{len(xyz)} points but {len(rgb)} colours: both must be equal in number, at least one")
        return cls(xyz, to_linear(rgb), cKDTree(xyz), inferred, kept)

    def __len__(self) -> int:
        return len(self.xyz)

    def inferred_share(self, places: Floats) -> Floats:
        """Return which share (M,) of the points around places (M,3) was not measured."""
        if self.inferred is None:
            return np.zeros(len(places))
        around = self.tree.query(places, k=range(1, 1 + min(_AROUND, len(self))), workers=-1)[1]
        share: Floats = self.inferred[around].mean(axis=1)
        return share

    def light_at(self, places: Floats, neighbours: int = _NEIGHBOURS) -> Floats:
        """Interpolate linear light (M,3) at places (M,3): inverse squared distance over the nearest points."""
        count = min(neighbours, len(self))
        distance, index = self.tree.query(places, k=list(range(1, count + 1)), workers=-1)
        spacing = np.maximum(distance.mean(axis=1, keepdims=True), 1e-12)  # 0 where all points coincide with the place
        weight = 1.0 / (distance**2 + (_NEAR * spacing) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        blended: Floats = np.einsum("vk,vkc->vc", weight, self.light[index])
        return blended

    def mean_light(self, places: Floats, reach: float) -> tuple[Floats, Ints]:
        """Average the light of the points nearest to each place (M,3), within `reach`: (M,3), and (M,) their number."""
        away, owner = cKDTree(places).query(self.xyz, distance_upper_bound=reach, workers=-1)
        near = np.isfinite(away)
        owner, light = owner[near], self.light[near]
        count = np.bincount(owner, minlength=len(places))
        summed = np.stack([np.bincount(owner, light[:, band], len(places)) for band in range(3)], axis=1)
        return (summed / np.maximum(count, 1)[:, None]).astype(np.float32), count


def transfer_colours(mesh: Mesh, xyz: Floats, rgb: Bytes) -> Mesh:
    """Colour a mesh's vertices from coloured points: inverse squared distance over the nearest points, in linear light.

    xyz (N,3) in the mesh's frame, rgb (N,3) uint8 sRGB, N ≥ 1. Raises ValueError where the two differ in length.
    """
    return replace(mesh, rgb=to_srgb(ColouredPoints.of(xyz, rgb).light_at(mesh.vertices)))
