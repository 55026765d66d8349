"""Which other views to compare a view with: those that share points with it, at angles that show depth."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Bools, Floats
from services.edge.photos.nouns import Alignment

SOURCES = 4
_BEST_DEG, _BELOW_DEG, _ABOVE_DEG = 9.0, 4.0, 10.0
"""Angle between two views of a point that serves stereo best, and how fast it serves less: too small an angle shows no
depth, too large a one another face of the thing."""
_SAME_SIDE = 0.7
"""Of its worth a source loses when it lies in the direction of one already chosen: what hides a point from one side
rarely hides it from the other."""
_LEAST = 5
"""Shared points, each of full worth, below which two views are strangers."""


def sightings(alignment: Alignment) -> Bools:
    """(V,P) which view saw which sparse point."""
    seen = np.zeros((len(alignment.views), len(alignment.xyz)), bool)
    seen[alignment.seen_view, alignment.seen_point] = True
    return seen


def choose_sources(alignment: Alignment, most: int) -> tuple[tuple[int, ...], ...]:
    """For each view the others to compare it with, best first; () for a view that has none."""
    seen = sightings(alignment)
    eyes = np.stack([view.camera_to_world[:3, 3] for view in alignment.views])
    return tuple(_chosen(view, seen, eyes, alignment.xyz, most) for view in range(len(eyes)))


def _chosen(view: int, seen: Bools, eyes: Floats, xyz: Floats, most: int) -> tuple[int, ...]:
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
    """(V,) sum over the shared points of how well their angle serves."""
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
