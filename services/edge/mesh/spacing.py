"""How far apart the points of a surface lie: the yardstick of everything that must not be a fixed distance."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Floats

# On a surface the k-th neighbour of density ρ lies at √(k/πρ), and the spacing is 1/√ρ. Eight neighbours are few enough
# to stay on one layer of cloth and enough to tell the spacing to about a fifth.
NEIGHBOURS = 8

CELLS_PER_SPACING = 1.5  # folds gain up to here (10,000 points: 88 to 128 cells); beyond, only the vertices grow


def point_spacing(near: Floats, tree: cKDTree | None = None) -> Floats:
    """(N,3) points -> (N,) local spacing 1/√density. Copies of one point do not make it 0.

    Raises ValueError for fewer than 2 points.
    """
    tree = tree or cKDTree(near)
    k = min(NEIGHBOURS, len(near) - 1)
    if k < 1:
        raise ValueError(f"{len(near)} points have no spacing")
    reach = tree.query(near, k=[k + 1], workers=-1)[0][:, 0]
    spacing: Floats = reach * np.sqrt(np.pi / k)
    floor = 0.1 * float(np.median(spacing[spacing > 0])) if (spacing > 0).any() else 1.0
    return np.maximum(spacing, floor)


def auto_resolution(
    near: Floats, *, low: int = 48, high: int = 512, cells_per_spacing: float = CELLS_PER_SPACING
) -> int:
    """Cells along the longest side that the points can fill: so many per mean spacing, a multiple of 8."""
    side = float(np.ptp(near, axis=0).max())
    cells = cells_per_spacing * side / float(np.median(point_spacing(near)))
    return int(np.clip(8 * round(cells / 8), low, high))
