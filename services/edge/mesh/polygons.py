"""Triangulate the polygons of meshes: as fans where they are convex, and by ear clipping where they are not."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints

_AT_ONCE = 1_000_000
"""Corners that are looked at together: each takes 200 bytes meanwhile."""
_MOST_CORNERS = 1_024
"""Of a polygon that is cut by ear clipping: at worst that takes the square of their number, and a file may have one
polygon of millions."""
_REFLEX = 1e-6
"""Share of a polygon's area by which a corner must turn back: rounded coordinates of a straight side do so, too."""


def triangulate(xyz: Floats, corners: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Cut polygons into triangles: rows of `corners` (T,3), and the polygon (T,) of each.

    xyz (V,3); corners (C,) indices of vertices, one polygon after another; sizes (P,), each at least 3. A polygon that
    is not flat is cut as it is seen along its mean normal; one of more than 1,024 corners is always a fan.
    """
    first = np.cumsum(sizes) - sizes
    polygon = np.repeat(np.arange(len(sizes)), sizes - 2)
    start = np.cumsum(sizes - 2) - (sizes - 2)
    within = np.arange(len(polygon)) - start[polygon]
    rows = first[polygon][:, None] + np.stack([0 * within, within + 1, within + 2], axis=1)
    kept = np.ones(len(rows), bool)
    many = np.flatnonzero((sizes > 3) & (sizes <= _MOST_CORNERS))
    for part in np.split(many, np.flatnonzero(np.diff(np.cumsum(sizes[many]) // _AT_ONCE)) + 1):
        concave, reflex = _concave(xyz, corners, first[part], sizes[part])
        quads = concave & (sizes[part] == 4)
        turned = (np.array([[0, 1, 2], [0, 2, 3]]) + reflex[quads, None, None]) % 4
        rows[start[part[quads], None] + np.arange(2)] = first[part[quads], None, None] + turned
        for number in part[concave & ~quads]:
            ears = _ears(xyz[corners[first[number] : first[number] + sizes[number]]])
            if len(ears):
                fan = slice(start[number], start[number] + sizes[number] - 2)
                kept[fan] = np.arange(sizes[number] - 2) < len(ears)
                rows[fan][: len(ears)] = first[number] + ears
    return rows[kept], polygon[kept]


def _concave(xyz: Floats, corners: Ints, first: Ints, sizes: Ints) -> tuple[Bools, Ints]:
    """(P,) which polygons turn back at a corner, and (P,) the corner that turns most."""
    if not len(sizes):
        return np.zeros(0, bool), np.zeros(0, np.int64)
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    begin = np.cumsum(sizes) - sizes
    within = np.arange(len(polygon)) - begin[polygon]
    size, base = sizes[polygon], first[polygon]
    before, at, after = (xyz[corners[base + (within + step) % size]] for step in (-1, 0, 1))
    origin = xyz[corners[first]][polygon]
    normal = np.add.reduceat(np.cross(at - origin, after - origin), begin)  # twice the area long
    turn = np.einsum("cx,cx->c", np.cross(at - before, after - at), normal[polygon])
    least = np.minimum.reduceat(turn, begin)
    concave: Bools = least < -_REFLEX * np.einsum("px,px->p", normal, normal)
    most = np.zeros(len(sizes), np.int64)
    at_most = np.flatnonzero(turn == least[polygon])
    most[polygon[at_most]] = within[at_most]
    return concave, most


def _ears(xyz: Floats) -> Ints:
    """Cut a polygon of corners (N,3) into at most N−2 triangles (T,3), turned as it is; none where it is degenerate."""
    from mapbox_earcut import triangulate_float64

    relative = xyz - xyz[0]
    normal = np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0)
    first, second = (axis for axis in range(3) if axis != int(np.abs(normal).argmax()))
    flat = relative[:, [first, second]]
    ears = np.asarray(triangulate_float64(flat, np.array([len(xyz)], np.uint32)), np.int64).reshape(-1, 3)
    a, b, c = (flat[ears[:, corner]] for corner in range(3))
    x, y = np.roll(flat, -1, axis=0).T
    area = float((flat[:, 0] * y - x * flat[:, 1]).sum())
    turned = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) * area < 0
    ears[turned] = ears[turned, ::-1]
    return ears
