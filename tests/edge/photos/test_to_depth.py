"""Photos to depth images: the parts on closed forms, the whole on a rendered walk-around whose truth is known."""

from __future__ import annotations

import json
import threading
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, Photo
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.mesh.align_to_reference import align_to_surface
from capture2vr.edge.photos import depth_maps, plane_sweep, plane_sweep_torch
from capture2vr.edge.photos.depth_consistency import confirmations
from capture2vr.edge.photos.depth_maps import depth_frames
from capture2vr.edge.photos.plane_sweep import vertex
from capture2vr.edge.photos.sgm import P1, aggregate
from capture2vr.edge.photos.source_views import choose_sources
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.photos.undistorted import UndistortedPhoto
from capture2vr.edge.photos.warp import WarpSource
from capture2vr.edge.photos.zncc import BestTwo, Windows
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.progress import Progress
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from tests.support.patience import CANCEL_S
from tests.support.photos.walkaround import Walkaround, render_walkaround

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV camera axes <-> OpenGL camera axes
SIZE_M = 0.4  # of the thing that is walked around


# The parts


def _slow_paths(cost: np.ndarray) -> np.ndarray:
    """Eq. 13 of the paper word for word, in a picture without edges, where P2 is what `aggregate` has on them."""
    from capture2vr.edge.photos.sgm import P2

    rows, columns, planes = cost.shape
    total = np.zeros(cost.shape, int)
    for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        path = np.zeros(cost.shape, int)
        for i in range(rows)[:: down or 1]:
            for j in range(columns)[:: right or 1]:
                before = (i - down, j - right)
                first = not (0 <= before[0] < rows and 0 <= before[1] < columns)
                for d in range(planes):
                    path[i, j, d] = cost[i, j, d]
                    if first:
                        continue
                    last = path[before]
                    sides = [last[e] + P1 for e in (d - 1, d + 1) if 0 <= e < planes]
                    path[i, j, d] += min(last[d], *sides, last.min() + P2) - last.min()
        total += path
    return total


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(3, 6)))
def test_paths_are_summed_as_the_paper_says(seed: int, shape: tuple[int, int, int]) -> None:
    cost = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
    grey = np.full(shape[:2], 100, np.uint8)
    assert np.array_equal(aggregate(cost, grey), _slow_paths(cost))


def test_a_lone_mismatch_follows_its_neighbours_and_an_edge_lets_depth_jump() -> None:
    cost = np.full((20, 30, 8), 120, np.uint8)
    cost[:, :15, 2], cost[:, 15:, 6] = 20, 20
    cost[10, 5] = 120
    cost[10, 5, 7] = 60  # by itself this pixel would choose plane 7
    grey = np.repeat(np.repeat([[50, 200]], 15, axis=1), 20, axis=0).astype(np.uint8)
    chosen = aggregate(cost, grey).argmin(axis=2)
    assert (chosen[:, :15] == 2).all()
    assert (chosen[:, 15:] == 6).all()


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 1.5), st.floats(-40, 40))
def test_exposure_changes_no_correlation(seed: int, gain: float, offset: float) -> None:
    grey = np.random.default_rng(seed).integers(60, 160, (24, 32)).astype(np.uint8)
    same = Windows.of(grey).zncc(grey.astype(np.float32) * np.float32(gain) + np.float32(offset))
    assert same.min() > 0.98
    assert same.max() <= 1.001


def test_plain_walls_correlate_with_nothing() -> None:
    rng = np.random.default_rng(0)
    wall = np.full((40, 40), 128, np.float32)
    seen = Windows.of((wall + rng.normal(0, 0.3, wall.shape)).round().astype(np.uint8))
    assert np.abs(seen.zncc(wall + rng.normal(0, 0.3, wall.shape).astype(np.float32))).max() < 0.3


def test_the_best_two_of_the_scores_count_or_the_only_one() -> None:
    best = BestTwo((1,))
    best.add(np.array([0.5], np.float32))
    assert best.mean()[0] == pytest.approx(0.5)
    for score in (-0.2, 0.9, 0.1):
        best.add(np.array([score], np.float32))
    assert best.mean()[0] == pytest.approx(0.7)


