"""Close the pin-holes, tears and slits that an extraction leaves, before parts without points are trimmed.

Pin-holes get a fan of triangles around their middle. Tears, long and narrow, run along tight folds where the field's
planes change; they are zipped: ears of the border, three vertices in a row whose chord is short, are closed from the
sharpest on.
Slits along creases, whose sides lie in two planes, are closed by the triangulation of least area (G. Barequet,
M. Sharir, "Filling gaps in the boundary of a polyhedron", 1995) where that is small.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.edges import border_edges, border_loops, edges_of
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh

# An ear at an outer corner would lie back on the faces beside it. At a fold, where both sheets overshoot and pass each
# other, the ear that joins them leans back too, but stands off the faces by more than this.
STANDS_OFF = float(np.cos(np.radians(35)))
MOST_CORNERS = 200  # of a slit, which take 0.1 s: a longer loop is wider than a slit, or something else
# Ears (triangles between two neighbouring border edges) with a wider angle are not closed: else saw-teeth would be.
BLUNTEST = float(np.cos(np.radians(150)))


Vector = Sequence[float]


def fill_holes(mesh: Mesh, longest: Floats, border: Ints | None = None, *, largest: Floats | None = None) -> Mesh:
    """Fill small holes: close each border loop shorter than `longest` (V,) at its vertices by a triangle fan.

    largest (V,): longer loops are closed too where an area below this suffices.
    Needs a mesh whose vertices have one fan of faces each (`to_manifold`); border is its `border_edges`, where known.
    The new faces are appended, and are wound like those next to each loop's first edge.
    """
    border = border_edges(mesh.faces) if border is None else border
    chords = edges_between(mesh.faces, border) if largest is not None else None
    vertices, faces, count = [mesh.vertices], [mesh.faces], len(mesh.vertices)
    for loop in border_loops(mesh.faces, border):
        points = mesh.vertices[loop]
        if np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum() > longest[loop].mean():
            if largest is not None and chords is not None:
                faces.append(_triangulate_below(largest[loop].mean(), points, loop, chords))
            continue
        if len(loop) == 3:
            faces.append(loop[None, ::-1])
            continue
        vertices.append(points.mean(axis=0, keepdims=True))
        faces.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), count)], axis=1))
        count += 1
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def edges_between(faces: Ints, border: Ints) -> Ints:
    """Edges (C,2) of the mesh between border vertices."""
    rim = np.zeros(int(faces.max(initial=0)) + 1, bool)
    rim[border] = True
    ends = edges_of(faces[rim[faces].sum(axis=1) >= 2]).ends
    between: Ints = ends[rim[ends].all(axis=1)]
    return between


def _triangulate_below(largest: float, points: Floats, loop: Ints, chords: Ints) -> Ints:
    """Triangulate a loop (L,) of vertices at (L,3) with least area; no faces where that is not below `largest`.

    chords (C,2) are edges that the mesh has already: they would get a third face.
    """
    # No triangulation is smaller than the loop's vector area: this rules out most holes at once.
    vector = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) / 2
    if len(points) > MOST_CORNERS or np.linalg.norm(vector) >= largest:
        return np.empty((0, 3), np.int64)
    return triangulate_loop(points, loop, chords, largest)


def triangulate_loop(points: Floats, loop: Ints, chords: Ints, largest: float = np.inf) -> Ints:
    """Triangulate a loop (L,) of vertices at (L,3) with least area, wound like the faces along it.

    No faces (0,3) where the area is not below `largest`, or where chords (C,2), edges that the mesh has already, leave
    no triangulation: they would get a third face.
    """
    order = np.argsort(loop)
    own = chords[np.isin(chords, loop).all(axis=1)]
    forbidden = np.sort(order[np.searchsorted(loop, own, sorter=order)], axis=1)
    area, triangles = _least_area(points, forbidden)
    return loop[triangles[:, ::-1]] if area < largest else np.empty((0, 3), np.int64)


def _least_area(points: Floats, forbidden: Ints) -> tuple[float, Ints]:
    """Triangulate a loop (L,3), L ≥ 3, with least area -> the area, and (L−2,3) corners, wound like the loop.

    forbidden (C,2), each pair rising, are chords that it must not use; the area is ∞ where it cannot avoid them.
    """
    count = len(points)
    least, middle = np.zeros((count, count)), np.zeros((count, count), np.int64)
    barred = np.zeros((count, count), bool)
    # The loop's own edges are no chords.
    barred[forbidden[:, 0], forbidden[:, 1]] = np.ptp(forbidden, axis=1) % (count - 1) > 1
    for gap in range(2, count):
        first = np.arange(count - gap)
        last = first + gap
        between = first[:, None] + np.arange(1, gap)
        start = points[first][:, None]
        corner = np.linalg.norm(np.cross(points[between] - start, points[last][:, None] - start), axis=2) / 2
        whole = least[first[:, None], between] + least[between, last[:, None]] + corner
        best = whole.argmin(axis=1)
        least[first, last] = np.where(barred[first, last], np.inf, whole[first, best])
        middle[first, last] = between[first, best]
    triangles, spans = [], [(0, count - 1)]
    while spans:
        first_corner, last_corner = spans.pop()
        if last_corner - first_corner < 2:
            continue
        between_corner = int(middle[first_corner, last_corner])
        triangles.append((first_corner, between_corner, last_corner))
        spans += [(first_corner, between_corner), (between_corner, last_corner)]
    return float(least[0, count - 1]), np.array(triangles)


def zip_tears(mesh: Mesh, chord: Floats, border: Ints | None = None) -> Mesh:
    """Zip tears: close ears of the borders whose chord is shorter than the (V,) chord at their middle vertex.

    border is the mesh's `border_edges`, where known. The ears are appended to the faces. Call `to_manifold` before and
    after: where two tears meet, edges may get three faces.
    """
    border = border_edges(mesh.faces) if border is None else border
    inward, normals = _inward_and_normals(mesh, border)
    ears = [
        ear
        for loop in border_loops(mesh.faces, border)
        for ear in _zip(mesh.vertices[loop], normals[loop], inward[loop], chord[loop], loop)
    ]
    if not ears:
        return mesh
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, np.array(ears)]))


def _inward_and_normals(mesh: Mesh, border: Ints) -> tuple[Floats, Floats]:
    """For border vertices, else 0: the summed directions (V,3) to the centres of their faces, and one face's normal."""
    rim = np.zeros(len(mesh.vertices), bool)
    rim[border] = True
    faces = mesh.faces[rim[mesh.faces].any(axis=1)]
    corner = faces.ravel()
    away = np.repeat(mesh.vertices[faces].mean(axis=1), 3, axis=0) - mesh.vertices[corner]
    inward: Floats = np.stack([np.bincount(corner, away[:, axis], len(mesh.vertices)) for axis in range(3)], axis=1)
    unit = face_normals(mesh.vertices, faces)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-18)
    normals = np.zeros_like(mesh.vertices)
    normals[faces] = unit[:, None]
    return inward, normals


