"""Choose the pictures of a capture that show a tile best, for its texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture

MOST = 12
"""Pictures of a tile: it is 2.5 m wide, and each takes half a second."""
_ASKED = 96
"""Pictures whose depth is read for a tile, 5 ms each: those that would show most of it, and finest, if nothing stood
before it."""
_PROBES = 400  # vertices that are projected
_SEEN = 0.05  # share of them in a picture from which on it shows the tile
_NEAR = 0.1  # of the depth: a vertex is what the picture shows there
_NEAREST = 1.5  # times the usual resolution: a finer picture counts no more, or one close-up would replace all others


@dataclass(frozen=True, slots=True)
class TileViews:
    """All pictures of a scene, placed in the asset frame; hundreds for a long walk. They stay on disk."""

    pictures: Sequence[PosedPicture] = ()

    def that_see(self, mesh: Mesh) -> tuple[PosedPicture, ...]:
        """The pictures that together show most of a mesh, and finest, the best first; only those that show some of it.

        Each next one is that which adds most to those before it, over the places that it shows for the first time, or
        finer than they do.
        """
        some = mesh.vertices[:: max(1, len(mesh.vertices) // _PROBES)]
        fineness = np.array([_fineness(picture, some) for picture in self.pictures]).reshape(-1, len(some))
        if not fineness.any():
            return ()
        worth = np.minimum(fineness / np.median(fineness[fineness > 0]), _NEAREST)
        asked = np.argsort(-worth.sum(axis=1), kind="stable")[:_ASKED]
        shown = np.stack([worth[number] * _shown_mask(self.pictures[number], some) for number in asked])
        enough = np.count_nonzero(shown, axis=1) >= _SEEN * len(some)
        return tuple(self.pictures[asked[enough][row]] for row in _greedy(shown[enough]))


def _fineness(picture: PosedPicture, places: Floats) -> Floats:
    """Resolution (N,) in which a picture shows places (N,3), in shares of its width per metre; 0 outside of it."""
    at, away = picture.project(places)
    inside = (away > 0) & ((at > 0) & (at < 1)).all(axis=1)
    fineness: Floats = np.where(inside, picture.focal[0] / np.maximum(away, 1e-9), 0)
    return fineness


def _shown_mask(picture: PosedPicture, places: Floats) -> Bools:
    """Mask (N,) of places (N,3) where the depth image of a picture shows nothing else."""
    at, away = picture.project(places)
    depth = picture.depth()
    size = np.array(depth.shape[::-1])
    column, row = np.clip(at * size, 0, size - 1).astype(np.int64).T
    known = depth[row, column]
    shown: Bools = (known <= 0) | (np.abs(known - away) < _NEAR * known)
    return shown


def _greedy(worth: Floats) -> list[int]:
    """Rows of pictures (P,N), at most MOST, each the one that adds most to the best of those before it."""
    best, order = np.zeros(worth.shape[1]), list[int]()
    while len(order) < min(MOST, len(worth)):
        gain = np.maximum(worth - best, 0).sum(axis=1)
        gain[order] = -1
        order.append(int(gain.argmax()))
        best = np.maximum(best, worth[order[-1]])
    return order
