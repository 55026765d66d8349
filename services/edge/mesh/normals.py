"""Smooth vertex normals for meshes of any kind: open, closed, and those that no winding can orient.

On a Möbius strip there is always a seam where two faces disagree about which side is the front. Normals averaged across
it cancel, so `split_flips` first gives each side of the seam its own vertices.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh


def face_normals(vertices: Floats, faces: Ints) -> Floats:
    """(F,3) normals of length 2 × area; zero for a degenerate face."""
    # Column by column: a third of the time of np.cross, and the same numbers.
    first = vertices.take(faces[:, 0], axis=0)
    (ax, ay, az), (bx, by, bz) = ((vertices.take(faces[:, corner], axis=0) - first).T for corner in (1, 2))
    normals: Floats = np.empty((len(faces), 3), vertices.dtype)
    normals[:, 0] = ay * bz - az * by
    normals[:, 1] = az * bx - ax * bz
    normals[:, 2] = ax * by - ay * bx
    return normals


def vertex_normals(mesh: Mesh) -> Floats:
    """(V,3) float64 unit normals: the faces' normals weighted by area and by their angle at the vertex.

    A vertex whose normals cancel, or that no face uses, gets the normal of its largest face, or +Y.
    """
    area_normal = face_normals(mesh.vertices, mesh.faces)
    weighted = _corner_angles(mesh)[:, :, None] * area_normal[:, None, :]
    corner = mesh.faces.ravel()
    flat = weighted.reshape(-1, 3)
    summed = sum_at_vertices(mesh.faces, flat, len(mesh.vertices))
    total = np.bincount(corner, np.linalg.norm(flat, axis=1), len(mesh.vertices))
    length = np.linalg.norm(summed, axis=1)
    cancelled = length <= 1e-6 * total  # rounding of a sum that should be zero
    if cancelled.any():
        summed[cancelled] = _largest_face_normal(mesh.faces, area_normal, cancelled)[cancelled]
    normals: Floats = summed / np.linalg.norm(summed, axis=1, keepdims=True)
    return normals


def sum_at_vertices(faces: Ints, values: Floats, count: int) -> Floats:
    """Sum values (3·F,3), one row for each corner of the faces (F,3), at each of `count` vertices: (count,3)."""
    corner = faces.ravel()
    summed: Floats = np.stack([np.bincount(corner, each, count) for each in values.T], axis=1)
    return summed


def split_flips(mesh: Mesh) -> Mesh:
    """Split the mesh along edges whose two faces have opposite winding, by doubling vertices there."""
    seam = _on_flipped_edge(mesh.faces, len(mesh.vertices))
    if not seam.any():
        return mesh
    normal = face_normals(mesh.vertices, mesh.faces)
    reference = np.zeros((len(mesh.vertices), 3))
    reference[mesh.faces] = normal[:, None, :]  # any one face of the vertex names the side that keeps it
    back = seam[mesh.faces] & (np.einsum("fcx,fx->fc", reference[mesh.faces], normal) < 0)
    doubled = np.unique(mesh.faces[back])
    faces = mesh.faces.copy()
    faces[back] = len(mesh.vertices) + np.searchsorted(doubled, mesh.faces[back])
    return mesh.with_vertices(np.concatenate([np.arange(len(mesh.vertices)), doubled]), faces)


def _on_flipped_edge(faces: Ints, count: int) -> Bools:
    """(V,) True at the ends of edges that two faces walk in the same direction."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = np.sort(ends[:, 0] * count + ends[:, 1])
    twice = keys[1:][keys[1:] == keys[:-1]]
    flipped = np.zeros(count, dtype=np.bool_)
    flipped[twice // count] = flipped[twice % count] = True
    return flipped


def _corner_angles(mesh: Mesh) -> Floats:
    """Corner angles (F,3) in radians; any angle at an edge without length, since the face has no area to weigh."""
    corners = mesh.vertices[mesh.faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(ahead, axis=2)
    ahead = np.divide(ahead, length[:, :, None], out=np.zeros_like(ahead), where=length[:, :, None] > 0)
    cosine = -np.einsum("fcx,fcx->fc", ahead, np.roll(ahead, 1, axis=1))
    angles: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angles


def _largest_face_normal(faces: Ints, area_normal: Floats, chosen: Bools) -> Floats:
    """Normal (V,3) of the largest face at each chosen vertex, +Y where there is none."""
    largest = np.tile([0.0, 1.0, 0.0], (len(chosen), 1))
    near = np.flatnonzero(chosen[faces].any(axis=1))
    size = np.linalg.norm(area_normal[near], axis=1)
    rising = near[np.argsort(size, kind="stable")]
    rising = rising[np.sort(size) > 0]
    for corner in range(3):
        # Later writes win, so each vertex ends with its largest face.
        largest[faces[rising, corner]] = area_normal[rising]
    return largest
