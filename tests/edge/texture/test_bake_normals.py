"""A simplified mesh with a normal map is lit like the full one."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.export.shading import shaded
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.texture.bake import find_texels, interpolate
from capture2vr.edge.texture.bake_normals import FullShape, bake_normals
from capture2vr.edge.texture.unwrap import unwrap
from tests.support import surfaces

SIDE = 256
HEIGHT, WAVES = 0.004, 60.0  # of ripples along x, and radians per unit


def rippled(flat: Mesh) -> Mesh:
    """A flat sheet with ripples along x."""
    x, y, z = flat.vertices.T
    return Mesh(np.stack([x, y, z + HEIGHT * np.sin(WAVES * x)], axis=1), flat.faces)


FLAT = surfaces.patch(lambda u, v: [u, v, 0 * u], 200, 200)
COARSE = surfaces.patch(lambda u, v: [u, v, 0 * u], 4, 4)


def unwrapped(mesh: Mesh) -> TexturedMesh:
    made = unwrap(mesh, side=SIDE)
    return TexturedMesh(made.mesh, made.uv, b"", SIDE)


def true_normals(x: Floats) -> Floats:
    """(N,3) unit normals of the ripples."""
    slope = HEIGHT * WAVES * np.cos(WAVES * x)
    normal = np.stack([-slope, 0 * x, np.ones(len(x))], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def decoded(level: TexturedMesh, jpeg: bytes) -> tuple[Floats, Floats]:
    """Places (N,3) of the map's texels, and the normals (N,3) that a renderer makes of it, by glTF's definition."""
    picture = np.asarray(Image.open(io.BytesIO(jpeg)), np.float64).reshape(-1, 3)
    surface = shaded(level)
    assert surface.uv is not None
    texels = find_texels(surface.mesh.faces, surface.uv, SIDE)
    corners = surface.mesh.faces[texels.face]
    normals = interpolate(surface.normals, corners, texels.bary)
    # The place is a linear function of (u, v) on each face: its derivatives are the tangents.
    uv, xyz = surface.uv[corners], surface.mesh.vertices[corners]
    to_place = np.linalg.solve(uv[:, 1:] - uv[:, :1], xyz[:, 1:] - xyz[:, :1])
    tangent, bitangent = to_place[:, 0], -to_place[:, 1]  # u to the right, v downwards: green is up
    local = picture[texels.place] / 127.5 - 1
    axes = [axis / np.linalg.norm(axis, axis=1, keepdims=True) for axis in (tangent, bitangent, normals)]
    seen = sum(local[:, number, None] * axis for number, axis in enumerate(axes))
    assert isinstance(seen, np.ndarray)
    return interpolate(surface.mesh.vertices, corners, texels.bary), seen / np.linalg.norm(seen, axis=1, keepdims=True)


@pytest.mark.parametrize("turned", [False, True], ids=["upwards", "downwards"])
def test_ripples_that_a_flat_level_lacks_are_in_its_map(turned: bool) -> None:
    """Whichever way the faces of the full mesh are wound."""
    full = rippled(FLAT)
    level = unwrapped(COARSE)
    jpeg = bake_normals(level, FullShape(replace(full, faces=full.faces[:, ::-1]) if turned else full), side=SIDE)
    assert jpeg is not None
    places, seen = decoded(level, jpeg)
    inner = (np.abs(places[:, :2]) < 0.45).all(axis=1)
    side = np.sign(seen[inner, 2])[:, None]
    off = np.degrees(
        np.arccos(np.clip(np.einsum("nx,nx->n", side * seen[inner], true_normals(places[inner, 0])), -1, 1))
    )
    assert np.degrees(np.arctan(HEIGHT * WAVES)) > 13  # what a flat level is off
    assert np.median(off) < 1.5
    assert np.percentile(off, 95) < 4


def test_charts_that_are_turned_show_the_same() -> None:
    """A ball is unwrapped into charts that lie in all directions."""
    fine, coarse = (
        surfaces.patch(lambda u, v: surfaces._on_sphere(2 * np.pi * u, np.pi * v), cells, cells // 2)
        for cells in (400, 40)
    )
    bumps = 1 + 0.01 * np.sin(40 * fine.vertices[:, 1])
    full = Mesh(fine.vertices * bumps[:, None], fine.faces)
    level = unwrapped(coarse)
    jpeg = bake_normals(level, FullShape(full), side=SIDE)
    assert jpeg is not None
    places, seen = decoded(level, jpeg)
    normals = vertex_normals(full)
    true = normals[cKDTree(full.vertices).query(places)[1]]
    off = np.degrees(np.arccos(np.clip(np.abs(np.einsum("nx,nx->n", seen, true)), -1, 1)))
    assert np.median(off) < 3
    plain = places / np.linalg.norm(places, axis=1, keepdims=True)
    assert np.median(np.degrees(np.arccos(np.clip(np.abs(np.einsum("nx,nx->n", plain, true)), -1, 1)))) > 5


def test_a_full_mesh_that_is_no_different_needs_no_map() -> None:
    assert bake_normals(unwrapped(COARSE), FullShape(FLAT), side=SIDE) is None


def test_what_lies_far_off_is_not_taken() -> None:
    """Ripples on another sheet, 3 % away, are none of the level's."""
    above = rippled(FLAT)
    above = Mesh(above.vertices + np.array([0, 0, 0.03]), above.faces)
    assert bake_normals(unwrapped(COARSE), FullShape(above), side=SIDE) is None


def test_it_can_be_stopped() -> None:
    def stop(_: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        bake_normals(unwrapped(COARSE), FullShape(rippled(FLAT)), side=SIDE, tick=stop)
