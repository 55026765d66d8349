"""Points are inferred where photos show no depth of a thing, out of free space, and never over true openings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.closing.carving import Carving
from capture2vr.edge.closing.missing_points import MissingPoints, infer_missing
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.render.posed_picture import PosedPicture
from tests.support.photos.posed_pictures import photographs, print_on

RADIUS = 0.4
TABLE = np.array([[-3.0, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]])
AROUND = [(1.6 * np.cos(turn), 1.6 * np.sin(turn), 1.1) for turn in np.radians(np.arange(0, 360, 30))]
NONE = np.empty((0, 3))


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces, np.int64))


def seen(
    thing: trimesh.Trimesh, height: float, hole: Callable[[Floats], Bools] | None = None, false: Floats = NONE
) -> MissingPoints:
    """What is inferred of a thing that is photographed from all sides, its lowest place so high over a table.

    hole   places (N,3) of it, less its height, that give no depth
    false  (M,3) points where it has no surface; they come last
    """
    thing = thing.copy()
    middle = float(thing.bounds[:, 2].mean())
    thing.apply_translation([0, 0, -middle])
    low = float(thing.bounds[0, 2])
    table = trimesh.Trimesh(TABLE + np.array([0, 0, low - height]), [[0, 1, 2], [0, 2, 3]], process=False)
    photos = photographs(mesh_of(trimesh.util.concatenate([thing, table])), AROUND)
    points = np.concatenate([depth_points(photo) for photo in photos])
    points = points[points[:, 2] > low + max(0.02 - height, -0.005)]
    if hole is not None:
        points = points[~hole(points)]
    points = points[np.unique(np.floor(points / 0.012).astype(int), axis=0, return_index=True)[1]]
    points = np.concatenate([points, false])
    rgb = np.clip(print_on(points), 0, 255).astype(np.uint8)
    return infer_missing(points, rgb, photos, Plane(np.array([0.0, 0, 1]), low - height, 0.0, 0.5), "unseen")


def depth_points(photo: PosedPicture) -> Floats:
    """Places (N,3) that a photo's depth image shows."""
    depth = photo.depth()
    side = len(depth)
    row, column = np.nonzero(depth < 4.9)
    z = depth[row, column]
    at = (np.stack([column, row], axis=1) + 0.5) / side
    local = np.concatenate([(at - photo.middle) / photo.focal * z[:, None], z[:, None]], axis=1)
    back = np.linalg.inv(photo.to_camera)
    places: Floats = local @ back[:3, :3].T + back[:3, 3]
    return places


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(4, RADIUS)


def tube() -> trimesh.Trimesh:
    """A tube of zero thickness, open at both ends, that lies along Y."""
    shape = trimesh.creation.cylinder(0.25, 1.0, sections=64).subdivide_to_size(0.08)
    shape.update_faces(np.abs(shape.face_normals[:, 2]) < 0.5)
    return shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))


@pytest.mark.slow
def test_the_underside_of_what_stands_on_a_table_is_closed_down_to_the_table() -> None:
    missing = seen(ball(), height=0.0)
    assert missing.closed
    assert len(missing.xyz) > 100
    away = np.linalg.norm(missing.xyz, axis=1)
    assert missing.xyz[:, 2].max() < 0.1, "of the upper half nothing is missing"
    assert missing.xyz[:, 2].min() > -RADIUS - 0.015, "nothing lies under the table"
    assert np.percentile(np.abs(away - RADIUS), 90) < 0.06, "it goes on as a ball does"
    assert missing.fringe.mean() < 0.05


@pytest.mark.slow
def test_a_hole_in_a_surface_is_closed_in_the_surrounding_colours() -> None:
    spot = np.array([RADIUS, 0, 0])

    def hole(places: Floats) -> Bools:
        dark: Bools = np.linalg.norm(places - spot, axis=1) < 0.07
        return dark

    missing = seen(ball(), 0.0, hole)
    inside = np.linalg.norm(missing.xyz - spot, axis=1) < 0.06
    assert inside.sum() > 15
    assert np.abs(np.linalg.norm(missing.xyz[inside], axis=1) - RADIUS).max() < 0.03
    assert missing.rgb is not None
    red, green, blue = missing.rgb[inside].astype(float).mean(axis=0)
    assert red > green > blue, "the print's order"


