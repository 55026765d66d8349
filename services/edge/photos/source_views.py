"""Select for each view the source views for stereo: views that share sparse points with it, at useful angles."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.cameras.nouns import Alignment

SOURCES = 4
"""Source views per view for the plane sweep."""
_BEST_DEG, _BELOW_DEG, _ABOVE_DEG = 9.0, 4.0, 10.0
"""Best triangulation angle between two views of a point, and the widths (1 sigma) of its weight below and above it: a
smaller angle shows no depth, a larger one another face of the object."""
_SAME_SIDE = 0.7
"""Share of its weight that a source loses when it is in the same direction as one already chosen: a point that is
occluded from one side is rarely occluded from the other."""
_LEAST = 5
"""Least weight of a source, in shared points of full weight."""


def sightings(alignment: Alignment) -> Bools:
    """Return a mask (V,P): whether each view sees each sparse point."""
    seen = np.zeros((len(alignment.views), len(alignment.xyz)), bool)
    seen[alignment.seen_view, alignment.seen_point] = True
    return seen


def choose_sources(alignment: Alignment, most: int) -> tuple[tuple[int, ...], ...]:
    """Select at most `most` source views for each view, best first; () for a view without any."""
    seen = sightings(alignment)
    eyes = np.stack([view.camera_to_world[:3, 3] for view in alignment.views])
    return tuple(_choose(view, seen, eyes, alignment.xyz, most) for view in range(len(eyes)))


def _choose(view: int, seen: Bools, eyes: Floats, xyz: Floats, most: int) -> tuple[int, ...]:
    """Select the source views of one view greedily, preferring different directions."""
    worth = _worths(view, seen, eyes, xyz)
    towards = eyes - eyes[view]
    towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    chosen: list[int] = []
    while len(chosen) < most and worth.max(initial=0) >= _LEAST:
        best = int(np.argmax(worth))
        chosen.append(best)
        worth *= 1 - _SAME_SIDE * np.maximum(towards @ towards[best], 0)
        worth[best] = 0
    return tuple(chosen)


def _worths(view: int, seen: Bools, eyes: Floats, xyz: Floats) -> Floats:
    """Return the weight (V,) of each view as a source: the sum of the shared points' weights by their angles."""
    points = np.flatnonzero(seen[view])
    ray = xyz[points] - eyes[view]
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    worth = np.zeros(len(eyes))
    for other in range(len(eyes)):
        shared = seen[other, points]
        if other == view or not shared.any():
            continue
        back = xyz[points[shared]] - eyes[other]
        cosine = np.einsum("ni,ni->n", ray[shared], back) / np.linalg.norm(back, axis=1)
        off = np.degrees(np.arccos(np.clip(cosine, -1, 1))) - _BEST_DEG
        worth[other] = np.exp(-0.5 * (off / np.where(off < 0, _BELOW_DEG, _ABOVE_DEG)) ** 2).sum()
    return worth
