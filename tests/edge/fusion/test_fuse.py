"""Fusing depth frames: accuracy, completeness and robustness on scenes whose truth is known, then on real frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.fusion.fuse import fuse
from capture2vr.edge.points.voxel_grid import Samples, VoxelGrid
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.srgb import to_linear, to_srgb
from tests.support.scenes import KINECT, PHONE, Scene, Sensor, film, look_at, orbit, plane, scene, table_with_sphere

CLEAN = Sensor()
PHONE_LIKE = Sensor(noise_m=0.003, jitter_m=0.002, jitter_deg=0.1, flying=0.5)
WALK = orbit(16, radius=0.8, height=0.6)


def from_truth(xyz: Floats) -> Floats:
    """Distance (N,) of points to the table or the sphere of `table_with_sphere`."""
    table = np.hypot(xyz[:, 2], np.maximum(np.abs(xyz[:, :2]).max(axis=1) - 0.6, 0))
    return np.minimum(table, np.abs(np.linalg.norm(xyz - [0, 0, 0.15], axis=1) - 0.15))


def upper_sphere() -> Floats:
    """Points (N,3) of the sphere that the walk can see."""
    points = trimesh.sample.sample_surface(table_with_sphere().part(1), 20_000, seed=1)[0]
    return points[points[:, 2] > 0.08]


def rgbd(frames: tuple[Frame, ...], *, up: Floats | None = None) -> Capture:
    return Capture(kind="rgbd", format="synthetic", frames=frames, scale_confidence="metric", up=up)


def test_clean_frames_give_the_surface_itself() -> None:
    fused = fuse(film(table_with_sphere(), WALK, sensor=CLEAN))
    assert np.median(from_truth(fused.xyz)) < 1e-4
    assert np.percentile(from_truth(fused.xyz), 99.9) < 2e-3
    reach, _ = cKDTree(fused.xyz).query(upper_sphere())
    assert np.mean(reach < 2 * fused.voxel) > 0.99


@pytest.mark.parametrize("unit", [7.0, 1000.0, 1e-3])
def test_depth_of_photos_is_the_same_in_any_unit(unit: float) -> None:
    """Poses that come with photos have a unit of their own; a sensor's limits in metres mean nothing in it."""
    world = scene((plane(1.2, 1.2), (150, 120, 90)), (plane(12, 12, z=-2.4), (90, 90, 120)))
    photographed = [replace(frame, window_px=7) for frame in film(world, WALK[:8])]

    def in_unit(frame: Frame) -> Frame:
        pose = np.asarray(frame.camera_to_world).copy()
        pose[:3, 3] *= unit
        return replace(frame, camera_to_world=pose, load_depth_m=lambda: frame.load_depth_m() * np.float32(unit))

    here, there = fuse(photographed), fuse([in_unit(frame) for frame in photographed])
    assert len(there.xyz) == pytest.approx(len(here.xyz), rel=0.01)
    assert np.ptp(there.xyz, axis=0) / unit == pytest.approx(np.ptp(here.xyz, axis=0), rel=0.01)


@pytest.mark.slow
def test_noise_and_jitter_are_averaged_away() -> None:
    frames = film(table_with_sphere(), WALK, sensor=PHONE_LIKE)
    fused = fuse(frames)
    one = fuse(frames[:1])
    assert np.median(from_truth(fused.xyz)) < 0.0015 < 2 * np.median(from_truth(one.xyz))
    reach, _ = cKDTree(fused.xyz).query(upper_sphere())
    assert np.mean(reach < 3 * fused.voxel) > 0.95


def test_flying_pixels_are_dropped() -> None:
    frames = film(table_with_sphere(), WALK, sensor=Sensor(flying=1.0))
    assert np.mean(from_truth(fuse(frames).xyz) > 0.01) < 1e-3


def test_colours_stay_on_their_surfaces() -> None:
    fused = fuse(film(table_with_sphere(), WALK, sensor=CLEAN))
    assert fused.rgb is not None
    high = fused.xyz[:, 2] > 0.05
    assert np.abs(fused.rgb[high].astype(int) - [200, 40, 40]).max(axis=1).mean() < 8
    assert np.array_equal(np.median(fused.rgb[~high], axis=0), [150, 120, 90])


