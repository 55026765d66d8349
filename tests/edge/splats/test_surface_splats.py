"""Splats cover a surface evenly: they lie on it, face as it does, and have its colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.splats.surface_splats import cover_with_splats
from tests.support.downloadable import SHEET, coloured, textured

triangles = st.integers(0, 2**32 - 1).map(
    lambda seed: Mesh(np.random.default_rng(seed).normal(size=(60, 3)), np.arange(60).reshape(-1, 3))
)


def in_triangle(mesh: Mesh, places: Floats) -> Bools:
    """Mask (N,F) of the triangles that places (N,3) lie in."""
    first, one, other = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    axes = np.stack([one - first, other - first, np.cross(one - first, other - first)], axis=2)
    u, v, w = np.moveaxis(np.einsum("fij,nfj->nfi", np.linalg.inv(axes), places[:, None] - first), -1, 0)
    height = np.abs(w) * np.linalg.norm(axes[:, :, 2], axis=1)
    inside: Bools = (np.minimum(np.minimum(u, v), 1 - u - v) > -1e-4) & (height < 1e-5)
    return inside


def facing(mesh: Mesh, normals: Floats) -> Bools:
    """Mask (N,F) of the triangles with these normals (N,3)."""
    own = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    same: Bools = normals @ np.asarray(own).T > 1 - 1e-5
    return same


@given(triangles, st.integers(1, 2_000))
@settings(max_examples=50, deadline=None)
def test_splats_lie_on_their_triangles_and_every_triangle_has_its_share(mesh: Mesh, count: int) -> None:
    splats = cover_with_splats(mesh, count)
    assert len(splats) == count
    normal = Rotation.from_quat(splats.rotation).as_matrix()[:, :, 2]
    assert (in_triangle(mesh, splats.xyz) & facing(mesh, normal)).any(axis=1).all()
    np.testing.assert_allclose(np.linalg.norm(splats.rotation, axis=1), 1, atol=1e-5)


@given(st.integers(0, 2**32 - 1), st.integers(100, 3_000))
@settings(max_examples=30, deadline=None)
def test_the_splats_of_a_part_are_as_many_as_its_area_asks_for(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = rng.uniform(0, 1, (2, 3)), rng.uniform(0, 3, (2, 3))
    one, other = (
        Mesh(np.asarray(each), np.array([[0, 1, 2]])) for each in (np.vstack([low, high[:1]]), rng.normal(size=(3, 3)))
    )
    both = Mesh(np.concatenate([one.vertices, other.vertices + 100]), np.array([[0, 1, 2], [3, 4, 5]]))
    first = int((cover_with_splats(both, count).xyz[:, 0] < 50).sum())
    assert abs(first - count * area(one) / area(both)) <= 1


def test_no_place_of_the_surface_is_far_from_a_splat() -> None:
    splats = cover_with_splats(SHEET, 5_000)
    places, _ = trimesh.sample.sample_surface(trimesh.Trimesh(SHEET.vertices, SHEET.faces), 20_000, seed=0)
    spacing = np.sqrt(area(SHEET) / len(splats))
    away, _ = cKDTree(splats.xyz).query(places)
    assert away.max() < 1.7 * spacing
    assert splats.scale[:, :2].min() > 0.3 * spacing
    assert (splats.scale[:, 2] < 0.5 * splats.scale[:, 0]).all()


def test_splats_have_the_texture_or_the_colours_of_the_vertices() -> None:
    of_vertices = cover_with_splats(coloured(), 3_000)
    left, right = of_vertices.xyz[:, 0].argmin(), of_vertices.xyz[:, 0].argmax()
    assert of_vertices.rgb[left, 0] > 240 > 60 > of_vertices.rgb[left, 2]
    assert of_vertices.rgb[right, 2] > 240 > 60 > of_vertices.rgb[right, 0]
    painted = cover_with_splats(textured(), 3_000)
    low, high = SHEET.vertices.min(axis=0), SHEET.vertices.max(axis=0)
    across = (painted.xyz - low)[:, :2] / (high - low)[:2]
    inner = (np.abs(across - 0.5) > 0.1).all(axis=1)
    quarter = 2 * (across[inner, 1] > 0.5) + (across[inner, 0] > 0.5)
    means = [painted.rgb[inner][quarter == number].mean(axis=0) for number in range(4)]
    spreads = [painted.rgb[inner][quarter == number].std(axis=0).max() for number in range(4)]
    assert max(spreads) < 6
    assert min(np.abs(one - other).max() for i, one in enumerate(means) for other in means[:i]) > 50
    grey = cover_with_splats(replace(coloured(), rgb=None), 10)
    assert len({tuple(each) for each in grey.rgb}) == 1


def test_what_has_no_area_is_told() -> None:
    with pytest.raises(ValueError, match="without area"):
        cover_with_splats(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
