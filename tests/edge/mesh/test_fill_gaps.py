"""Filling holes: missing surface is closed smoothly, true openings stay open."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.edges import border_edges, edges_of
from capture2vr.edge.mesh.fill_gaps import FilledMesh, fill_gaps
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.origin import FILLED, MEASURED, marked
from capture2vr.order.option_table import Fill


def nobody_sees_through(places: Floats, normals: Floats) -> Ints:
    return np.zeros(len(places), np.int64)


def all_see_through(places: Floats, normals: Floats) -> Ints:
    return np.full(len(places), 9)


def mesh_of(shape: trimesh.Trimesh, keep: Bools | None = None) -> Mesh:
    faces = np.asarray(shape.faces, np.int64)
    return compact(Mesh(np.asarray(shape.vertices, np.float64), faces if keep is None else faces[keep]))


def ball_with_hole(degrees: float, axis: Floats) -> Mesh:
    """A unit sphere without the cap of so many degrees around an axis."""
    ball = trimesh.creation.icosphere(4)
    return mesh_of(ball, ball.triangles_center @ axis < np.cos(np.radians(degrees)))


def tube(ends_closed: bool = False) -> Mesh:
    """A tube of radius 0.3 and height 1, open at both ends."""
    shape = trimesh.creation.cylinder(0.3, 1.0, sections=48).subdivide_to_size(0.06)
    return mesh_of(shape, None if ends_closed else np.abs(shape.face_normals[:, 2]) < 0.5)


def sheet_with_hole() -> Mesh:
    """A flat sheet of 1 x 1 with a round hole of radius 0.15 in its middle."""
    sheet = trimesh.creation.box((1, 1, 1)).subdivide_to_size(0.05)
    keep = (sheet.triangles_center[:, 2] > 0.4999) & (np.hypot(*sheet.triangles_center[:, :2].T) > 0.15)
    return mesh_of(sheet, keep)


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(max_examples=15, deadline=None)
@given(directions, st.floats(8, 35))
@example((1.0, 0.0, 0.03125), 30.0)  # two slivers beside the border were folded
@example((-0.21354463, 0.66506607, -1.33843252), 21.909329906371337)  # one
def test_a_hole_in_a_ball_is_closed_on_the_ball(direction: tuple[float, float, float], degrees: float) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    mesh = ball_with_hole(degrees, axis)
    made = fill_gaps(mesh, "unseen", nobody_sees_through)
    assert len(border_edges(made.mesh.faces)) == 0
    assert edges_of(made.mesh.faces).crowded_count == 0
    away = np.linalg.norm(made.mesh.vertices, axis=1)
    # A flat lid would lie (1 - cos) below the ball in its middle: the fairing bulges it at least half of the way.
    assert np.abs(away - 1).max() < max(0.5 * (1 - np.cos(np.radians(degrees))), 0.01)
    missing = (1 - np.cos(np.radians(degrees))) / 2
    assert made.shares["filled"] == pytest.approx(missing, rel=0.35, abs=0.005)
    normals = face_normals(made.mesh.vertices, made.mesh.faces)
    outward = np.einsum("fx,fx->f", normals, made.mesh.vertices[made.mesh.faces].mean(axis=1))
    assert (outward > 0).all(), "what is added is wound like what is there"


def test_what_is_there_stays_and_what_is_added_comes_last() -> None:
    mesh = ball_with_hole(20, np.array([0.0, 0, 1]))
    made = fill_gaps(mesh, "unseen", nobody_sees_through)
    assert np.array_equal(made.mesh.vertices[: len(mesh.vertices)], mesh.vertices)
    assert np.array_equal(made.mesh.faces[made.origin == MEASURED], mesh.faces)
    assert (made.origin[len(mesh.faces) :] == FILLED).all()
    assert np.array_equal(made.vertex_origin == FILLED, np.arange(len(made.mesh.vertices)) >= len(mesh.vertices))
    added = made.mesh.vertices[made.mesh.faces[made.origin == FILLED]]
    longest = np.linalg.norm(added - np.roll(added, 1, axis=1), axis=2).max()
    assert longest < 0.2, "the lid is as fine as the ball"


@pytest.mark.parametrize("fill", ["unseen", "all"])
def test_a_hole_that_views_see_through_stays_open(fill: Fill) -> None:
    for mesh in (ball_with_hole(20, np.array([0.0, 0, 1])), sheet_with_hole()):
        made = fill_gaps(mesh, fill, all_see_through)
        assert not made.origin.any()
        assert made.shares["filled"] == 0


def test_the_border_of_a_sheet_is_no_hole_but_the_hole_in_it_is() -> None:
    for fill in ("unseen", "all"):
        made = fill_gaps(sheet_with_hole(), fill, nobody_sees_through)
        assert made.shares["filled"] == pytest.approx(np.pi * 0.15**2, rel=0.1), "the hole alone"


def test_the_ends_of_a_sleeve_stay_open_unless_all_is_asked_for() -> None:
    assert not fill_gaps(tube(), "unseen", nobody_sees_through).origin.any()
    for made in (
        fill_gaps(tube(), "all", nobody_sees_through),
        fill_gaps(tube(), "unseen", nobody_sees_through, closed=True),
    ):
        assert len(border_edges(made.mesh.faces)) == 0


def test_all_holes_of_a_thing_without_openings_are_filled_where_all_is_asked_for() -> None:
    """Photos seem to see through one, and the patch of another lies back on a tuft around it."""
    mesh = ball_with_hole(20.0, np.array([0.0, 0, 1]))
    assert not fill_gaps(mesh, "unseen", all_see_through, closed=True).origin.any()
    assert not fill_gaps(mesh, "all", all_see_through).origin.any()
    assert len(border_edges(fill_gaps(mesh, "all", all_see_through, closed=True).mesh.faces)) == 0
    cap = ball_with_hole(150.0, np.array([0.0, 0, 1]))  # of a sheet the patch lies back on the sheet
    assert not fill_gaps(cap, "all", nobody_sees_through).origin.any()
    assert len(border_edges(fill_gaps(cap, "all", nobody_sees_through, closed=True).mesh.faces)) == 0


def test_faces_of_inferred_points_are_marked() -> None:
    mesh = mesh_of(trimesh.creation.icosphere(3))
    below = mesh.vertices[:, 2] < -0.5
    made = FilledMesh.unfilled(mesh).with_origin_of(mesh.vertices, marked(below, FILLED))
    middle = mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    assert (made.origin[middle < -0.6] == FILLED).all()
    assert not made.origin[middle > -0.4].any()
    assert made.shares["filled"] == pytest.approx(0.25, abs=0.05), "of a ball, the part below half its radius"


def test_nothing_is_filled_where_that_is_not_wanted_or_nothing_is_missing() -> None:
    holed = ball_with_hole(20, np.array([0.0, 0, 1]))
    assert fill_gaps(holed, "none", nobody_sees_through).mesh is holed
    whole = mesh_of(trimesh.creation.icosphere(3))
    assert not fill_gaps(whole, "all", nobody_sees_through).origin.any()
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    assert fill_gaps(empty, "all", nobody_sees_through).shares["filled"] == 0


def test_a_patch_that_is_seen_through_in_one_corner_by_one_view_is_filled() -> None:
    def one_errs(places: Floats, normals: Floats) -> Ints:
        return np.ones(len(places), np.int64)

    assert fill_gaps(ball_with_hole(20, np.array([0.0, 0, 1])), "unseen", one_errs).origin.any()


def test_several_holes_are_told_apart() -> None:
    ball = trimesh.creation.icosphere(4)
    top, bottom = ball.triangles_center[:, 2] > 0.93, ball.triangles_center[:, 2] < -0.93
    mesh = mesh_of(ball, ~(top | bottom))

    def top_is_free(places: Floats, normals: Floats) -> Ints:
        return np.where(places[:, 2] > 0, 5, 0)

    made = fill_gaps(mesh, "unseen", top_is_free)
    left = made.mesh.vertices[border_edges(made.mesh.faces)[:, 0]]
    assert (left[:, 2] > 0).all()
    assert len(left) > 10


def test_the_longest_loops_are_left_out_where_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(4)
    large, small = ball.triangles_center[:, 2] > 0.9, ball.triangles_center[:, 2] < -0.98
    mesh = mesh_of(ball, ~(large | small))
    monkeypatch.setattr("capture2vr.edge.mesh.fill_gaps._MOST_WORK", (30 / 400) ** 3)
    made = fill_gaps(mesh, "unseen", nobody_sees_through)
    left = made.mesh.vertices[border_edges(made.mesh.faces)[:, 0]]
    assert made.origin.any()
    assert (left[:, 2] > 0).all(), "the small one is filled"


def test_progress_only_grows() -> None:
    fractions: list[float] = []
    fill_gaps(ball_with_hole(20, np.array([0.0, 0, 1])), "unseen", nobody_sees_through, tick=fractions.append)
    assert all(before <= after for before, after in pairwise(fractions))
    assert fractions


def test_an_empty_result_has_no_share() -> None:
    assert FilledMesh(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), np.zeros(0, np.uint8)).shares["filled"] == 0