@given(st.floats(-0.9, 0.9), st.floats(0.1, 10), st.floats(-5, 5))
def test_a_parabola_is_least_at_its_vertex(at: float, bend: float, level: float) -> None:
    values = [np.array([bend * (x - at) ** 2 + level]) for x in (-1, 0, 1)]
    assert vertex(*values)[0] == pytest.approx(at, abs=1e-5)


def test_smoothing_takes_noise_off_a_slope_and_keeps_its_edge() -> None:
    row, column = np.mgrid[:40, :60].astype(np.float32)
    slope = 1 + 0.002 * row + 0.003 * column + np.where(column < 30, 0, np.float32(0.5))
    inner = slice(3, -3)
    off = np.abs(plane_sweep._smooth(slope, 0.05) - slope)[inner, inner]
    assert np.delete(off, np.s_[24:30], axis=1).max() < 1e-5
    assert off.max() < 0.002, "half a pixel's slope, beside the edge"
    noise = np.random.default_rng(0).normal(0, 0.005, slope.shape).astype(np.float32)
    left = plane_sweep._smooth(slope + noise, 0.05) - slope
    assert left[inner, inner].std() < 0.5 * noise.std()


def test_what_is_behind_a_source_is_not_in_its_picture() -> None:
    turned = np.ones((3, 20, 30), np.float32)
    source = WarpSource(np.full((50, 50), 90, np.float32), np.eye(3), np.array([0, 0, -1.0]), np.eye(3))
    q = np.linspace(0, 2, 600).reshape(20, 30).astype(np.float32)  # behind it from 1 on
    seen = source.at(turned, q)
    assert (seen[q < 0.9] > 0).all()
    assert (seen[q >= 1] == 0).all()


def test_where_there_is_no_least_value_the_lower_side_is_taken() -> None:
    assert vertex(np.array([1.0]), np.array([2.0]), np.array([1.5]))[0] == -1
    assert vertex(np.array([3.0]), np.array([2.0]), np.array([1.0]))[0] == 1


def _view(eye: list[float], turn_deg: float = 0.0, size: tuple[int, int] = (80, 60)) -> PhotoView:
    """A camera that looks along +Z, turned about Y."""
    turn = np.radians(turn_deg)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    pose[:3, 3] = eye
    camera = Intrinsics(80.0, 80.0, (size[0] - 1) / 2, (size[1] - 1) / 2, *size)

    def load(longest: int | None = None) -> np.ndarray:
        return np.zeros((size[1], size[0], 3), np.uint8)

    return PhotoView(Photo(f"{eye}", size, "one", load), camera, (0.0,) * 5, pose)


def _wall(view: PhotoView, distance: float) -> tuple[UndistortedPhoto, Floats]:
    """How the view sees the plane z = distance: its picture without content, and the depth."""
    camera = view.intrinsics
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    along = (ray @ view.camera_to_world[:3, :3].T)[..., 2]
    depth = ((distance - view.camera_to_world[2, 3]) / along).astype(np.float32)
    grey = np.zeros(u.shape, np.uint8)
    return UndistortedPhoto(view, grey, camera, np.linalg.inv(view.camera_to_world)), depth


def test_views_confirm_what_they_see_alike_and_nothing_else() -> None:
    seen = [_wall(view, 2.0) for view in (_view([0, 0, 0]), _view([0.3, 0, 0], -8), _view([-0.3, 0.1, 0], 8))]
    pictures, depths = [each[0] for each in seen], [each[1] for each in seen]
    strict, loose = confirmations(0, (1, 2), pictures, depths)
    assert np.median(strict) == np.median(loose) == 2
    strict, loose = confirmations(0, (1, 2), pictures, [depths[0] * 1.009, depths[1], depths[2]])
    assert np.median(loose) == 2, "which is between the two tolerances"
    assert not strict.any()
    for wrong in (depths[0] * 1.03, np.zeros_like(depths[0])):
        strict, loose = confirmations(0, (1, 2), pictures, [wrong, *depths[1:]])
        assert not strict.any()
        assert not loose.any()