def _zip(xyz: Floats, normals: Floats, inward: Floats, chord: Floats, loop: Ints) -> list[tuple[int, int, int]]:
    """Close ears of one border loop, shortest chord first -> their triangles. All arrays run along the loop.

    Plain floats, not arrays of three: they take 3 µs in place of 40 for each of thousands of vertices.
    """
    place, across, inside, most = xyz.tolist(), normals.tolist(), inward.tolist(), chord.tolist()
    count = len(loop)
    after, before = [*range(1, count), 0], [count - 1, *range(count - 1)]
    heap: list[tuple[float, int, int, int]] = []

    def push_ear(v: int) -> None:
        a, b = before[v], after[v]
        length = math.dist(place[a], place[b])
        if length < most[v] and _may_close(place[a], place[v], place[b], across[v], inside[v]):
            heapq.heappush(heap, (length, a, v, b))

    for v in range(count):
        push_ear(v)
    ears, left = [], count
    while heap and left > 3:
        _, a, v, b = heapq.heappop(heap)
        if before[v] != a or after[v] != b:
            continue  # outdated: a neighbour was closed since, and the ear was pushed again with its new ends
        ears.append((b, v, a))
        left -= 1
        for end in (a, b):
            inside[end] = [
                i + (p + q + r) / 3 - e
                for i, p, q, r, e in zip(inside[end], place[a], place[v], place[b], place[end], strict=True)
            ]
        after[v] = before[v] = -1
        after[a], before[b] = b, a
        push_ear(a)
        push_ear(b)
    if left == 3 and ears:
        v = ears[-1][0]
        ears.append((after[v], v, before[v]))
    return [(int(loop[a]), int(loop[v]), int(loop[b])) for a, v, b in ears]


def _may_close(a: Vector, v: Vector, b: Vector, normal: Vector, inward: Vector) -> bool:
    """Return whether to close the border corner a-v-b by a triangle: it is sharp, and fills a gap in the surface."""
    ax, ay, az = a[0] - v[0], a[1] - v[1], a[2] - v[2]
    bx, by, bz = b[0] - v[0], b[1] - v[1], b[2] - v[2]
    if ax * bx + ay * by + az * bz < BLUNTEST * math.hypot(ax, ay, az) * math.hypot(bx, by, bz):
        return False
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    flat = abs(x * normal[0] + y * normal[1] + z * normal[2]) > STANDS_OFF * math.hypot(x, y, z)
    leans_back = (ax + bx) * inward[0] + (ay + by) * inward[1] + (az + bz) * inward[2] > 0
    return not (flat and leans_back)
