"""Parts without points: undersides and holes are missing surface, the end of a tube and a hem are not."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.closing.loose_parts import LooseParts
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.plane import Plane

CELL, SPACING = 1 / 64, 0.01
AROUND = np.array([[2.0, 0, 1], [-1, 1.8, 1], [-1, -1.8, 1]])
"""Places of cameras."""


def parts(shape: trimesh.Trimesh, missing: Bools) -> LooseParts:
    """The parts of a closed shape of which faces (F,) have no points."""
    fine = Mesh(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces, np.int64))
    xyz, face = trimesh.sample.sample_surface(shape, int(shape.area / SPACING**2), seed=0)
    points: Floats = np.asarray(xyz)[~missing[face]]
    return LooseParts.without_points(fine, cKDTree(points), np.full(len(points), SPACING))


def floor(height: float) -> Plane:
    return Plane(np.array([0.0, 0, 1]), height, 0.0, 0.5)


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(5, 0.4)


def cylinder(top: float, bottom: float) -> trimesh.Trimesh:
    """A body of revolution, 0.8 high around 0, with these radii at its ends."""
    shape = trimesh.creation.cylinder(1.0, 0.8, sections=64).subdivide_to_size(0.1)
    shape.vertices[:, :2] *= (bottom + (top - bottom) * (shape.vertices[:, 2:] / 0.8 + 0.5)) / 1.0
    return shape.subdivide_to_size(0.03)


def test_a_surface_with_points_everywhere_lacks_nothing_and_is_closed() -> None:
    whole = parts(ball(), np.zeros(len(ball().faces), bool))
    faces, closed = whole.missing(floor(-0.4), AROUND, CELL, SPACING, "unseen")
    assert not faces.any()
    assert closed


def test_an_underside_is_missing_where_it_rests_on_the_floor_and_else_an_opening() -> None:
    middle = ball().triangles_center
    below = middle[:, 2] < -0.1
    for height, taken in ((-0.4, True), (-0.44, True), (-0.9, False)):
        faces, closed = parts(ball(), below).missing(floor(height), AROUND, CELL, SPACING, "unseen")
        assert closed == taken
        assert (faces.sum() > 0.5 * below.sum()) == taken
    assert parts(ball(), below).missing(None, AROUND, CELL, SPACING, "all")[0].any()


def test_a_lid_over_an_inside_that_photos_saw_is_none() -> None:
    """A ball with a large hole above: without a word of its inside it is one that lacks something."""
    above = ball().triangles_center[:, 2] > 0.3
    for hollow in (False, True):
        faces, closed = parts(ball(), above).missing(floor(-0.4), AROUND, CELL, SPACING, "unseen", hollow=hollow)
        assert closed is not hollow
        assert faces.any() is np.bool_(not hollow)


@pytest.mark.parametrize(("top", "bottom", "gap", "taken"), [(0.1, 0.4, 0.15, False), (0.3, 0.3, 0.0, True)])
def test_the_hem_of_a_skirt_stays_open_and_the_underside_of_a_box_does_not(
    top: float, bottom: float, gap: float, taken: bool
) -> None:
    """The closed surface bulges over the gap down to the floor under both: that alone says nothing."""
    shape = cylinder(top, bottom)
    x, y, z = shape.vertices.T
    inner = (z < -0.399) & (np.hypot(x, y) < 0.99 * bottom)
    shape.vertices[inner, 2] -= gap * (1 - (np.hypot(x, y)[inner] / bottom) ** 4)
    below = shape.triangles_center[:, 2] < -0.4 + 1e-6
    faces, closed = parts(shape, below).missing(floor(-0.4 - gap), AROUND, CELL, SPACING, "unseen")
    assert closed == taken
    assert faces.any() == taken


def test_a_back_that_nobody_went_around_to_is_not_made_up() -> None:
    """Its sides come down to the floor, as those of an underside do."""
    x, _, z = ball().triangles_center.T
    for eyes, taken in ((AROUND, True), (AROUND[:1], False)):
        faces, closed = parts(ball(), (x < -0.2) | (z < -0.25)).missing(floor(-0.4), eyes, CELL, SPACING, "unseen")
        assert faces.any() == closed == taken