def test_sources_see_the_same_from_both_sides_at_angles_that_show_depth() -> None:
    points = np.random.default_rng(0).uniform([-0.3, -0.3, 1.9], [0.3, 0.3, 2.1], (50, 3))
    angles = (0, 9, -9, 0.5, 60, 18)
    eyes = [[2 * np.sin(np.radians(a)), 0.0, 2 - 2 * np.cos(np.radians(a))] for a in angles]
    views = (*(_view(eye, -angle) for eye, angle in zip(eyes, angles, strict=True)), _view([9, 9, 9]))
    seen_view = np.repeat(np.arange(len(eyes)), len(points))  # the last view shares nothing
    alignment = Alignment(views, points, np.tile(np.arange(len(points)), len(eyes)), seen_view, 0.3, ())
    chosen = choose_sources(alignment, 3)
    assert set(chosen[0][:2]) == {1, 2}
    assert chosen[0][2] == 5
    assert chosen[-1] == ()


# The whole


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walkaround:
    """A third of the way round, in small pictures."""
    return render_walkaround(tmp_path_factory.mktemp("walk"), views=9, size=(400, 300), arc=100)


@pytest.fixture(scope="module")
def posed(walk: Walkaround, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """The walk with its true cameras, as a program writes them."""
    folder = tmp_path_factory.mktemp("posed")
    camera = walk.intrinsics
    tree = {
        "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy,
        "cx": camera.cx + 0.5, "cy": camera.cy + 0.5,
        "frames": [
            {"file_path": f"images/{photo.name}", "transform_matrix": (pose @ FLIP).tolist()}
            for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True)
        ],
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(tree))
    (folder / "images").mkdir()
    for photo in walk.photos:
        (folder / "images" / photo.name).write_bytes(photo.read_bytes())
    return read_capture(folder)


@pytest.fixture(scope="module")
def aligned(posed: Capture) -> Alignment:
    return align(posed.photos)


@pytest.fixture(scope="module")
def frames(aligned: Alignment) -> tuple[Frame, ...]:
    return depth_frames(aligned)


def _world(frame: Frame) -> Floats:
    """(N,3) the points of a frame."""
    depth, camera, pose = frame.load_depth_m(), frame.intrinsics, frame.camera_to_world
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z])
    return (pose[:3, :3] @ local).T + pose[:3, 3]


def _errors(xyz: Floats, walk: Walkaround) -> tuple[Floats, Floats]:
    """Distances of points to the thing or the table, whichever is nearer, and of the thing's visible half to them."""
    truth, _ = trimesh.sample.sample_surface(trimesh.Trimesh(walk.thing.vertices, walk.thing.faces), 60_000, seed=0)
    thing, _ = cKDTree(truth).query(xyz)
    gaps, _ = cKDTree(xyz).query(truth[::20])
    return np.minimum(thing, np.abs(xyz[:, 2] - walk.floor_z)), gaps


