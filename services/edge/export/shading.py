"""Smooth vertex normals of a mesh for rendering and export: vertices are duplicated where they need two normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Bools, Floats, Ints, pick
from services.edge.mesh.normals import split_flips, vertex_normals
from services.edge.mesh.nouns import Mesh, TexturedMesh


@dataclass(frozen=True, slots=True)
class Shaded:
    """A mesh with vertex normals. Vertices are duplicated where a position has two normals or two texture coordinates.

    mesh     its faces are the given ones, in their order
    normals  (V,3) float64, unit length
    uv       (V,2) float64 as in `TexturedMesh`, or None
    """

    mesh: Mesh
    normals: Floats
    uv: Floats | None

    def with_vertices(self, which: Bools | Ints, faces: Ints) -> Shaded:
        """Select vertices by a mask, or by indices in a new order, with `faces` (F,3) over the selected ones."""
        return Shaded(self.mesh.with_vertices(which, faces), self.normals[which], pick(self.uv, which))


def shaded(subject: Mesh | TexturedMesh) -> Shaded:
    """Compute a mesh's vertex normals. They are continuous across texture seams, so that the seams do not show."""
    if isinstance(subject, Mesh):
        mesh = split_flips(subject)
        return Shaded(mesh, vertex_normals(mesh), None)
    welded = split_flips(_weld(subject.mesh))
    normals = vertex_normals(welded)
    count = len(welded.vertices)
    pairs, faces = np.unique(subject.mesh.faces * count + welded.faces, return_inverse=True)
    in_textured, in_welded = np.divmod(pairs, count)
    mesh = Mesh(welded.vertices[in_welded], faces.reshape(-1, 3))
    return Shaded(mesh, normals[in_welded], subject.uv[in_textured])


def _weld(mesh: Mesh) -> Mesh:
    """Merge vertices at the same position."""
    vertices, own = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners: Ints = own.ravel()[mesh.faces]
    return Mesh(vertices, corners)
