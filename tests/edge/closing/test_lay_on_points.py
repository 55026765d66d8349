"""A closed mesh is laid on its points, and stays where it has none."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from capture2vr.edge.arrays import Floats
from capture2vr.edge.closing.lay_on_points import lay_on_points, smooth_parts
from capture2vr.edge.closing.oriented_points import OrientedPoints
from capture2vr.edge.mesh.nouns import Mesh

CELL, SPACING = 1 / 32, 1 / 80
RADIUS, HIGH = 0.3, 0.5


def jar(radius: float = RADIUS) -> Mesh:
    """A closed cylinder that stands on z = 0, of triangles a cell wide."""
    made = trimesh.creation.cylinder(radius, HIGH, sections=64).apply_translation([0, 0, HIGH / 2])
    made = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(made.vertices, made.faces, CELL))
    made.merge_vertices()
    return Mesh(made.vertices, made.faces)


def wall(radius: float = RADIUS, lowest: float = 0.0) -> OrientedPoints:
    """Points of its wall alone, as photos show them, with their normals."""
    turn = np.arange(0, 2 * np.pi, SPACING / radius)
    turn, z = (each.ravel() for each in np.meshgrid(turn, np.arange(lowest, HIGH, SPACING)))
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    return OrientedPoints(radius * out + z[:, None] * [0, 0, 1.0], out, np.ones(len(turn)))


def bottom(mesh: Mesh, of: Mesh) -> Floats:
    """Heights in cells of the vertices that are the bottom's of the mesh before."""
    inside = np.hypot(of.vertices[:, 0], of.vertices[:, 1]) < RADIUS - 2 * CELL
    return np.asarray(mesh.vertices[inside & (of.vertices[:, 2] < CELL), 2] / CELL)


def test_a_mesh_comes_to_lie_on_its_points() -> None:
    rough = jar(RADIUS - 0.7 * CELL)
    laid, sure = lay_on_points(rough, wall(), SPACING, CELL)
    side = (rough.vertices[:, 2] > 3 * CELL) & (rough.vertices[:, 2] < HIGH - 3 * CELL)
    side &= np.hypot(rough.vertices[:, 0], rough.vertices[:, 1]) > RADIUS - CELL
    assert np.hypot(*laid.vertices[side, :2].T) == pytest.approx(RADIUS, abs=0.05 * CELL)
    assert sure[side].min() > 0.9
    assert sure[np.hypot(*rough.vertices[:, :2].T) < RADIUS / 2].max() < 0.1


@pytest.mark.parametrize("lowest", [0.0, 0.5 * CELL, CELL])
def test_a_bottom_that_no_photo_shows_stays_where_the_walls_stand(lowest: float) -> None:
    """The points of a wall near its foot lie over the bottom, and do not lift it."""
    rough = jar()
    assert np.abs(bottom(lay_on_points(rough, wall(lowest=lowest), SPACING, CELL)[0], rough)).max() < 0.25  # cells


def test_a_smoothed_part_loses_its_creases_and_keeps_its_bend() -> None:
    ball = trimesh.creation.icosphere(5, RADIUS)
    rng = np.random.default_rng(0)
    lower = ball.vertices[:, 2] < 0
    uneven = ball.vertices * (1 + np.where(lower, rng.normal(0, 0.02, len(lower)), 0))[:, None]
    known = np.zeros(len(lower))
    smooth = smooth_parts(Mesh(uneven, ball.faces), lower[ball.faces].all(axis=1), known)
    away = np.linalg.norm(smooth.vertices, axis=1) / RADIUS - 1
    assert np.std(away[lower]) < 0.01
    assert np.abs(away[ball.vertices[:, 2] > 0.1 * RADIUS]).max() < 1e-3
    stays = smooth_parts(Mesh(uneven, ball.faces), lower[ball.faces].all(axis=1), known + 1)
    assert np.std(np.linalg.norm(stays.vertices[lower], axis=1) / RADIUS) > 0.01
