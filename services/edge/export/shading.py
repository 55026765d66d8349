"""A mesh as pictures and files show it: one smooth normal a vertex, whatever its colours are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Floats, Ints
from services.edge.mesh.normals import split_flips, vertex_normals
from services.edge.mesh.nouns import Mesh, Textured


@dataclass(frozen=True, slots=True)
class Shaded:
    """Vertices are doubled where one place has two normals or two places in the picture.

    mesh     its faces are the given ones, in their order
    normals  (V,3) float64, unit length
    uv       (V,2) float64 as in `Textured`, or None
    """

    mesh: Mesh
    normals: Floats
    uv: Floats | None


def shaded(subject: Mesh | Textured) -> Shaded:
    """The mesh with its normals. They go on over the seams of a picture, which no one should see."""
    if isinstance(subject, Mesh):
        mesh = split_flips(subject)
        return Shaded(mesh, vertex_normals(mesh), None)
    welded = split_flips(_welded(subject.mesh))
    normals = vertex_normals(welded)
    count = len(welded.vertices)
    pairs, faces = np.unique(subject.mesh.faces * count + welded.faces, return_inverse=True)
    in_picture, in_welded = np.divmod(pairs, count)
    mesh = Mesh(welded.vertices[in_welded], faces.reshape(-1, 3))
    return Shaded(mesh, normals[in_welded], subject.uv[in_picture])


def _welded(mesh: Mesh) -> Mesh:
    """The mesh with vertices of the same place made one."""
    vertices, own = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners: Ints = own.ravel()[mesh.faces]
    return Mesh(vertices, corners)