def chequered() -> Scene:
    """A table of light and dark tiles of 5 cm; a tile is light where the sum of its column and row is odd."""
    tiles = []
    for column, row in np.ndindex(24, 24):
        tile = plane(0.05, 0.05)
        tile.apply_translation(((column + 0.5) * 0.05 - 0.6, (row + 0.5) * 0.05 - 0.6, 0))
        tiles.append((tile, (220, 210, 190) if (column + row) % 2 else (60, 40, 30)))
    return scene(*tiles)


def tile_error(frames: tuple[Frame, ...]) -> float:
    """Mean difference of the colours within tiles from the truth, in levels."""
    fused = fuse(frames)
    assert fused.rgb is not None
    at = (fused.xyz[:, :2] + 0.6) / 0.05
    within = (np.abs(at % 1 - 0.5).max(axis=1) < 0.4) & (np.abs(fused.xyz[:, :2]).max(axis=1) < 0.55)
    light = np.floor(at[within]).sum(axis=1) % 2 == 1
    truth = np.where(light[:, None], (220, 210, 190), (60, 40, 30))
    return float(np.abs(fused.rgb[within].astype(float) - truth).mean())


def _shaken(frame: Frame) -> Frame:
    """With a picture that moved by 11 pixels while it was taken."""
    assert frame.load_rgb is not None
    rgb = cv2.blur(frame.load_rgb(), (11, 1))
    return replace(frame, load_rgb=lambda: rgb)


@pytest.mark.slow
def test_sharp_pictures_give_the_colours() -> None:
    frames = film(chequered(), WALK)
    half = tuple(_shaken(frame) if number % 2 else frame for number, frame in enumerate(frames))
    assert tile_error(frames) < 1
    assert tile_error(half) < 0.3 * tile_error(tuple(map(_shaken, frames)))


def test_frontal_pictures_give_the_colours() -> None:
    """The same colour everywhere in each picture: the table's is that of who looks down on it."""
    down, along = look_at((0, -0.1, 0.9), (0, 0, 0)), look_at((-0.9, 0, 0.25), (0, 0, 0))
    frames = [
        replace(frame, load_rgb=lambda level=level: np.full((192, 256, 3), level, np.uint8))
        for frame, level in zip(film(chequered(), np.stack([down, along])), (200, 100), strict=True)
    ]
    fused = fuse(frames)
    assert fused.rgb is not None
    middle = np.linalg.norm(fused.xyz, axis=1) < 0.1
    assert np.median(fused.rgb[middle]) > 190


@pytest.mark.slow
def test_what_most_views_see_through_goes() -> None:
    world = table_with_sphere()
    ghost = plane(0.1, 0.1, z=0.2)
    ghost.apply_translation([0.35, 0, 0])
    haunted = scene((plane(1.2, 1.2), (150, 120, 90)), (world.part(1), (200, 40, 40)), (ghost, (0, 255, 0)))
    frames = film(world, WALK[:8]) + film(haunted, WALK[8:9]) + film(world, WALK[9:])
    assert np.mean(from_truth(fuse(frames).xyz) > 0.02) < 1e-3


def test_what_one_view_alone_believes_goes_where_another_looks_through() -> None:
    """A sheet in front of the table, in one depth image of two."""
    table = plane(1.2, 1.2), (150, 120, 90)
    (haunted,) = film(scene(table, (plane(0.15, 0.15, z=0.2), (0, 255, 0))), WALK[:1])
    (clean,) = film(scene(table), WALK[2:3])
    assert fuse([haunted]).xyz[:, 2].max() > 0.15
    assert fuse([haunted, clean]).xyz[:, 2].max() < 0.05


@pytest.mark.slow
def test_confidence_grows_with_agreeing_views() -> None:
    frames = film(table_with_sphere(), WALK, sensor=PHONE_LIKE)
    many, few = fuse(frames), fuse(frames[:2])
    assert np.median(many.confidence) > np.median(few.confidence)
    assert many.confidence.min() >= 0
    assert many.confidence.max() <= 1


