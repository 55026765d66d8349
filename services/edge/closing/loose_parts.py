"""Find the parts of a closed mesh that have no points, and tell missing surface from true openings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.plane import Plane
from capture2vr.order.option_table import Fill

_LOOSE = 2.5
"""Spacings from the next point from which on a part of the surface has none."""
_LEAST = 20.0
"""Squared spacings: smaller parts are chance, and extraction closes them."""
_RESTS, _RESTS_SHARE = 3.0, 0.02
"""Cells from the plane within which a part rests on it, and the share of the part that must."""
_UNDER = 0.1
"""Least mean cosine between the normals around such a part and its own where the surface turns under the thing."""
_LOWEST, _REACHES = 10.0, 0.05
"""Percentile of the heights around such a part that tells how far down the surface comes, and how near it must be."""
_MOST_SUPPORT = 0.45
"""Share of the surface up to which a part that rests on the plane is taken: of a façade whose back nobody saw, more
would be made up than is known. Fruit that was photographed from above has .3."""
_DOWN, _FACES = -0.3, 0.1
"""Cosines to the plane's normal, and to a camera, up to which a place faces down, and from which on it faces the
camera."""
_MOST_BACK = 0.1
"""Share of the surface up to which such a part may face neither down nor any camera: it is a back that nobody went
around to. A toy that was photographed from the front has .18, whatever was photographed from all around 0."""
_CONTINUES, _AROUND = 0.5, 3
"""Least mean cosine between a part's normal and those of the surface around it, in so many rings of triangles, for a
hole in a surface: over the end of a tube it is 0."""
_MOST_HOLE = 0.15
"""Share of the surface up to which a part is a hole in it, and not a side that nobody saw."""
_SMALL = 60.0
"""Squared spacings: a larger hole in a thing with true openings may be one itself, such as a neckline."""
_OPEN = 0.01
"""Share of the surface in parts that neither rest on the plane nor are holes, from which on they are true openings."""


@dataclass(frozen=True, slots=True)
class LooseParts:
    """The connected parts of a closed mesh that have no points.

    number (F,): of each face's part, −1 where it has points; count: of the parts
    """

    mesh: Mesh
    normals: Floats
    number: Ints
    count: int

    @classmethod
    def without_points(cls, mesh: Mesh, tree: cKDTree, local: Floats) -> LooseParts:
        """Find the parts; local (N,): spacing around each point of the tree."""
        loose = np.flatnonzero(is_loose(mesh, tree, local))
        number = np.full(len(mesh.faces), -1)
        corners = mesh.faces[loose]
        ends = np.concatenate([corners[:, :2], corners[:, 1:]])
        links = coo_array((np.ones(len(ends)), ends.T), shape=(len(mesh.vertices),) * 2)
        _, label = connected_components(links, directed=False)
        _, number[loose] = np.unique(label[corners[:, 0]], return_inverse=True)
        return cls(mesh, face_normals(mesh.vertices, mesh.faces) / 2, number, int(number.max(initial=-1)) + 1)

    def missing(
        self, support: Plane | None, eyes: Floats, cell: float, spacing: float, fill: Fill, *, hollow: bool = False
    ) -> tuple[Bools, bool]:
        """Return a mask (F,) of the faces of the parts that are missing surface, and whether the thing is closed with
        them: whether no other part is large enough to be a true opening, and the thing is not hollow, with an inside
        that photos saw. eyes (M,3): where the cameras were."""
        if not self.count:
            return np.zeros(len(self.number), bool), not hollow
        areas = np.linalg.norm(self.normals, axis=1)
        area = self._sum(self.number, areas)
        share = area / max(float(areas.sum()), 1e-300)
        around = self._grown(_AROUND)
        around[self.number >= 0] = -1
        bend = self._bend(around)
        stands = self._rests(support, around, bend, cell) & (share <= _MOST_SUPPORT)
        stands[stands] = (self._back(support, eyes, areas) <= _MOST_BACK)[stands]
        continues = (bend >= _CONTINUES) & (share <= _MOST_HOLE)
        closed = not hollow and float(share[~stands & ~continues].sum()) < _OPEN
        taken = area >= _LEAST * spacing**2
        if fill != "all" and not closed:
            taken &= stands | (continues & (area <= _SMALL * spacing**2))
        faces: Bools = (self.number >= 0) & taken[self.number]
        return faces, closed

    def _rests(self, support: Plane | None, around: Ints, bend: Floats, cell: float) -> Bools:
        """(P,) which parts rest on the plane where the surface around them comes down to it, or turns under the thing;
        the hem of a skirt does neither."""
        rests = np.zeros(self.count, bool)
        if support is None:
            return rests
        areas = np.linalg.norm(self.normals, axis=1)
        height = support.height(self.mesh.vertices[self.mesh.faces].mean(axis=1))
        low = self._sum(np.where(height < _RESTS * cell, self.number, -1), areas)
        for part in np.flatnonzero(low > _RESTS_SHARE * self._sum(self.number, areas)):
            ring = height[around == part]
            rests[part] = bend[part] > _UNDER or (len(ring) > 0 and np.percentile(ring, _LOWEST) < _REACHES)
        return rests

    def _back(self, support: Plane | None, eyes: Floats, areas: Floats) -> Floats:
        """Share (P,) of the surface in each part that faces neither down nor any camera."""
        up = np.zeros(3) if support is None else support.normal
        back = self.normals @ up > _DOWN * areas
        middle = self.mesh.vertices[self.mesh.faces].mean(axis=1)
        for eye in eyes:
            towards = eye - middle
            facing = np.einsum("fx,fx->f", towards, self.normals)
            back &= facing < _FACES * areas * np.linalg.norm(towards, axis=1)
        return self._sum(np.where(back, self.number, -1), areas) / max(float(areas.sum()), 1e-300)

    def _bend(self, around: Ints) -> Floats:
        """Mean cosine (P,) between the normals of the surface around each part, which the numbers (F,) tell, and that
        of the part as a whole."""
        whole = np.stack([self._sum(self.number, column) for column in self.normals.T], axis=1)
        whole /= np.maximum(np.linalg.norm(whole, axis=1, keepdims=True), 1e-300)
        area = self._sum(around, np.linalg.norm(self.normals, axis=1))
        bend: Floats = self._sum(around, np.einsum("fx,fx->f", self.normals, whole[around])) / np.maximum(area, 1e-300)
        return bend

    def _sum(self, number: Ints, values: Floats) -> Floats:
        """Sum of values (F,) over the faces of each part (P,); number (F,) of the part, −1 without."""
        own = number >= 0
        return np.bincount(number[own], values[own].astype(np.float64), self.count).astype(np.float64)

    def _grown(self, rings: int) -> Ints:
        """Numbers (F,) of the parts, grown by rings of triangles; where two meet, the later one has the triangle."""
        of_vertex = np.full(len(self.mesh.vertices), -1)
        number = self.number
        for _ in range(rings):
            own = number >= 0
            of_vertex[self.mesh.faces[own]] = number[own, None]
            number = of_vertex[self.mesh.faces].max(axis=1)
        return number


def is_loose(mesh: Mesh, tree: cKDTree, local: Floats) -> Bools:
    """Return a mask (F,) of the faces that have no points; local (N,): spacing around each point of the tree."""
    away, nearest = tree.query(mesh.vertices[mesh.faces].mean(axis=1), workers=-1)
    loose: Bools = away > _LOOSE * local[nearest]
    return loose
