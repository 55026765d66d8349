"""Isolating the thing in the middle: the table and the clutter go, the thing and its loose parts stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.isolate import isolate_object
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.plane import largest_plane
from capture2vr.edge.points.upright import from_cameras
from capture2vr.edge.read_capture import read_capture
from tests.support.scenes import Sensor, film, look_at, orbit, plane, scene

SENSOR = Sensor(noise_m=0.003, jitter_m=0.002, jitter_deg=0.1, flying=0.5)
UP = np.array([0.0, 0.0, 1.0])


def ball_on_table(clutter: bool = True) -> Floats:
    """A cloud (N,3): sphere of radius 0.15 on a table 1.2 m wide, a box beside it."""
    parts = [
        trimesh.sample.sample_surface(plane(1.2, 1.2), 20_000, seed=1)[0],
        trimesh.sample.sample_surface(trimesh.creation.icosphere(4, 0.15), 6_000, seed=2)[0] + [0, 0, 0.15],
    ]
    if clutter:
        box = trimesh.creation.box((0.2, 0.2, 0.3))
        parts.append(trimesh.sample.sample_surface(box, 5_000, seed=3)[0] + [0.48, 0.1, 0.15])
    return np.concatenate(parts)


def off_ball(xyz: Floats) -> Floats:
    return np.abs(np.linalg.norm(xyz - [0, 0, 0.15], axis=1) - 0.15)


def isolate(xyz: Floats, up: Floats | None = UP) -> Points:
    return to_points(Capture("points", "ply", Cloud(xyz), up=up), cut="object")


@pytest.mark.parametrize("up", [UP, None], ids=["gravity known", "gravity unknown"])
@pytest.mark.parametrize("turn_deg", [0.0, 130.0])
def test_the_table_goes_and_the_ball_stays(up: Floats | None, turn_deg: float) -> None:
    turn = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [1, 2, 3])[:3, :3]
    points = isolate(ball_on_table(clutter=False) @ turn.T, None if up is None else turn @ up)
    assert np.percentile(off_ball(points.xyz @ turn), 99) < 0.01
    assert len(points) > 0.9 * 6_000


def test_ground_that_bends_goes() -> None:
    table = trimesh.sample.sample_surface(plane(1.2, 1.2), 20_000, seed=1)[0]
    table[:, 2] = 0.2 * table[:, 0] ** 2  # 7 cm at the sides: a plane leaves a strip of it, which touches the ball
    middle = np.array([0.3, 0.0, 0.15 + 0.2 * 0.3**2])
    ball = trimesh.sample.sample_surface(trimesh.creation.icosphere(4, 0.15), 6_000, seed=2)[0] + middle
    both = np.concatenate([table, ball])
    points = isolate(both + np.random.default_rng(0).normal(0, 0.002, both.shape))
    assert np.abs(np.linalg.norm(points.xyz - middle, axis=1) - 0.15).max() < 0.01
    assert len(points) > 0.85 * 6_000


def test_clutter_goes() -> None:
    points = isolate(ball_on_table())
    assert off_ball(points.xyz).max() < 0.01
    assert len(points) > 0.9 * 6_000


def test_a_flat_thing_on_its_table_stays_with_a_warning() -> None:
    cloth = trimesh.sample.sample_surface(plane(0.4, 0.3, z=0.003), 5_000, seed=1)[0]
    table = trimesh.sample.sample_surface(plane(1.2, 1.2), 20_000, seed=2)[0]
    both = np.concatenate([cloth, table])
    points = isolate(both + np.random.default_rng(0).normal(0, 0.002, both.shape))
    assert len(points) > 0.98 * 25_000
    assert any("flat" in warning for warning in points.warnings)


def test_a_garment_is_not_cut_down_to_its_folds() -> None:
    rng = np.random.default_rng(0)
    table = trimesh.sample.sample_surface(plane(1.2, 1.2), 20_000, seed=2)[0]
    cloth = rng.uniform(-0.25, 0.25, (8_000, 3))
    cloth[:, 2] = 0.005 + 0.015 * np.sin(20 * cloth[:, 0]) ** 2
    points = isolate(np.concatenate([table, cloth]) + rng.normal(0, 0.002, (28_000, 3)))
    assert len(points) > 0.98 * 28_000
    assert any("flat" in warning for warning in points.warnings)


def test_a_thing_without_a_table_stays_whole() -> None:
    ball = ball_on_table(clutter=False)[20_000:]
    points = isolate(ball, None)
    assert len(points) > 0.999 * len(ball)
    assert points.warnings


def test_a_loose_part_close_by_stays() -> None:
    button = trimesh.sample.sample_surface(trimesh.creation.icosphere(3, 0.02), 300, seed=5)[0] + [0, 0.185, 0.2]
    points = isolate(np.concatenate([ball_on_table(), button]))
    assert np.sum(points.xyz[:, 1] > 0.17) > 250


def test_what_stands_on_nothing_belongs_to_the_thing_and_what_stands_on_the_table_does_not() -> None:
    """The head of a flower, the stem of which has no depth, and another one that lies beside it."""
    head = trimesh.sample.sample_surface(trimesh.creation.icosphere(3, 0.04), 600, seed=5)[0]
    over, beside = (head + np.array(at) for at in ([0, 0, 0.41], [0.26, 0, 0.04]))
    points = isolate(np.concatenate([ball_on_table(), over, beside]))
    assert np.sum(points.xyz[:, 2] > 0.36) > 550
    assert np.abs(points.xyz[:, 0]).max() < 0.2


def test_a_flake_of_the_table_that_lies_a_little_over_it_goes() -> None:
    """It stands on nothing, as the head of a flower does, but rises no higher than noise."""
    grain = np.random.default_rng(6).uniform([-0.02, -0.02, 0], [0.02, 0.02, 0.004], (120, 3))
    points = isolate(np.concatenate([ball_on_table(), grain + np.array([0.2, 0, 0.035])]))
    assert points.xyz[:, 0].max() < 0.16


def test_a_few_points_in_the_air_above_it_go() -> None:
    few = np.random.default_rng(7).uniform(-0.006, 0.006, (20, 3)) + np.array([0, 0, 0.37])
    points = isolate(np.concatenate([ball_on_table(), few]))
    assert points.xyz[:, 2].max() < 0.33


def test_dust_is_a_named_error() -> None:
    grains = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    dust = (grains[:, None] + 1e-3 * np.random.default_rng(1).normal(size=(40, 60, 3))).reshape(-1, 3)
    with pytest.raises(CaptureError) as error:
        isolate(dust, None)
    assert error.value.code == "CAPTURE_NOTHING_LEFT"


@pytest.mark.slow
def test_filmed_ball_with_clutter() -> None:
    box = trimesh.creation.box((0.2, 0.2, 0.3))
    box.apply_translation([0.45, 0.1, 0.15])
    ball = trimesh.creation.icosphere(5, 0.15)
    ball.apply_translation([0, 0, 0.15])
    world = scene((plane(1.2, 1.2), (150, 120, 90)), (ball, (200, 40, 40)), (box, (0, 0, 200)))
    frames = film(world, orbit(10, radius=0.9, height=0.7, turn=0.5), sensor=SENSOR)
    points = to_points(Capture("rgbd", "synthetic", frames=frames, scale_confidence="metric"), cut="object")
    assert np.percentile(off_ball(points.xyz), 99) < 0.012
    assert np.ptp(points.xyz[:, 0]) > 0.25
    assert len(points.xyz) == len(points.rgb if points.rgb is not None else []) == len(points.confidence)


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0.6, 0, 0.8], [1.0, 0, 0]])
def test_the_largest_plane_is_found_among_clutter(normal: list[float]) -> None:
    rng = np.random.default_rng(0)
    across = np.linalg.svd(np.array([normal]))[2][1:]
    flat = rng.uniform(-1, 1, (3_000, 2)) @ across + 0.3 * np.array(normal)
    found = largest_plane(np.concatenate([flat, rng.uniform(-1, 1, (6_000, 3))]), 0.01)
    assert found is not None
    assert abs(found.normal @ normal) > np.cos(np.radians(0.5))
    assert abs(found.offset) == pytest.approx(0.3, abs=0.003)


def test_no_plane_through_one_place() -> None:
    assert largest_plane(np.zeros((10, 3)), 0.01) is None


def test_up_without_any_floor_comes_from_the_cameras() -> None:
    walk = orbit(12, radius=1, height=0.8)
    assert from_cameras(walk)[0] @ UP > np.cos(np.radians(1))
    level = look_at((1, 0, 0), (0, 0, 0))[None]
    assert from_cameras(level)[0] @ UP > np.cos(np.radians(1))


@pytest.mark.slow
@pytest.mark.data
def test_a_lamp_is_taken_off_its_wall(data_dir: Path) -> None:
    points = to_points(read_capture(data_dir / "cloud_room" / "fragment.pcd"), cut="object")
    assert 2_000 < len(points) < 8_000
    assert np.ptp(points.xyz, axis=0).max() < 0.6


def ball_on_pedestal(wall: float = 2.0) -> tuple[Floats, Floats]:
    """A cloud (N,3): a ball on a pedestal with a wide flat top, a floor, and a wall `wall` metres away; mask (N,): what
    belongs together."""
    pedestal = trimesh.sample.sample_surface(trimesh.creation.box((0.7, 0.7, 0.4)), 24_000, seed=4)[0] + [0, 0, 0.2]
    ball = trimesh.sample.sample_surface(trimesh.creation.icosphere(4, 0.15), 6_000, seed=2)[0] + [0, 0, 0.55]
    top = trimesh.sample.sample_surface(plane(0.7, 0.7, z=0.4), 14_000, seed=6)[0]  # photos show it best
    floor = trimesh.sample.sample_surface(plane(4.0, 4.0), 20_000, seed=1)[0]
    far = trimesh.sample.sample_surface(trimesh.creation.box((0.1, 4.0, 3.0)), 5_000, seed=5)[0] + [wall, 0, 1.5]
    whole = np.concatenate([pedestal[pedestal[:, 2] > 0.02], top, ball])
    cloud = np.concatenate([whole, floor[np.abs(floor[:, :2]).max(axis=1) > 0.35], far])
    return cloud + np.random.default_rng(0).normal(0, 0.001, cloud.shape), np.arange(len(cloud)) < len(whole)


@pytest.mark.parametrize("up", [UP, None], ids=["gravity known", "gravity unknown"])
def test_a_pedestal_stays_with_what_stands_on_it_and_the_floor_and_the_wall_go(up: Floats | None) -> None:
    cloud, whole = ball_on_pedestal()
    turns = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    cameras = np.column_stack([1.3 * np.cos(turns), 1.3 * np.sin(turns), np.full(20, 0.9)])
    estimated = None if up is None else np.array([np.sin(np.radians(6)), 0, np.cos(np.radians(6))])
    points = Points(cloud, None, np.ones(len(cloud), np.float32), 1.0, "metric", estimated)
    isolated = isolate_object(points, aim=np.array([0.0, 0.0, 0.4]), cameras=cameras)
    found = isolated.points
    assert (found.up is None) == (up is None)
    assert found.up is None or found.up @ UP > np.cos(np.radians(0.2)), "the floor tells it better"
    assert len(found) == pytest.approx(whole.sum(), rel=0.02)
    assert np.abs(found.xyz[:, :2]).max() < 0.36, "nothing of the floor or of the wall"
    assert isolated.support is not None
    assert np.abs(isolated.support.height(np.zeros((1, 3)))) < 0.01, "the floor, in the points' own frame"


def standing(*parts: Floats) -> Points:
    """A ball of 6,000 points on the plane z = 0, cut out of these parts."""
    ball = trimesh.sample.sample_surface(trimesh.creation.icosphere(4, 0.15), 6_000, seed=2)[0] + [0, 0, 0.15]
    cloud = np.concatenate([ball, *parts])
    cloud += np.random.default_rng(0).normal(0, 0.001, cloud.shape)
    return isolate_object(Points(cloud, None, np.ones(len(cloud), np.float32), 1.0, "metric", UP)).points


def sheet(side: float, count: int) -> Floats:
    found: Floats = trimesh.sample.sample_surface(plane(side, side), count, seed=1)[0]
    return found


def disc(radius: float, count: int) -> Floats:
    square = sheet(2 * radius, 2 * count)
    return square[np.linalg.norm(square, axis=1) < radius][:count]


def off_centre(count: int) -> Floats:
    """A second ball on the same ground."""
    found: Floats = trimesh.sample.sample_surface(trimesh.creation.icosphere(4, 0.15), count, seed=4)[0]
    return found + np.array([0.5, 0, 0.15])


def column(radius: float, depth: float, count: int) -> Floats:
    """The side of a cylinder under the plane z = 0."""
    turn, down = np.random.default_rng(3).uniform([0, 0.02], [2 * np.pi, depth], (count, 2)).T
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), -down], axis=1)


def test_bare_ground_is_removed_without_a_question() -> None:
    found = standing(sheet(1.6, 20_000))
    assert found.cut is not None
    assert (found.cut.kept, found.cut.doubt, found.cut.removed) == ("object", "", 0)
    assert found.uncut is not None
    assert len(found.uncut.xyz) == 26_000
    assert found.warnings == ()


@pytest.mark.parametrize(
    ("parts", "word", "share"),
    [
        ((sheet(1.6, 20_000), column(0.3, 0.4, 1_500)), "below the plane", 0.25),
        ((disc(0.17, 9_000),), "ends where it ends", 1.5),
        ((sheet(1.6, 20_000), off_centre(3_000)), "beside the object", 0.5),
    ],
    ids=["a pedestal below its top", "a stand", "a second thing"],
)
def test_a_large_part_that_was_removed_is_asked_about(parts: tuple[Floats, ...], word: str, share: float) -> None:
    found = standing(*parts)
    assert found.cut is not None
    assert word in found.cut.doubt
    assert found.cut.removed == pytest.approx(share, rel=0.15)
    assert any("scene" in warning for warning in found.warnings)
    assert off_ball(found.xyz).max() < 0.01, "it is removed all the same"


def test_a_small_part_is_not_asked_about() -> None:
    found = standing(sheet(1.6, 20_000), column(0.3, 0.4, 500))
    assert found.cut is not None
    assert found.cut.doubt == ""