def test_unconfident_pixels_are_not_used() -> None:
    frames = film(table_with_sphere(), WALK)

    def left_half() -> Floats:
        sure = np.ones((PHONE.height, PHONE.width), np.float32)
        sure[:, PHONE.width // 2 :] = 0
        return sure

    doubtful = tuple(replace(frame, load_confidence=left_half) for frame in frames[:1])
    assert len(fuse(doubtful).xyz) < 0.6 * len(fuse(frames[:1]).xyz)


@pytest.mark.slow
def test_thin_poles_and_cloth_survive_the_sensor() -> None:
    pole = trimesh.creation.cylinder(radius=0.006, height=0.3, sections=16)
    pole.apply_translation([-0.2, 0, 0.16])
    cloth = plane(0.4, 0.35)
    cloth.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    cloth.apply_translation([0.25, 0, 0.25])
    world = scene((plane(1.2, 1.2), (150, 120, 90)), (pole, (200, 40, 40)), (cloth, (0, 0, 220)))
    xyz = to_points(rgbd(film(world, orbit(24, radius=0.8, height=0.5), sensor=PHONE_LIKE))).xyz
    for part in (1, 2):
        truth = trimesh.sample.sample_surface(world.part(part), 3_000, seed=1)[0]
        assert np.mean(cKDTree(xyz).query(truth)[0] < 0.01) > 0.95
    # Both sides of the cloth are seen, and they are one sheet.
    sheet = xyz[(np.abs(xyz[:, 0] - 0.25) < 0.05) & (xyz[:, 2] > 0.1)]
    assert np.median(np.abs(sheet[:, 0] - 0.25)) < 0.002


def test_a_sensor_that_trusts_nothing_is_used_with_a_warning() -> None:
    frames = film(table_with_sphere(), WALK[:2])
    unsure = tuple(replace(frame, load_confidence=lambda: np.zeros((192, 256), np.float32)) for frame in frames)
    points = to_points(rgbd(unsure))
    assert len(points) > 10_000
    assert points.warnings
    assert points.confidence.dtype == np.float32
    assert points.confidence.max() == 0


def test_a_full_grid_grows_its_voxel() -> None:
    samples = Samples(
        xyz=np.random.default_rng(0).uniform(-1, 1, (20_000, 3)).astype(np.float32),
        normal=np.zeros((20_000, 3), np.float32),
        light=np.zeros((20_000, 3), np.float32),
        clarity=np.zeros(20_000, np.float32),
        confidence=np.ones(20_000, np.float32),
        weight=np.ones(20_000, np.float32),
    )
    grid = VoxelGrid(0.001, limit=1_000)
    for part in range(4):
        grid.add(samples.take(np.arange(part, 20_000, 4)))
    averages = grid.averages()
    assert len(averages) <= 1_000
    assert grid.voxel > 0.1
    assert averages.weight.sum() == pytest.approx(20_000)


def test_the_voxel_is_the_callers_or_follows_the_pixels() -> None:
    frames = film(table_with_sphere(), WALK[:4])
    coarse = fuse(frames, voxel=0.02)
    assert coarse.voxel == 0.02
    spacing, _ = cKDTree(coarse.xyz).query(coarse.xyz, k=2)
    assert 0.01 < np.median(spacing[:, 1]) < 0.03
    assert 0.002 < fuse(frames).voxel < 0.008


def test_the_same_capture_gives_the_same_points() -> None:
    frames = film(table_with_sphere(), WALK[:4], sensor=PHONE_LIKE)
    assert np.array_equal(fuse(frames).xyz, fuse(frames).xyz)


def test_far_origin_keeps_precision() -> None:
    frames = film(table_with_sphere(), WALK[:4])
    offset = np.array([4e5, 5e6, 300.0])
    moved = tuple(replace(frame, camera_to_world=_shifted(frame.camera_to_world, offset)) for frame in frames)
    there, here = fuse(moved), fuse(frames)
    reach, _ = cKDTree(here.xyz).query(there.xyz - offset)
    # Rounding moves a few points into the next voxel; all others stay where they are.
    assert np.percentile(reach, 99.9) < 1e-5
    assert reach.max() < 2 * here.voxel


def _shifted(pose: Floats, offset: Floats) -> Floats:
    moved = pose.copy()
    moved[:3, 3] += offset
    return moved


def test_up_is_found_from_the_cameras_and_the_table() -> None:
    points = to_points(rgbd(film(table_with_sphere(), WALK[:6], sensor=PHONE_LIKE)))
    assert points.up is not None
    assert points.up @ [0, 0, 1] > np.cos(np.radians(1.0))
    assert points.scale_confidence == "metric"
    assert points.metres_per_unit == 1.0


def test_pictures_of_another_resolution_and_frames_without() -> None:
    frames = film(table_with_sphere(), WALK[:4])
    doubled = [
        replace(frame, load_rgb=lambda frame=frame: frame.load_rgb().repeat(2, axis=0).repeat(2, axis=1))
        for frame in frames[:3]
    ]
    blind = replace(frames[3], load_rgb=None)
    fused = fuse([*doubled, blind])
    assert fused.rgb is not None
    assert np.array_equal(np.median(fused.rgb[fused.xyz[:, 2] < 0.01], axis=0), [150, 120, 90])
    assert np.array_equal(np.median(fused.rgb[fused.xyz[:, 2] > 0.1], axis=0), [200, 40, 40])
    assert fuse([blind]).rgb is None


def test_no_depth_is_a_named_error() -> None:
    empty = replace(film(table_with_sphere(), WALK[:1])[0], load_depth_m=lambda: np.zeros((192, 256), np.float32))
    with pytest.raises(CaptureError) as error:
        fuse([empty])
    assert error.value.code == "CAPTURE_TOO_FEW_POINTS"
    assert error.value.hints


def test_depth_that_is_no_image_is_a_named_error() -> None:
    odd = replace(film(table_with_sphere(), WALK[:1])[0], load_depth_m=lambda: np.zeros((2, 192, 256), np.float32))
    with pytest.raises(CaptureError) as error:
        fuse([odd])
    assert error.value.code == "CAPTURE_COUNT_MISMATCH"
    assert error.value.file == "0000"


def test_one_frame_and_a_larger_sensor() -> None:
    pose = look_at((1.0, 0.3, 0.8), (0, 0, 0.1))[None]
    fused = fuse(film(table_with_sphere(), pose, KINECT, Sensor(noise_m=0.002)))
    assert len(fused.xyz) > 50_000
    assert np.median(from_truth(fused.xyz)) < 0.002


def test_ticks_rise_to_one_and_cancel() -> None:
    capture = rgbd(film(table_with_sphere(), WALK[:4]))
    seen: list[float] = []
    to_points(capture, cut="object", tick=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)

    def stop(fraction: float) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        to_points(capture, tick=stop)


def test_linear_light_round_trips() -> None:
    every = np.arange(256, dtype=np.uint8)
    assert np.array_equal(to_srgb(to_linear(every)), every)


@pytest.mark.slow
@pytest.mark.data
def test_real_living_room(data_dir: Path) -> None:
    points = to_points(read_capture(data_dir / "rgbd_livingroom"))
    assert 100_000 < len(points) < 1_500_000
    assert points.rgb is not None
    # The floor of this scene is horizontal: y is up.
    assert points.up is not None
    assert abs(points.up[1]) > np.cos(np.radians(1.0))
    floor = points.xyz[np.abs(points.xyz[:, 1] - np.median(points.xyz[points.xyz[:, 1] < 0.2][:, 1])) < 0.03]
    assert np.std(floor[:, 1]) < 0.01


@pytest.mark.data
def test_real_phone_frame(data_dir: Path) -> None:
    points = to_points(read_capture(data_dir / "phone_tof"))
    assert len(points) > 15_000
    assert points.rgb is not None
    assert np.ptp(points.xyz, axis=0).max() < 3
