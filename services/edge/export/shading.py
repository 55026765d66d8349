"""Smooth vertex normals of a mesh for rendering and export: vertices are duplicated where they need two normals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints, pick
from capture2vr.edge.mesh.normals import split_flips, sum_at_vertices, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh


@dataclass(frozen=True, slots=True)
class Shaded:
    """A mesh with vertex normals. Vertices are duplicated where a position has two normals or two texture coordinates.

    mesh     its faces are the given ones, in their order
    normals  (V,3) float64, unit length
    uv       (V,2) float64 as in `TexturedMesh`, or None
    tangents (V,4) float64 as glTF defines them, or None: a unit vector along u, and the sign of the bitangent, which
             points up in the picture
    """

    mesh: Mesh
    normals: Floats
    uv: Floats | None
    tangents: Floats | None = None

    def with_vertices(self, which: Bools | Ints, faces: Ints) -> Shaded:
        """Select vertices by a mask, or by indices in a new order, with `faces` (F,3) over the selected ones."""
        mesh, tangents = self.mesh.with_vertices(which, faces), pick(self.tangents, which)
        return Shaded(mesh, self.normals[which], pick(self.uv, which), tangents)


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
    mesh = Mesh(welded.vertices[in_welded], faces.reshape(-1, 3), origin=pick(welded.origin, in_welded))
    return Shaded(mesh, normals[in_welded], subject.uv[in_textured])


def with_tangents(surface: Shaded) -> Shaded:
    """Add the tangents that a normal map needs. The surface must have texture coordinates."""
    assert surface.uv is not None
    faces, normals = surface.mesh.faces, surface.normals
    a, b, c = (surface.mesh.vertices[faces[:, corner]] for corner in range(3))
    (du1, dv1), (du2, dv2) = ((surface.uv[faces[:, k]] - surface.uv[faces[:, 0]]).T[:, :, None] for k in (1, 2))
    turned = np.sign(du1 * dv2 - du2 * dv1)
    along_u, up = (
        sum_at_vertices(faces, np.repeat(each, 3, axis=0), len(normals))
        for each in (turned * ((b - a) * dv2 - (c - a) * dv1), -turned * ((c - a) * du1 - (b - a) * du2))
    )
    along_u -= np.einsum("nx,nx->n", along_u, normals)[:, None] * normals
    length = np.linalg.norm(along_u, axis=1, keepdims=True)
    anywhere = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    anywhere /= np.maximum(np.linalg.norm(anywhere, axis=1, keepdims=True), 1e-12)
    along_u = np.where(length > 0, along_u / np.maximum(length, 1e-300), anywhere)
    sign = np.where(np.einsum("nx,nx->n", np.cross(normals, along_u), up) < 0, -1.0, 1.0)
    return replace(surface, tangents=np.column_stack([along_u, sign]))


def _weld(mesh: Mesh) -> Mesh:
    """Merge vertices at the same position."""
    vertices, first, own = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    corners: Ints = own.ravel()[mesh.faces]
    return Mesh(vertices, corners, origin=pick(mesh.origin, first))