@pytest.mark.slow
def test_depth_lies_on_the_thing_and_on_the_table(frames: tuple[Frame, ...], walk: Walkaround) -> None:
    assert len(frames) == len(walk.photos)
    xyz = np.concatenate([_world(frame) for frame in frames])
    near = xyz[np.linalg.norm(xyz[:, :2], axis=1) < 0.3]
    errors, gaps = _errors(near[:: len(near) // 50_000 + 1], walk)
    assert np.median(errors) < 0.003 * SIZE_M
    assert np.percentile(errors, 95) < 0.02 * SIZE_M
    assert (
        np.percentile(gaps, 60) < 0.01 * SIZE_M
    )  # of all sides, of which the walk saw a third and through the open top


@pytest.mark.slow
def test_frames_are_what_a_depth_sensor_would_have_recorded(frames: tuple[Frame, ...]) -> None:
    for frame in frames:
        depth, rgb = frame.load_depth_m(), frame.load_rgb() if frame.load_rgb else None
        confidence = frame.load_confidence() if frame.load_confidence else None
        assert depth.dtype == np.float32
        assert depth.shape == (frame.intrinsics.height, frame.intrinsics.width)
        assert rgb is not None
        assert rgb.shape == (*depth.shape, 3)
        assert confidence is not None
        assert 0.25 < confidence.min() <= confidence.max() <= 1
        assert (depth > 0).mean() > 0.15


@pytest.mark.slow
def test_a_photo_held_sideways_becomes_an_upright_frame_of_the_same_points(aligned: Alignment) -> None:
    views = aligned.views[:4]
    seen = np.isin(aligned.seen_view, range(4))
    part = replace(aligned, views=views, seen_point=aligned.seen_point[seen], seen_view=aligned.seen_view[seen])
    turned = tuple(replace(view, photo=replace(view.photo, turns=turns)) for turns, view in enumerate(views))
    for turns, (plain, sideways) in enumerate(
        zip(depth_frames(part, longest=160), depth_frames(replace(part, views=turned), longest=160), strict=True)
    ):
        shape = plain.load_depth_m().shape
        assert sideways.load_depth_m().shape == (shape if turns % 2 == 0 else shape[::-1])
        here, there = _world(plain), _world(sideways)
        assert len(here) == len(there) > 500
        assert cKDTree(here).query(there)[0].max() < 1e-5
        assert sideways.load_rgb is not None
        assert plain.load_rgb is not None
        assert np.array_equal(np.rot90(plain.load_rgb(), -turns), sideways.load_rgb())


@pytest.mark.slow
def test_the_sweep_ends_soon_after_its_job_is_cancelled(aligned: Alignment) -> None:
    began: list[float] = []

    def cancel(fraction: float) -> None:
        if not began:
            began.append(time.perf_counter())
            raise Cancelled

    with pytest.raises(Cancelled):
        depth_frames(aligned, tick=cancel)
    assert time.perf_counter() - began[0] < CANCEL_S
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPool")]


@pytest.mark.slow
def test_depth_for_which_a_gpu_has_no_room_is_computed_on_the_cpu(
    aligned: Alignment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other jobs fill it, from the first picture on or while the planes are compared."""
    asked: list[int] = []

    def full(values: torch.Tensor) -> torch.Tensor:
        asked.append(values.dim())
        if len(asked) == 1 or values.dim() == 3:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 MiB.")
        return box(values)

    box = plane_sweep_torch._box
    monkeypatch.setattr(plane_sweep_torch, "_box", full)
    monkeypatch.setattr(depth_maps, "backend_on", lambda _: lambda a, b: plane_sweep_torch.TorchSweep(a, b, "cpu"))
    found, expected = depth_frames(aligned, longest=160, device="cuda:0"), _on_the_cpu(aligned)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.load_depth_m(), other.load_depth_m())
    assert 3 in asked


def _on_the_cpu(aligned: Alignment) -> tuple[Frame, ...]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(depth_maps, "backend_on", plane_sweep.backend_on)
        return depth_frames(aligned, longest=160)


@pytest.mark.slow
def test_views_that_share_nothing_are_an_error_that_says_what_to_do(aligned: Alignment) -> None:
    strangers = replace(aligned, seen_view=aligned.seen_view[:0], seen_point=aligned.seen_point[:0])
    with pytest.raises(CaptureError, match="no two of the 9 placed photos") as caught:
        depth_frames(strangers)
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"
    assert caught.value.hints


@pytest.mark.slow
def test_photos_without_poses_come_out_at_arms_length_in_the_same_shape(walk: Walkaround) -> None:
    capture = read_capture(walk.photos[0].parent)
    assert (capture.kind, len(capture.photos)) == ("photos", 9)
    said: list[float] = []
    depth = to_depth(capture, tick=said.append)
    assert said == sorted(said)
    assert said[-1] == pytest.approx(1)
    assert (depth.kind, depth.scale_confidence) == ("rgbd", "unknown")
    assert [(verdict.name, verdict.verdict) for verdict in depth.verdicts] == [(p.name, "ok") for p in walk.photos]
    points = to_points(depth, cut="object")
    # The thing is 0.4 m high where cameras are 0.95 m away; at arm's length it is smaller by their ratio.
    eyes = np.stack([frame.camera_to_world[:3, 3] for frame in depth.frames])
    truth = walk.camera_to_world[:, :3, 3]
    scale = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum() / np.linalg.norm(np.diff(eyes, axis=0), axis=1).sum()
    height = (points.xyz - eyes[0]) @ points.up * scale if points.up is not None else np.zeros(1)
    assert np.ptp(height) == pytest.approx(SIZE_M, rel=0.15)


@pytest.mark.slow
def test_a_black_capture_says_so(walk: Walkaround) -> None:
    capture = read_capture(walk.photos[0].parent)

    def black(photo: Photo) -> Photo:
        return replace(photo, load=lambda longest=None: np.zeros((60, 80, 3), np.uint8))

    with pytest.raises(CaptureError, match="dark") as caught:
        to_depth(replace(capture, photos=tuple(map(black, capture.photos))))
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_the_pipeline_aligns_first_and_the_manifest_names_every_photo(posed: Capture, walk: Walkaround) -> None:
    options = JobOptions(cut="object", names=AssetNames("Shell"))
    steps = list(reconstruct(posed, replace(load_preset("draft"), resolution=48), options))
    stages = list(dict.fromkeys(step.stage for step in steps if isinstance(step, Progress)))
    assert stages[:2] == ["ALIGNING", "POINT_CLOUD"]
    fractions = [step.fraction for step in steps if isinstance(step, Progress)]
    assert fractions == sorted(fractions)
    *_, bundle = [step for step in steps if isinstance(step, Bundle)]
    told = bundle.manifest["capture"]
    assert (told["kind"], told["format"], told["frames"]) == ("photos", "nerfstudio", 9)
    assert [photo["verdict"] for photo in told["photos"]] == ["ok"] * 9
    # Nothing tells the unit of the poses: the capture's frame keeps it, and the thing stands upright, at arm's length.
    to_asset = np.reshape(bundle.manifest["capture_to_asset"], (4, 4))
    metres_per_unit = np.linalg.norm(to_asset[:3, 0])
    assert bundle.manifest["size_m"][1] / metres_per_unit == pytest.approx(SIZE_M, rel=0.15)
    assert metres_per_unit == pytest.approx(0.6 / 0.95, rel=0.2)
    assert any("tell no unit" in warning for warning in bundle.manifest["warnings"])
    # The photos' cameras stand beside the asset, with Z up.
    cameras = json.loads(bundle.files["cameras.json"])["cameras"]
    assert [each["name"] for each in cameras] == [f"images/{photo.name}" for photo in walk.photos]
    places = np.array([each["camera_to_world"] for each in cameras])[:, :, 3]
    x, y, z = (np.stack(walk.camera_to_world)[:, :3, 3] @ to_asset[:3, :3].T + to_asset[:3, 3]).T
    np.testing.assert_allclose(places, np.stack([x, -z, y], axis=1), atol=1e-6)


@pytest.mark.slow
def test_poses_in_metres_keep_them(posed: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.photos.to_depth.depth_frames", lambda *_, **__: ())
    metric = to_depth(replace(posed, scale_confidence="metric"))
    assert metric.metres_per_unit == 1
    assert not any("tell no unit" in warning for warning in metric.warnings)
    assert to_depth(posed).metres_per_unit == pytest.approx(0.6 / 0.95, rel=0.2)


@pytest.mark.slow
@pytest.mark.data
def test_photographed_fruit_lies_on_the_reference_surface(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its mesh was made by another program from larger pictures; the cameras, then the surface, are laid over ours.

    The depth images are of 480 pixels here, of 600 in the bench.
    """
    folder = data_dir / "photos_fruit"
    monkeypatch.setattr("capture2vr.edge.photos.to_depth.depth_frames", partial(depth_frames, longest=480))
    depth = to_depth(read_capture(folder / "images"))
    assert [verdict.verdict for verdict in depth.verdicts] == ["ok"] * 20
    given = {
        f"{camera.get('label')}.JPG": np.array((camera.findtext("transform") or "").split(), float).reshape(4, 4)
        for camera in ElementTree.parse(folder / "camera.xml").getroot().iter("camera")
    }
    ours = np.stack([frame.camera_to_world[:3, 3] for frame in depth.frames])
    theirs = np.stack([given[frame.name][:3, 3] for frame in depth.frames])
    to_theirs, _, _ = trimesh.registration.procrustes(ours, theirs, reflection=False)
    mesh = trimesh.load_mesh(folder / "foo.obj", process=False)
    truth, face = trimesh.sample.sample_surface(mesh, 100_000, seed=0)
    # A long lens leaves the focal length open by a percent, and with it the scale between cameras and thing.
    xyz = align_to_surface(to_points(depth, cut="object").xyz, truth, mesh.face_normals[face], to_theirs)
    assert len(xyz) > 20_000
    gap, nearest = cKDTree(truth).query(xyz)
    off = np.abs(np.einsum("ni,ni->n", xyz - truth[nearest], mesh.face_normals[face[nearest]]))
    size = np.ptp(mesh.vertices, axis=0).max()
    assert np.median(off) < 0.004 * size
    assert np.percentile(gap, 95) < 0.03 * size
