"""Bend a plane to the ground that lies about it: pavement that sags, a lawn, a cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.points.plane import Plane

_ROUNDS = 8
"""Rounds of least squares; the points on the ground change from one to the next."""
_SIGMAS = 3.0
"""Points within this many standard deviations of the ground belong to it."""
_LEAST = 100
"""Points that a bent ground is fitted to; with fewer, it stays a plane."""


@dataclass(frozen=True, slots=True)
class Ground:
    """A plane bent by a quadratic: its heights over the plane are c · (1, u, v, u², uv, v²), at most `most` either way.

    across (2,3): unit vectors u and v in the plane; terms (6,): c
    """

    plane: Plane
    across: Floats
    terms: Floats
    most: float

    @classmethod
    def about(cls, plane: Plane, xyz: Floats, half: float, most: float) -> Ground:
        """Fit the ground to those of the points (N,3) that lie within `half` of a plane, and then about the ground.

        most  greatest height over the plane, either way: far from its points a quadratic would rise without end
        """
        across = np.linalg.svd(plane.normal[None])[2][1:]
        ground = cls(plane, across, np.zeros(6), most)
        rows, height = _rows(xyz @ across.T), plane.height(xyz)
        on = np.abs(height) <= half
        for _ in range(_ROUNDS):
            if on.sum() < _LEAST:
                return ground
            terms = np.linalg.lstsq(rows[on], height[on], rcond=None)[0]
            ground = cls(plane, across, terms, most)
            off = height - ground._bend(rows)
            on = np.abs(off) < min(half, _SIGMAS * float(off[on].std()))
        return ground

    def height(self, xyz: Floats) -> Floats:
        """Return the heights (N,) of points (N,3) over the ground, along the plane's normal."""
        return self.plane.height(xyz) - self._bend(_rows(xyz @ self.across.T))

    def _bend(self, rows: Floats) -> Floats:
        bend: Floats = np.clip(rows @ self.terms, -self.most, self.most)
        return bend


def _rows(uv: Floats) -> Floats:
    u, v = uv.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
