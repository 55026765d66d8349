"""Find the points of the object that a person drew a rectangle around, in one of several photos.

1. seeds      points that this photo shows in the middle of the rectangle are the object's, those far outside are not
2. grow       every other point goes with the seeds that are nearest along the surface, where its colours stay alike
3. vote       outlines of these points in all photos, by GrabCut, tell of every point whether it is the object's
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import ShownPicture
from capture2vr.edge.marking.outline_points import beside_and_on, outline_points, seen_points
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.points.clusters import LEAST_POINTS, LINK_SPACINGS, TOUCH_LINKS, spacing, with_touching
from capture2vr.edge.points.outliers import label_components
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.order.photo_box import PhotoBox

_CORE = 0.25
"""Radius of the ellipse in a rectangle whose surface is the object's, over half of the rectangle's sides: with 0.5 it
had an apple in a rectangle around bananas that lie at an angle."""
_OUTSIDE = 1.2
"""The same of the rectangle outside of which nothing is the object's: people draw through an object's rim."""
_WITHIN = 0.9
"""Share of a cluster's visible points that lie in the rectangle of one that stands in it alone."""
_LEAST_SEEDS = 30
"""Least points of the object that the marked photo shows."""
_CELL_SPACINGS = 2.0
"""Side, in spacings of the points, of the cells along which the seeds grow."""
_ROUNDS = 2
"""Of voting: where objects touch, the outlines of the second are of the right colours."""
_ANOTHER_COLOUR = 10.0
"""Change of sRGB from a cell to the next that makes the way as much longer as it is itself."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A rectangle in an upright photo, and the photo with its camera in the points' frame."""

    picture: PosedPicture
    shown: ShownPicture
    box: PhotoBox

    def places(self, at: Floats) -> Floats:
        """Map positions (M,2) in the picture to positions relative to the rectangle, whose sides are at -1 and 1."""
        box = np.array(self.box.values).reshape(2, 2)
        return np.asarray((self.shown.to_upright(at) - box.mean(axis=0)) / (np.ptp(box, axis=0) / 2))


@dataclass(frozen=True, slots=True)
class _Seeds:
    """Indices of points that the marked photo shows: all of them, those in the rectangle, those that are the object's,
    and those that are not."""

    shown: Ints
    boxed: Ints
    first: Ints
    others: Ints


def middle_of(mark: Mark, xyz: Floats) -> Floats | None:
    """Return the middle (3,) of the points (N,3) that the photo shows in the middle of the rectangle; None without."""
    seen = seen_points(mark.picture, xyz)
    core = np.linalg.norm(mark.places(seen.at), axis=1) < _CORE
    return np.median(xyz[seen.index[core]], axis=0) if core.any() else None


def choose_marked(
    xyz: Floats, rgb: Bytes | None, candidates: Bools, mark: Mark, pictures: Sequence[PosedPicture]
) -> Bools:
    """Choose the marked object's points among candidates; masks (N,) of the points (N,3) with colours (N,3).

    pictures  all photos with their cameras, the marked one too
    Returns no point where the marked photo shows too few of the candidates in the rectangle.
    """
    thing = np.zeros(len(xyz), bool)
    index = np.flatnonzero(candidates)
    seeds = _find_seeds(xyz, candidates, mark)
    if len(index) < LEAST_POINTS or len(seeds.first) < _LEAST_SEEDS:
        return thing
    near, link = xyz[index], LINK_SPACINGS * spacing(xyz[index])
    label = label_components(near, link)
    alone, first = _stands_alone(label, seeds)[label], np.isin(label, label[seeds.first])
    if alone[first].all():
        thing[index[alone]] = with_touching(near[alone], label[alone], first[alone], TOUCH_LINKS * link)
        return thing
    thing[index] = (alone & first) | _grow(near, None if rgb is None else rgb[index], seeds, TOUCH_LINKS * link)
    for _ in range(_ROUNDS):
        thing = _vote(xyz, thing, pictures) & candidates
    thing[index] = _connected(near, thing[index], seeds.first, link)
    return thing


