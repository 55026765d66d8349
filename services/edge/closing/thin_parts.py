"""Find an object's thin parts, such as stems and cables, by their outlines in the photos.

What is few pixels wide has hardly any depth of its own: windows that are compared show the background beside it, so
that stems are lost, thickened, or joined by webs. Where object and background differ in colour, outlines tell more: a
place is the object's where all photos but one in twenty show it there (the visual hull, A. Laurentini, "The Visual
Hull Concept for Silhouette-Based Image Understanding", 1994). A hull says nothing of hollows, but in what is thin there
are none.

1. colour   every photo tells where it shows the object                                    (../render/object_colours.py)
2. carve    the hull in cells of about a pixel, from coarse to fine; what is wider than some pixels stays coarse
3. choose   of the rest, the cells in line-shaped parts that come away from it and have measured points
4. surface  points on the hull's surface there, between cells in it and cells outside
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import label, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, evenly
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.points.voxel_grid import cell_keys, key_cells, voxel_keys
from capture2vr.edge.render.object_colours import MOST, SURE, ObjectColours
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import bilinear, shrink_to

_FEWEST = 8
"""Photos without which a hull has corners where nothing is."""
_MOST_PICTURES = 40
"""Photos that are asked, evenly chosen."""
_ONE_OF = 20
"""Of so many photos one may err, of fewer, too."""
_MOST_CELLS = 448
"""Cells along the object's longest side; photos are shrunk to pixels of that size."""
_BESIDE_PX = 4
"""Pixels from what is surely background within which one may be of an outline."""
_COARSE = 8
"""Cells in the side of the coarsest ones."""
_WIDEST = 6
"""Cells: wider parts have depth."""
_IN_LINE = ((32, 0.6), (128, 0.75))
"""Cells around one, and how much of their first variance the second one may be: in a line it is less, in a sheet the
same, and in a bunch of lines it is less the fewer cells are asked."""
_AWAY = 4
"""Cells of four fine ones a side between the wide parts and the end of a thin one, at least: the outermost layer of a
hull is up to two thick."""
_LEAST = 10
"""Cells in a part: less is chance."""
_REACH = 3.0
"""Cells from a thin part within which measured points are its own."""
_MOST_BESIDE = 0.25
"""Share of the measured points beside the outlines from which on these are those of something else."""
_CHUNK = 30_000


@dataclass(frozen=True, slots=True)
class ThinParts:
    """Points xyz (M,3) on the surface of thin parts; replaced (N,): mask of the measured points that they replace, and
    of those where photos show background."""

    xyz: Floats
    replaced: Bools


def find_thin_parts(xyz: Floats, pictures: Sequence[PosedPicture], support: Plane | None) -> ThinParts | None:
    """Find an object's thin parts; None where its colours are its background's, or it has none.

    xyz (N,3): of the object alone; pictures that show it, and the plane that it stands on, in the same frame
    """
    pictures = evenly(pictures, _MOST_PICTURES)
    if len(pictures) < _FEWEST:
        return None
    hull = _Hull.of(xyz, pictures, support)
    if hull is None:
        return None
    beside = hull.is_beside(xyz)
    if beside.mean() > _MOST_BESIDE:
        return None
    cells, bulk = hull.narrow_cells()
    cells = _lines(cells, bulk.grown(), hull.cell_of(xyz[~beside]))
    if not len(cells):
        return None
    near = cKDTree(cells).query(hull.cell_of(xyz), distance_upper_bound=_REACH)[0]
    replaced = beside | (np.isfinite(near) & ~bulk.holds(hull.cell_of(xyz)))
    return ThinParts(hull.surface(cells), replaced)


@dataclass(frozen=True, slots=True)
class _Bulk:
    """Which coarse cells, each of two fine ones a side, are in the object's wide parts: mask (X,Y,Z)."""

    mask: Bools

    def holds(self, places: Floats) -> Bools:
        """(N,) whether the places (N,3), in fine cells, are in wide parts."""
        index = np.clip(np.floor(places / 2).astype(np.int64), 0, np.array(self.mask.shape) - 1)
        found: Bools = self.mask[tuple(index.T)]
        return found

    def grown(self) -> _Bulk:
        """Return what is in them, or so near to them that it may be a crest of theirs."""
        return _Bulk(maximum_filter(self.mask.view(np.uint8), _WIDEST + 1) > 0)


