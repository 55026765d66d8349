"""The published extraction: on the surface, cell by cell, nothing joined."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.extract_published import extract_published
from capture2vr.edge.mesh.sampling import area

RADIUS = 0.4


def ball(q: Floats) -> tuple[Floats, Floats]:
    """Unsigned distance to a sphere, and its gradient."""
    away = np.linalg.norm(q, axis=1)
    sign = np.sign(away - RADIUS)
    return np.abs(away - RADIUS), q / np.maximum(away, 1e-12)[:, None] * sign[:, None]


def on_the_ball(count: int = 2_000) -> Floats:
    direction = np.random.default_rng(0).normal(size=(count, 3))
    return np.asarray(RADIUS * direction / np.linalg.norm(direction, axis=1, keepdims=True))


@pytest.mark.parametrize("resolution", [24, 48])
def test_its_triangles_lie_on_the_surface_and_cover_it(resolution: int) -> None:
    mesh = extract_published(ball, on_the_ball(), resolution=resolution)
    side = 0.9 / resolution
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max() < 0.3 * side
    assert area(mesh) == pytest.approx(4 * np.pi * RADIUS**2, rel=0.05)


def test_no_two_cells_share_a_vertex() -> None:
    mesh = extract_published(ball, on_the_ball(), resolution=24)
    edges = edges_of(mesh.faces)
    assert (edges.size == 1).sum() > len(mesh.faces)
    places = np.unique(np.round(mesh.vertices, 9), axis=0)
    assert len(mesh.vertices) > 2 * len(places)


def test_a_field_without_a_surface_gives_an_empty_mesh() -> None:
    def nothing(q: Floats) -> tuple[Floats, Floats]:
        return np.full(len(q), 0.2), np.tile([0.0, 0.0, 1.0], (len(q), 1))

    mesh = extract_published(nothing, on_the_ball(), resolution=12)
    assert mesh.vertices.shape == mesh.faces.shape == (0, 3)


def test_progress_only_grows_and_a_cancelled_one_stops() -> None:
    said: list[float] = []
    extract_published(ball, on_the_ball(), resolution=24, tick=said.append)
    assert said == sorted(said)
    assert said[-1] <= 1

    def stop(fraction: float) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        extract_published(ball, on_the_ball(), resolution=24, tick=stop)
