"""Frames without poses: alignment, key frames and loops against the true poses of rendered scenes and real frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.odometry import tracker
from capture2vr.edge.odometry.icp import align
from capture2vr.edge.odometry.loop_closure import ClosedWay
from capture2vr.edge.odometry.pose_graph import Edge, optimise_poses
from capture2vr.edge.odometry.pyramid import PyramidLevel, pyramid
from capture2vr.edge.odometry.relocalise import relocalise
from capture2vr.edge.odometry.tracker import track_frames
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.read_capture import read_capture
from tests.support import captures
from tests.support.flat_walks import flat_walk
from tests.support.scenes import PHONE, Scene, Sensor, film, look_at, orbit, plane, scene, table_with_sphere

SENSOR = Sensor(noise_m=0.003, flying=0.3)
ORBIT = orbit(18, radius=0.8, height=0.6)


def things(count: int = 14) -> Scene:
    """A table of boxes in many colours, every one turned another way: nothing in it slides or looks alike."""
    rng = np.random.default_rng(0)
    parts = [(plane(1.6, 1.6), (150, 120, 90))]
    for _ in range(count):
        size, radius, angle = rng.uniform(0.06, 0.22, 3), rng.uniform(0.05, 0.45), rng.uniform(0, 2 * np.pi)
        box = trimesh.creation.box(size)
        box.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0, 3), (0, 0, 1)))
        box.apply_translation((radius * np.cos(angle), radius * np.sin(angle), size[2] / 2))
        red, green, blue = (int(value) for value in rng.integers(30, 220, 3))
        parts.append((box, (red, green, blue)))
    return scene(*parts)


def bare(frames: tuple[Frame, ...], *, coloured: bool = True) -> tuple[Frame, ...]:
    return tuple(replace(f, camera_to_world=None, load_rgb=f.load_rgb if coloured else None) for f in frames)


def off_m(tracked: tuple[Frame, ...], truth: Floats) -> Floats:
    """Distance (N,) of the cameras from where they were, both seen from the first camera."""
    eyes = np.stack([frame.camera_to_world for frame in tracked if frame.camera_to_world is not None])[:, :3, 3]
    return np.linalg.norm(eyes - (np.linalg.inv(truth[0]) @ truth)[:, :3, 3], axis=1)


def levels(pose: Floats, world: Scene, *, noise_m: float = 0.0, seed: int = 0) -> tuple[PyramidLevel, ...]:
    (frame,) = film(world, pose[None], sensor=Sensor(noise_m=noise_m), seed=seed)
    level = tracker._level(frame, tracker.survey_frames([frame]).limits, FrameFaults())
    assert level is not None
    return pyramid(level)


@pytest.mark.slow
@pytest.mark.parametrize("coloured", [True, False])
def test_a_walk_around_a_table_closes(coloured: bool) -> None:
    """4.8 m of way with the noise of a phone: the cameras are within 2 mm of the truth."""
    frames = film(things(), ORBIT, sensor=SENSOR)
    tracked = track_frames(bare(frames, coloured=coloured))
    assert not tracked.warnings
    assert [frame.name for frame in tracked.frames] == [frame.name for frame in frames]
    assert off_m(tracked.frames, ORBIT).max() < 0.002


@pytest.mark.slow
def test_loops_take_the_drift_out(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = bare(film(things(), ORBIT, sensor=Sensor(noise_m=0.006)), coloured=False)
    closed = off_m(track_frames(frames).frames, ORBIT)
    monkeypatch.setattr(tracker, "close_loops", lambda _keys, poses, _steps, _tick: ClosedWay(poses, ()))
    drifted = off_m(track_frames(frames).frames, ORBIT)
    assert closed[-1] < 0.5 * drifted[-1]


@pytest.mark.slow
@pytest.mark.parametrize("first", [340, 810])
def test_a_wallpaper_does_not_make_the_camera_leap(first: int) -> None:
    """The look turns upwards at once, to a wall with a dot every 25 cm: a fit one period away is nearly as good."""
    walk = flat_walk(16, 2000)
    few = replace(walk, poses=walk.poses[first : first + 7])
    tracked = track_frames(bare(tuple(few.frames())))
    assert off_m(tracked.frames, few.poses).max() < 0.01


@pytest.mark.slow
def test_a_sphere_on_a_table_turns_unseen_and_is_no_pose() -> None:
    """The same picture from all sides, and the table fills the frame: a name, not a wrong cloud."""
    with pytest.raises(CaptureError) as error:
        track_frames(bare(film(table_with_sphere(), ORBIT[:8], sensor=SENSOR)))
    assert error.value.code == "CAPTURE_NO_POSES"
    assert error.value.file == "0001"
    assert len(error.value.hints) == 3


@pytest.mark.parametrize("noise_m", [0.0, 0.003, 0.01])
def test_a_bare_wall_holds_no_camera(noise_m: float) -> None:
    wall = scene((plane(6, 6), (150, 120, 90)))
    here, there = (look_at((x, -0.5, 1.5), (x, 0, 0)) for x in (0, 0.03))
    source, target = levels(there, wall, noise_m=noise_m), levels(here, wall, noise_m=noise_m, seed=1)
    fit = align(source, target, np.eye(4))
    assert fit is None or not fit.sound


@pytest.mark.slow
@settings(max_examples=15)
@given(st.tuples(*[st.floats(-1, 1)] * 6))
def test_alignment_finds_any_small_motion(motion: tuple[float, ...]) -> None:
    """Turns up to 4 degrees and shifts up to 4 cm about each axis, without noise."""
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(np.radians(4) * np.array(motion[:3])).as_matrix()
    step[:3, 3] = 0.04 * np.array(motion[3:])
    fit = align(levels(ORBIT[0] @ step, WORLD), TARGET, np.eye(4))
    assert fit is not None
    assert fit.sound
    np.testing.assert_allclose(fit.pose, step, atol=1e-3)


WORLD = things()
TARGET = levels(ORBIT[0], WORLD)


def test_pictures_find_a_camera_that_jumped() -> None:
    far = look_at((0.75, 0.2, 0.6), (0, 0, 0.1)) @ np.diag([-1.0, -1, 1, 1])  # held upside down
    fit = relocalise(levels(far, WORLD, noise_m=0.002), TARGET[-1])
    assert fit is not None
    assert np.linalg.norm(fit.pose[:3, 3] - (np.linalg.inv(ORBIT[0]) @ far)[:3, 3]) < 0.004


@pytest.mark.slow
def test_a_jump_to_elsewhere_leaves_the_rest_out_with_a_warning() -> None:
    frames = film(things(), ORBIT[:10], sensor=SENSOR)
    lost = film(table_with_sphere(), ORBIT[:3], sensor=SENSOR)
    lost = tuple(replace(frame, name=f"elsewhere {number}") for number, frame in enumerate(lost))
    tracked = track_frames(bare(frames + lost))
    assert [frame.name for frame in tracked.frames] == [frame.name for frame in frames]
    assert "elsewhere 0: 3 of 13" in tracked.warnings[0]


@pytest.mark.slow
def test_one_blank_frame_between_is_left_out() -> None:
    frames = bare(film(things(), ORBIT[:5], sensor=SENSOR))
    blank = replace(frames[2], load_depth_m=lambda: np.zeros((PHONE.height, PHONE.width), np.float32))
    tracked = track_frames([*frames[:2], blank, *frames[3:]])
    assert [frame.name for frame in tracked.frames] == ["0000", "0001", "0003", "0004"]
    assert "0002" in tracked.warnings[0]


@pytest.mark.slow
def test_frames_whose_texture_is_all_beyond_the_depth_are_tracked() -> None:
    """A plain thing before a town: the sensor reaches the thing alone, and the picture's features have no depth."""
    far = np.zeros((PHONE.height, PHONE.width), bool)
    far[:50] = True

    def before_a_town(frame: Frame, number: int) -> Frame:
        rgb = np.full((*far.shape, 3), 128, np.uint8)
        rgb[:40] = np.random.default_rng(number).integers(0, 255, (10, 64, 3)).repeat(4, 0).repeat(4, 1)
        depth_m = np.where(far, 0, frame.load_depth_m()).astype(np.float32)
        return replace(frame, load_depth_m=lambda: depth_m, load_rgb=lambda: rgb)

    frames = [before_a_town(frame, number) for number, frame in enumerate(film(things(), ORBIT[:8], sensor=SENSOR))]
    assert len(track_frames(bare(tuple(frames))).frames) == 8


