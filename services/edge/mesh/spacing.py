"""The local spacing of points on a surface, the unit of all lengths that must adapt to the density of points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats

# On a surface the k-th neighbour of density ρ lies at √(k/πρ), and the spacing is 1/√ρ. Eight neighbours are few enough
# to stay on one layer of cloth and enough to tell the spacing to about a fifth.
NEIGHBOURS = 8

CELLS_PER_SPACING = 1.5  # folds gain up to here (10,000 points: 88 to 128 cells); beyond, only the vertices grow


def point_spacing(near: Floats, tree: cKDTree | None = None) -> Floats:
    """Local spacing 1/√density (N,) of points (N,3). Copies of one point do not make it 0.

    Raises ValueError for fewer than 2 points.
    """
    tree = tree or cKDTree(near)
    k = min(NEIGHBOURS, len(near) - 1)
    if k < 1:
        raise ValueError(f"a spacing needs at least 2 points, not {len(near)}")
    reach = tree.query(near, k=[k + 1], workers=-1)[0][:, 0]
    spacing: Floats = reach * np.sqrt(np.pi / k)
    floor = 0.1 * float(np.median(spacing[spacing > 0])) if (spacing > 0).any() else 1.0
    return np.maximum(spacing, floor)


def auto_resolution(
    near: Floats, *, low: int = 48, high: int = 512, cells_per_spacing: float = CELLS_PER_SPACING
) -> int:
    """Choose the number of cells along the longest side: so many per median spacing, a multiple of 8."""
    side = float(np.ptp(near, axis=0).max())
    cells = cells_per_spacing * side / float(np.median(point_spacing(near)))
    return int(np.clip(8 * round(cells / 8), low, high))
