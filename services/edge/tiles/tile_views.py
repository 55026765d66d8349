"""Choose the pictures of a capture that show a tile best, for its texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Floats
from services.edge.mesh.nouns import Mesh
from services.edge.render.posed_picture import PosedPicture

MOST = 12
"""Pictures of a tile: it is 2.5 m wide, and each takes half a second."""
_PROBES = 400  # vertices that are projected
_SEEN = 0.05  # share of them in a picture from which on it shows the tile
_NEAR = 0.1  # of the depth: a vertex is what the picture shows there


@dataclass(frozen=True, slots=True)
class TileViews:
    """All pictures of a scene, placed in the asset frame."""

    pictures: Sequence[PosedPicture] = ()

    def that_see(self, mesh: Mesh) -> tuple[PosedPicture, ...]:
        """The pictures that show most of a mesh, the best first, and only those that show some of it."""
        some = mesh.vertices[:: max(1, len(mesh.vertices) // _PROBES)]
        shares = [_share_seen(picture, some) for picture in self.pictures]
        order = np.argsort(-np.array(shares), kind="stable")[:MOST]
        return tuple(self.pictures[number] for number in order if shares[number] >= _SEEN)


def _share_seen(picture: PosedPicture, places: Floats) -> float:
    """Share of places (N,3) that a picture shows: inside of it, and at the depth that it has there, if any."""
    at, away = picture.project(places)
    inside = (away > 0) & ((at > 0) & (at < 1)).all(axis=1)
    if not inside.any():
        return 0.0
    depth = picture.depth()
    size = np.array(depth.shape[::-1])
    column, row = np.clip((at[inside] * size).astype(np.int64), 0, size - 1).T
    known = depth[row, column]
    shown = (known <= 0) | (np.abs(known - away[inside]) < _NEAR * known)
    return float(shown.sum()) / len(places)