def test_one_frame_alone_is_the_world() -> None:
    (frame,) = track_frames(bare(film(things(), ORBIT[:1]))).frames
    assert frame.camera_to_world is not None
    assert np.array_equal(frame.camera_to_world, np.eye(4))


def test_ticks_rise_to_one_and_cancel() -> None:
    frames = bare(film(things(), ORBIT[:4]))
    seen: list[float] = []
    track_frames(frames, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def stop(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        track_frames(frames, stop)


def _moved(rng: np.random.Generator, turn: float, shift: float) -> Floats:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn * rng.standard_normal(3)).as_matrix()
    pose[:3, 3] = shift * rng.standard_normal(3)
    return pose


@pytest.mark.slow
@settings(max_examples=4)
@given(st.integers(0, 1000))
def test_a_pose_graph_returns_to_the_truth(seed: int) -> None:
    """Exact edges of a ring with chords, and one that is wrong by metres: drifted poses come back."""
    rng = np.random.default_rng(seed)
    truth = np.stack([np.eye(4), *(_moved(rng, 1.0, 1.0) for _ in range(9))])
    pairs = [(i, (i + step) % 10) for i in range(10) for step in (1, 3)]
    edges = [Edge(i, j, np.linalg.inv(truth[i]) @ truth[j], np.eye(6) * 1e8) for i, j in pairs]
    drifted = np.stack([np.eye(4), *(pose @ _moved(rng, 0.05, 0.05) for pose in truth[1:])])
    np.testing.assert_allclose(optimise_poses(drifted, edges), truth, atol=1e-6)
    wrong = Edge(2, 7, _moved(rng, 0.3, 1.0), np.eye(6) * 1e8)
    np.testing.assert_allclose(optimise_poses(drifted, [*edges, wrong]), truth, atol=0.01)


@pytest.mark.slow
def test_points_of_frames_without_poses_lie_on_the_things() -> None:
    """In the axes of the first camera; up is found."""
    world = things()
    capture = Capture(
        "rgbd", "synthetic", frames=bare(film(world, ORBIT[:8], sensor=SENSOR)), scale_confidence="metric"
    )
    ticks: list[float] = []
    points = to_points(capture, cut="scene", tick=ticks.append)
    xyz = points.xyz @ ORBIT[0][:3, :3].T + ORBIT[0][:3, 3]
    truth = trimesh.Trimesh(world.vertices, world.faces, process=False).sample(200_000)
    assert np.median(cKDTree(truth).query(xyz)[0]) < 0.003
    assert points.up is not None
    assert (ORBIT[0][:3, :3] @ points.up)[2] > np.cos(np.radians(1.0))
    assert ticks == sorted(ticks)
    assert ticks[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["open3d", "tum"])
def test_recordings_without_a_trajectory_are_read(name: str, tmp_path: Path) -> None:
    folder = captures.RGBD[name](tmp_path)
    posed = read_capture(folder)
    for log in ("trajectory.log", "groundtruth.txt"):
        (folder / log).unlink(missing_ok=True)
    capture = read_capture(folder)
    assert capture.format == name
    assert capture.up is None
    assert capture.scale_confidence == "metric"
    for frame, known in zip(capture.frames, posed.frames, strict=True):
        assert frame.camera_to_world is None
        assert (frame.name, frame.intrinsics) == (known.name, known.intrinsics)
        np.testing.assert_array_equal(frame.load_depth_m(), known.load_depth_m())
        assert frame.load_rgb is not None


@pytest.mark.slow
@pytest.mark.data
def test_the_living_room_without_its_trajectory(data_dir: Path) -> None:
    """10 cm of way in five frames."""
    posed = read_capture(data_dir / "rgbd_livingroom").frames
    truth = np.stack([frame.camera_to_world for frame in posed if frame.camera_to_world is not None])
    tracked = track_frames(bare(posed))
    assert off_m(tracked.frames, truth).max() < 0.003
