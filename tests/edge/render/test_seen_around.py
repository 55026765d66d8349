"""What of a mesh's inside is seen from around, and how ragged its borders are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.render.seen_around import fringe, largest_hole, thinness
from tests.support import surfaces


def ball(cap_degrees: float) -> Mesh:
    """A unit sphere without a cap of so many degrees around +Z."""
    shape = trimesh.creation.icosphere(5)
    keep = shape.triangles_center[:, 2] < np.cos(np.radians(cap_degrees))
    return compact(Mesh(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces, np.int64)[keep]))


def test_a_closed_surface_shows_no_inside_whichever_way_it_is_wound() -> None:
    whole = ball(0)
    assert largest_hole(whole) == 0
    assert largest_hole(Mesh(whole.vertices, whole.faces[:, ::-1])) == 0
    assert fringe(whole, border_edges(whole.faces)) == 1


@pytest.mark.parametrize("degrees", [20, 40, 60])
def test_a_cap_that_is_missing_shows_as_much_inside_as_it_covers(degrees: float) -> None:
    # From above the hole is a disc of radius sin(a) in one of radius 1; the 20 directions look 18 degrees beside it.
    most = np.sin(np.radians(degrees)) ** 2
    assert 0.7 * most < largest_hole(ball(degrees)) < 1.1 * most


@pytest.mark.parametrize(
    ("name", "thick"), [("disk", 0.0), ("smooth_sheet", 0.1), ("hemisphere", 0.5), ("cylinder", 1.0), ("sphere", 1.0)]
)
def test_thinness_is_that_of_the_shape_however_it_is_turned(name: str, thick: float) -> None:
    mesh = getattr(surfaces, name)()
    for turn in np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3, 3)))[0]:
        assert thinness(Mesh(mesh.vertices @ turn.T, mesh.faces)) == pytest.approx(thick, abs=0.08)


def test_a_sliver_that_smoothing_takes_away_has_an_end() -> None:
    turn = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    rim = np.stack([np.cos(turn), 1e-4 * np.sin(150 * turn), 0 * turn], axis=1)
    inner = np.arange(300)
    sliver = Mesh(np.concatenate([rim, np.zeros((1, 3))]), np.stack([np.full(300, 300), inner, np.roll(inner, -1)], 1))
    assert 1 <= fringe(sliver, border_edges(sliver.faces)) < 100


@pytest.mark.parametrize("tooth", [0.0, 0.02, 0.05])
def test_teeth_make_a_border_longer_than_it_is_when_smoothed(tooth: float) -> None:
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = 1 + tooth * np.where(np.arange(400) % 2, 1, -1)
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=1)
    inner = np.arange(400)
    fan = np.stack([np.full(400, 400), inner, np.roll(inner, -1)], axis=1)
    disc = Mesh(np.concatenate([rim, np.zeros((1, 3))]), fan)
    step = 2 * np.pi / 400
    expected = np.hypot(2 * tooth, step) / step
    assert fringe(disc, border_edges(disc.faces)) == pytest.approx(expected, rel=0.1)
