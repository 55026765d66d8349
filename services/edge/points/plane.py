"""Find the largest plane in a point cloud, by RANSAC and least-squares refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats

_SAMPLES = 400
"""Random planes tried: finds a plane with 20 % of the points with a probability of 96 %, one with 30 % always."""
_JUDGES = 5_000
"""Points on which the random planes are compared."""
_REFINEMENTS = 5
"""Rounds of least squares."""


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane normal·x = offset that was fitted to points.

    normal (3,) unit vector; spread: standard deviation of its inliers' distances; share: of all points, its inliers.
    """

    normal: Floats
    offset: float
    spread: float
    share: float

    def height(self, xyz: Floats) -> Floats:
        """Return the signed distances (N,) of points (N,3), positive on the normal's side."""
        heights: Floats = xyz @ self.normal - self.offset
        return heights

    def moved(self, by: Floats) -> Plane:
        """Return the plane moved by (3,)."""
        return Plane(self.normal, self.offset + float(self.normal @ by), self.spread, self.share)

    def scaled(self, by: float) -> Plane:
        """Return the plane in a frame whose units are `1 / by` of these."""
        return Plane(self.normal, self.offset * by, self.spread * by, self.share)

    def flipped(self) -> Plane:
        return Plane(-self.normal, -self.offset, self.spread, self.share)


def largest_plane(xyz: Floats, reach: float, *, along: Floats | None = None, within_deg: float = 90.0) -> Plane | None:
    """Find the plane with the most points (N,3) within `reach` of it; None where no three points span a plane.

    With a unit vector `along` (3,), only planes whose normal is within `within_deg` of it count, and the normal points
    along it. The random generator is seeded: the same points give the same plane.
    """
    rng = np.random.default_rng(0)
    judges = xyz[rng.permutation(len(xyz))[:_JUDGES]]
    corners = judges[rng.integers(len(judges), size=(_SAMPLES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 1e-12
    normals, corners = normals[usable] / lengths[usable, None], corners[usable]
    if along is not None:
        upright = np.abs(normals @ along) >= np.cos(np.radians(within_deg))
        normals, corners = normals[upright], corners[upright]
    if not len(normals):
        return None
    offsets = np.einsum("mi,mi->m", normals, corners[:, 0])
    votes = [np.count_nonzero(np.abs(judges @ n - d) < reach) for n, d in zip(normals, offsets, strict=True)]
    best = int(np.argmax(votes))
    plane = _refine(xyz, normals[best], float(offsets[best]), reach)
    return plane.flipped() if along is not None and plane.normal @ along < 0 else plane


def _refine(xyz: Floats, normal: Floats, offset: float, reach: float) -> Plane:
    """Refine a plane by repeated least squares over its inliers; the reach shrinks to three standard deviations."""
    spread = reach
    for _ in range(_REFINEMENTS):
        inside = np.abs(xyz @ normal - offset) < min(reach, 3 * spread)
        if inside.sum() < 3:
            break
        centre = xyz[inside].mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((xyz[inside] - centre).T))
        normal, offset = vectors[:, 0], float(vectors[:, 0] @ centre)
        # Points of a noiseless plane have spread 0; with a thousandth of the reach, rounding errors stay inliers.
        spread = max(float(np.sqrt(max(values[0], 0))), 1e-3 * reach)
    share = float(np.mean(np.abs(xyz @ normal - offset) < min(reach, 3 * spread)))
    return Plane(normal, offset, spread, share)