@pytest.mark.slow
def test_ragged_points_meet_what_is_inferred_on_one_smooth_surface() -> None:
    """Stereo leaves noise and flakes at the border of what it sees; from inferred surface they would stand off."""
    rng = np.random.default_rng(0)
    turn, height = rng.uniform(0, 2 * np.pi, 3_000), rng.uniform(-0.24, -0.14, 3_000)
    across = np.sqrt(RADIUS**2 - height**2)
    ring = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    ring *= (1 + rng.normal(0, 0.05, len(ring)))[:, None]

    def below(places: Floats) -> Bools:
        dark: Bools = places[:, 2] < -0.16
        return dark

    missing = seen(ball(), 0.0, below, ring)
    came = missing.measured[-len(ring) :][~missing.fringe[-len(ring) :]]
    assert len(came) > 100
    assert roughness(ring[ring[:, 2] < -0.19]) > 0.1
    assert roughness(np.concatenate([came[came[:, 2] < -0.19], missing.xyz])) < 0.06


def roughness(xyz: Floats) -> float:
    """Mean over points (N,3) of their neighbours' deviation from a plane, over that along it."""
    near = xyz[cKDTree(xyz).query(xyz, k=12)[1]]
    spread = np.linalg.svd(near - near.mean(axis=1, keepdims=True), compute_uv=False)
    return float((spread[:, 2] / spread[:, 0]).mean())


@pytest.mark.slow
def test_false_points_inside_a_closed_thing_are_dropped() -> None:
    """Depth that was matched wrongly: a bubble of it, and a few places alone."""
    bubble = trimesh.creation.icosphere(2, 0.06).apply_translation([0.1, 0, -0.1]).vertices
    false = np.concatenate([bubble, [[0, 0, -0.2], [-0.15, 0.1, 0], [0, -0.2, -0.05]]])
    missing = seen(ball(), 0.0, false=false)
    assert missing.closed
    assert missing.fringe[-len(false) :].all()
    assert missing.fringe[: -len(false)].mean() < 0.05


@pytest.mark.slow
def test_the_ends_of_a_tube_stay_open() -> None:
    missing = seen(tube(), height=0.4)
    assert not missing.closed
    x, y, z = missing.xyz.T
    assert not ((np.hypot(x, z) < 0.15) & (np.abs(y) > 0.3)).any()


@pytest.mark.slow
def test_a_sheet_seen_from_both_sides_is_no_closed_thing() -> None:
    sheet = trimesh.creation.box((0.9, 0.005, 0.9)).subdivide_to_size(0.1)
    missing = seen(sheet, height=0.4)
    assert not missing.closed
    assert len(missing.xyz) == 0


@pytest.mark.slow
def test_a_broken_pipe_that_stands_on_a_table_stays_as_it_is() -> None:
    """Its inside is seen from one side alone, and what cannot be seen in it stands on the table."""
    pipe = trimesh.creation.cylinder(0.3, 0.8, sections=64).subdivide_to_size(0.08)
    x, y, _ = pipe.triangles_center.T
    pipe.update_faces((np.abs(pipe.face_normals[:, 2]) < 0.5) & (np.abs(np.arctan2(y, x)) > 0.9))
    missing = seen(pipe, height=0.0)
    assert not missing.closed
    assert not missing.fringe.any()
    assert len(missing.xyz) == 0


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(st.floats(0.0, 0.5), st.floats(0.6, 1.4))
def test_nothing_is_inferred_where_photos_look_through(height: float, stretch: float) -> None:
    thing = ball().apply_scale([1, stretch, 0.8])
    photos = photographs(mesh_of(thing), AROUND)
    missing = seen(thing, height)
    if len(missing.xyz):
        assert Carving(tuple(photos)).is_free(missing.xyz).mean() < 0.05
        assert cKDTree(missing.xyz).query(thing.vertices)[0].max() < 2