@dataclass(frozen=True, slots=True)
class _Hull:
    """A hull that photos (h,w) of evidence bound, in a grid of cells from a corner on. most: photos that may err"""

    pictures: tuple[PosedPicture, ...]
    evidence: tuple[Floats, ...]
    corner: Floats
    cell: float
    counts: Ints
    support: Plane | None
    most: int

    @classmethod
    def of(cls, xyz: Floats, pictures: Sequence[PosedPicture], support: Plane | None) -> _Hull | None:
        """Learn the object's colours; None where they do not tell it from its background."""
        longest = float(np.ptp(xyz, axis=0).max())

        def look(picture: PosedPicture) -> tuple[Bytes, Floats, float] | None:
            shown, at, _ = picture.in_view(xyz)
            if not len(shown):
                return None
            rgb = picture.load_rgb()
            away = np.linalg.norm(xyz[shown] - picture.eye, axis=1)
            pixel = float(np.median(away)) / (float(picture.focal.max()) * max(rgb.shape[:2]))
            cell = max(pixel, longest / _MOST_CELLS)
            return shrink_to(rgb, max(1, round(max(rgb.shape[:2]) * min(1.0, pixel / cell)))), at, cell

        seen = [found for found in in_threads(look, pictures) if found is not None]
        if len(seen) < len(pictures):
            return None
        photos, at, cells = zip(*seen, strict=True)
        colours = ObjectColours.learn(photos, at)
        if colours is None:
            return None
        cell = float(np.median(cells))
        low, high = xyz.min(axis=0) - _COARSE * cell, xyz.max(axis=0) + _COARSE * cell
        counts = np.ceil((high - low) / (_COARSE * cell)).astype(np.int64)
        evidence = tuple(outlined(colours.evidence(rgb)) for rgb in photos)
        return cls(tuple(pictures), evidence, low, cell, counts, support, max(1, len(pictures) // _ONE_OF))

    def cell_of(self, places: Floats) -> Floats:
        """Return places (N,3) in cells from the corner on."""
        return (places - self.corner) / self.cell

    def is_beside(self, places: Floats) -> Bools:
        """(N,) at which places (N,3) more photos show background, a pixel around, than may err."""
        return self._least(places, 1) < 0

    def narrow_cells(self) -> tuple[Floats, _Bulk]:
        """Return the middles (N,3) of the cells in the object's narrow parts, in cells, and its wide parts."""
        hull = np.zeros(_COARSE // 2 * self.counts, bool)
        index: Ints = np.argwhere(np.ones(self.counts, bool))
        for size in (_COARSE, _COARSE // 2):
            index = index if size == _COARSE else _halved(index)
            index = index[self._holds((index + 0.5) * size, _reach(size))]
            inside = self._holds((index + 0.5) * size, -_reach(size))  # such a cell is wider than what is thin
            for corner in product(range(size // 2), repeat=3):
                hull[tuple((size // 2 * index[inside] + corner).T)] = True
            index = index[~inside]
        ends = _ends(index, hull[::2, ::2, ::2])
        index = _halved(index[_near(ends, index, 2 * _AWAY)])
        index = index[self._holds(2.0 * index + 1, _reach(2))]
        hull[tuple(index[self._holds(2.0 * index + 1, 0)].T)] = True
        bulk = _Bulk(_wide(hull))
        middle = _halved(index[_near(ends, index // 2, _AWAY) & ~bulk.holds(2.0 * index + 1)]) + 0.5
        return middle[self._holds(middle, 0)], bulk

    def surface(self, cells: Floats) -> Floats:
        """Return points (M,3) on the hull's surface around cells (N,3), about a cell apart."""
        around = np.floor(cells).astype(np.int64)[:, None] + np.array(list(product((-1, 0, 1), repeat=3)))
        shifted = np.unique(cell_keys(around.reshape(-1, 3) + _COARSE))  # none is negative
        keys = np.unique(cell_keys(_halved(key_cells(shifted))))
        fine = key_cells(keys) - 2 * _COARSE
        value = np.where(self._is_above((fine + 0.5) / 2), self._least(self._places((fine + 0.5) / 2), 0), -MOST)
        met = []
        for axis in np.eye(3, dtype=np.int64):
            wanted = cell_keys(fine + axis + 2 * _COARSE)
            other = np.clip(np.searchsorted(keys, wanted), 0, len(keys) - 1)
            crossing = np.flatnonzero((keys[other] == wanted) & ((value > SURE) != (value[other] > SURE)))
            first, second = value[crossing], value[other[crossing]]
            met.append(fine[crossing] + 0.5 + ((SURE - first) / (second - first))[:, None] * axis)
        places = self._places(np.concatenate(met) / 2)
        return places[np.unique(voxel_keys(places, self.cell), return_index=True)[1]]

    def _places(self, cells: Floats) -> Floats:
        places: Floats = self.corner + self.cell * cells
        return places

    def _holds(self, cells: Floats, radius: int) -> Bools:
        """(N,) whether the hull comes within so many pixels of places (N,3), in cells, above the support; with a
        negative radius, whether it goes on for as many pixels around them."""
        return np.asarray((self._least(self._places(cells), radius) > SURE) & self._is_above(cells, radius))

    def _is_above(self, cells: Floats, radius: int = 0) -> Bools:
        if self.support is None:
            return np.ones(len(cells), bool)
        return np.asarray(self.support.height(self._places(cells)) > -radius * self.cell)

    def _least(self, places: Floats, radius: int) -> Floats:
        """Least of the photos' evidence (N,) at places (N,3), but for that of those which may err: each photo's largest
        within so many pixels, its smallest where the radius is negative."""
        import cv2

        spread, around = (cv2.dilate if radius > 0 else cv2.erode), np.ones((2 * abs(radius) + 1,) * 2, np.uint8)
        wide = [np.asarray(spread(each, around), np.float32)[..., None] for each in self.evidence]

        def least(part: Floats) -> Floats:
            found = np.full((len(self.pictures), len(part)), MOST, np.float32)
            for row, picture, evidence in zip(found, self.pictures, wide, strict=True):
                shown, at, _ = picture.in_view(part)
                row[shown] = bilinear(evidence, at)[:, 0]
            least: Floats = np.partition(found, self.most, axis=0)[self.most]
            return least

        parts = [places[start : start + _CHUNK] for start in range(0, len(places), _CHUNK)]
        return np.concatenate(in_threads(least, parts)) if parts else np.zeros(0, np.float32)


def outlined(evidence: Floats) -> Floats:
    """Return the evidence (h,w) of a photo with that of its outlines alone: what is unsure and not beside background,
    such as a sticker on a fruit, is the object's."""
    import cv2

    beside = cv2.dilate((evidence < -SURE).astype(np.uint8), np.ones((2 * _BESIDE_PX + 1,) * 2, np.uint8)) > 0
    return np.where(beside, evidence, np.float32(MOST))


def _reach(size: int) -> int:
    """Half the diagonal of a cell of so many cells a side, in pixels."""
    return int(np.ceil(np.sqrt(3) / 2 * size))


def _halved(index: Ints) -> Ints:
    """Return the cells (8N,3) of half the size in cells (N,3)."""
    corners = np.array(list(product((0, 1), repeat=3)))
    halves: Ints = (2 * index[:, None] + corners).reshape(-1, 3)
    return halves


def _ends(index: Ints, inside: Bools) -> Bytes:
    """Mask (X,Y,Z) of the cells (N,3), of four fine ones a side, that are away from those wholly inside the hull: most
    things have none, and are done with."""
    ends = np.zeros(inside.shape, np.uint8)
    ends[tuple(index.T)] = 1
    ends[maximum_filter(inside.view(np.uint8), 2 * _AWAY - 1, mode="constant") > 0] = 0
    return ends


def _near(ends: Bytes, index: Ints, reach: int) -> Bools:
    """(N,) which cells (N,3) have one of the ends so near."""
    found: Bools = maximum_filter(ends, 2 * reach + 1, mode="constant")[tuple(index.T)] > 0
    return found


def _wide(hull: Bools) -> Bools:
    """Mask (X,Y,Z) of the coarse cells near those of a hull whose neighbours are all in it: it is wider than thin."""
    core = minimum_filter(hull.view(np.uint8), _WIDEST // 2, mode="constant")
    near: Bools = maximum_filter(core, _WIDEST // 2 + 2, mode="constant") > 0
    return near


def _lines(cells: Floats, wide: _Bulk, measured: Floats) -> Floats:
    """Keep the cells (N,3) of line-shaped parts, which hang together, come away from what is wide, and have some of the
    measured points (M,3), in cells."""
    if len(cells) < max(count for count, _ in _IN_LINE):
        return cells[:0]
    tree, is_line = cKDTree(cells), np.ones(len(cells), bool)
    for count, share in _IN_LINE:
        around = cells[tree.query(cells, k=count, workers=-1)[1]]
        around -= around.mean(axis=1, keepdims=True)
        variances = np.linalg.eigvalsh(np.einsum("nkx,nky->nxy", around, around))
        is_line &= variances[:, 1] < share * variances[:, 2]
    cells = cells[is_line]
    if not len(cells):
        return cells
    index = np.floor(cells).astype(np.int64)
    low = index.min(axis=0)
    mask = np.zeros(index.max(axis=0) - low + 1, bool)
    mask[tuple((index - low).T)] = True
    number = label(mask, np.ones((3, 3, 3)))[0][tuple((index - low).T)]
    large = np.bincount(number) >= _LEAST
    away, nearest = cKDTree(cells).query(measured, distance_upper_bound=_REACH)
    has_points, comes_away = np.zeros(len(large), bool), np.zeros(len(large), bool)
    has_points[number[nearest[np.isfinite(away)]]] = True
    comes_away[number[~wide.holds(cells)]] = True
    kept: Floats = cells[(large & has_points & comes_away)[number]]
    return kept