def _find_seeds(xyz: Floats, candidates: Bools, mark: Mark) -> _Seeds:
    """Find the seeds among the candidates (N,), of which their indices are. Where none is in the middle of the
    rectangle, those anywhere in it are the object's."""
    seen = seen_points(mark.picture, xyz)
    shown = candidates[seen.index]
    place = mark.places(seen.at[shown])
    index = (np.cumsum(candidates) - 1)[seen.index[shown]]
    aside = np.abs(place).max(axis=1)
    boxed, core = index[aside <= 1], index[np.linalg.norm(place, axis=1) < _CORE]
    return _Seeds(index, boxed, core if len(core) >= _LEAST_SEEDS else boxed, index[aside > _OUTSIDE])


def _stands_alone(label: Ints, seeds: _Seeds) -> Bools:
    """Tell of each cluster (C,) whether it stands in the rectangle, and so belongs to one object as a whole."""
    shown, boxed = (np.bincount(label[each], minlength=label.max() + 1) for each in (seeds.shown, seeds.boxed))
    return np.asarray((shown > 0) & (boxed >= _WITHIN * shown))


def _grow(xyz: Floats, rgb: Bytes | None, seeds: _Seeds, reach: float) -> Bools:
    """Tell which points (N,3) are nearer, along the surface, to the object's first points than to other ones.

    rgb    (N,3) their colours: a step across an edge between two colours is a long one
    reach  of the longest step
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    side = _CELL_SPACINGS * reach / (LINK_SPACINGS * TOUCH_LINKS)
    _, cell = np.unique(np.floor((xyz - xyz.min(axis=0)) / side).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    middle = _means(xyz, cell)
    a, b = cKDTree(middle).query_pairs(reach, output_type="ndarray").T
    # Squared: a way in small steps along the surface is shorter than one that jumps over a gap.
    steps = ((middle[a] - middle[b]) ** 2).sum(axis=1)
    if rgb is not None:
        colour = _means(rgb, cell)
        steps *= 1 + ((colour[a] - colour[b]) ** 2).sum(axis=1) / _ANOTHER_COLOUR**2
    graph = coo_array((steps, (a, b)), shape=(len(middle), len(middle))).tocsr()
    mine, theirs = (np.bincount(cell[each], minlength=len(middle)) for each in (seeds.first, seeds.others))
    starts = np.flatnonzero(mine > theirs), np.flatnonzero((theirs > 0) & (theirs >= mine))
    away = [
        dijkstra(graph, directed=False, indices=start, min_only=True) if len(start) else np.full(len(middle), np.inf)
        for start in starts
    ]
    return np.asarray((away[0] < away[1])[cell])


def _means(values: Floats | Bytes, cell: Ints) -> Floats:
    """Return the means (C,3) of the values (N,3) in each cell."""
    size = np.bincount(cell)
    return np.stack([np.bincount(cell, column) / size for column in values.T.astype(np.float64)], axis=1)


def _vote(xyz: Floats, thing: Bools, pictures: Sequence[PosedPicture]) -> Bools:
    """Return which points (N,) are the object's as most photos see it; where these do not tell, as before."""
    on, beside = (np.zeros(len(xyz), np.int16) for _ in range(2))

    def ask(picture: PosedPicture) -> tuple[Ints, Bools, Bools] | None:
        seen = seen_points(picture, xyz)
        outline = outline_points(picture, seen, thing)
        return None if outline is None else (seen.index, *beside_and_on(outline, seen.at))

    for answer in in_threads(ask, pictures):
        if answer is not None:
            index, is_beside, is_on = answer
            beside[index] += is_beside
            on[index] += is_on
    return np.where(on == beside, thing, on > beside)


def _connected(xyz: Floats, chosen: Bools, first: Ints, link: float) -> Bools:
    """Keep the chosen points (N,) that hang together with the cluster that has most of the first ones."""
    kept = np.zeros(len(xyz), bool)
    is_first = np.zeros(len(xyz), bool)
    is_first[first] = True
    index = np.flatnonzero(chosen)
    if len(index) < LEAST_POINTS or not is_first[index].any():
        return kept
    label = label_components(xyz[index], link)
    main = label == np.argmax(np.bincount(label[is_first[index]]))
    kept[index[with_touching(xyz[index], label, main, link)]] = True
    return kept
