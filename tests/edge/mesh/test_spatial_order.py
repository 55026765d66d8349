"""Meshes in the order of their places: the same triangles, near ones near in memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spatial_order import by_place
from tests.support import surfaces


def _shuffled(mesh: Mesh, seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    place = rng.permutation(len(mesh.vertices))
    number = np.argsort(place)
    rgb = rng.integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8)
    return Mesh(mesh.vertices[place], rng.permutation(number[mesh.faces]), rgb)


def _triangles(mesh: Mesh) -> Floats:
    """(F,18) corners with their colours, each triangle from its first corner on, in an order of their own."""
    assert mesh.rgb is not None
    corners = np.concatenate([mesh.vertices, mesh.rgb], axis=1)[mesh.faces]
    rank = np.lexsort(corners.reshape(-1, 6).T[::-1]).argsort().reshape(-1, 3)
    from_first = (rank.argmin(axis=1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(corners, from_first[..., None], axis=1).reshape(-1, 18)
    return turned[np.lexsort(turned.T[::-1])]


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1e-6, 1.0, 1e6]))
@settings(max_examples=8)
def test_the_triangles_their_winding_and_their_colours_stay(seed: int, scale: float) -> None:
    mesh = _shuffled(surfaces.hemisphere(), seed)
    mesh = Mesh(scale * mesh.vertices, mesh.faces, mesh.rgb)
    assert (_triangles(by_place(mesh)) == _triangles(mesh)).all()


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_what_is_near_is_near_in_memory(flat: int) -> None:
    mesh = _shuffled(surfaces.hemisphere(), 1)
    vertices = mesh.vertices.copy()
    vertices[:, flat] = 7.0
    ordered = by_place(Mesh(vertices, mesh.faces, mesh.rgb))

    def apart(mesh: Mesh) -> float:
        return float(np.ptp(mesh.faces, axis=1).mean())

    assert apart(ordered) < 0.15 * apart(mesh)
    assert (np.diff(ordered.faces.min(axis=1)) >= 0).all()


def test_one_place_is_an_order_too() -> None:
    mesh = Mesh(np.ones((3, 3)), np.array([[2, 0, 1]]))
    ordered = by_place(mesh)
    assert ordered.faces.tolist() == [[2, 0, 1]]
    assert ordered.rgb is None
