"""Close the pin-holes and tears that an extraction leaves, before the trimming decides which of it points back.

Pin-holes get a fan around their middle. Tears, long and narrow, run along tight folds where the field's planes change;
they are zipped: ears of the border, three vertices in a row whose chord is short, are closed from the sharpest on.
"""

from __future__ import annotations

import heapq

import numpy as np

from services.edge.arrays import Floats, Ints
from services.edge.mesh.normals import face_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.topology import border_loops

# An ear at an outer corner would lie back on the faces beside it. At a fold, where both sheets overshoot and pass each
# other, the ear that joins them leans back too, but stands off the faces by more than this.
STANDS_OFF = float(np.cos(np.radians(35)))
BLUNTEST = float(np.cos(np.radians(150)))  # an ear opens by less: the saw-teeth of a straight border stay as they are


def fill_holes(mesh: Mesh, longest: Floats) -> Mesh:
    """Close every border loop shorter than the (V,) longest at its vertices with a fan around its middle.

    Needs a mesh whose vertices have one fan of faces each (`to_manifold`); windings are left to `orient`.
    """
    vertices, faces, count = [mesh.vertices], [mesh.faces], len(mesh.vertices)
    for loop in border_loops(mesh.faces):
        points = mesh.vertices[loop]
        if np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum() > longest[loop].mean():
            continue
        if len(loop) == 3:
            faces.append(loop[None])
            continue
        vertices.append(points.mean(axis=0, keepdims=True))
        faces.append(np.stack([loop, np.roll(loop, -1), np.full(len(loop), count)], axis=1))
        count += 1
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def zip_tears(mesh: Mesh, chord: Floats) -> Mesh:
    """Close ears of the borders whose chord is shorter than the (V,) chord at their middle vertex.

    May leave edges of three faces where two tears meet: `to_manifold` is due before and after.
    """
    inward, normals = _inward(mesh), _some_normals(mesh)
    ears = [ear for loop in border_loops(mesh.faces) for ear in _zip(mesh.vertices, normals, inward, loop, chord)]
    if not ears:
        return mesh
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, np.array(ears)]))


def _inward(mesh: Mesh) -> Floats:
    """(V,3) from each vertex towards the middle of the faces around it, not normalised."""
    corner = mesh.faces.ravel()
    away = np.repeat(mesh.vertices[mesh.faces].mean(axis=1), 3, axis=0) - mesh.vertices[corner]
    return np.stack([np.bincount(corner, away[:, axis], len(mesh.vertices)) for axis in range(3)], axis=1)


def _some_normals(mesh: Mesh) -> Floats:
    """(V,3) unit normal of one of the faces at each vertex, whatever the winding."""
    normals = face_normals(mesh.vertices, mesh.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)
    some = np.zeros_like(mesh.vertices)
    some[mesh.faces] = normals[:, None]
    return some


def _zip(vertices: Floats, normals: Floats, inward: Floats, loop: Ints, chord: Floats) -> list[tuple[int, int, int]]:
    """Ears of one border loop, shortest chord first. `inward` is kept up to date with the ears."""
    place = {v: vertices[v] for v in loop.tolist()}
    after = dict(zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True))
    before = {b: a for a, b in after.items()}
    heap: list[tuple[float, int, int, int]] = []

    def offer(v: int) -> None:
        a, b = before[v], after[v]
        to_a, to_b = place[a] - place[v], place[b] - place[v]
        length = float(np.linalg.norm(to_b - to_a))
        blunt = to_a @ to_b < BLUNTEST * float(np.linalg.norm(to_a) * np.linalg.norm(to_b))
        ear = to_a + to_b
        if length >= chord[v] or blunt:
            return
        across = np.cross(to_a, to_b)
        flat = abs(float(across @ normals[v])) > STANDS_OFF * float(np.linalg.norm(across))
        if not (flat and ear @ inward[v] > 0):
            heapq.heappush(heap, (length, a, v, b))

    for v in after:
        offer(v)
    ears = []
    while heap and len(after) > 3:
        _, a, v, b = heapq.heappop(heap)
        if before.get(v) != a or after.get(v) != b:
            continue  # a neighbour was closed since: the ear was offered again with its new ends
        ears.append((a, v, b))
        middle = (place[a] + place[v] + place[b]) / 3
        inward[a] += middle - place[a]
        inward[b] += middle - place[b]
        del before[v], after[v]
        after[a], before[b] = b, a
        offer(a)
        offer(b)
    if len(after) == 3 and ears:
        v = next(iter(after))
        ears.append((before[v], v, after[v]))
    return ears
