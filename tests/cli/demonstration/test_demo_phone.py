"""The simulated phone: its files can be read, and what they say lies on the true surface, but for a sensor's faults."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from capture2vr.cli.demonstration.demo_garment import garment, garment_scene
from capture2vr.cli.demonstration.demo_phone import simulate_capture
from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.mesh.topology import component_count
from capture2vr.edge.read_capture import read_capture
from tests.support import surfaces

FRAMES = 6


@pytest.fixture(scope="module")
def scene() -> Mesh:
    return garment_scene()


@pytest.fixture(scope="module")
def archive(scene: Mesh, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_capture(scene, tmp_path_factory.mktemp("phone") / "walk", frames=FRAMES)


@pytest.fixture(scope="module")
def folder(archive: Path) -> Path:
    return archive.with_suffix("")


@pytest.fixture(scope="module")
def capture(folder: Path) -> Capture:
    return read_capture(folder)


def points_of(frame: Frame) -> Floats:
    """(N,3) what the frame's depth says, in the world."""
    depth_m = frame.load_depth_m()
    row, column = np.nonzero(depth_m)
    camera, z = frame.intrinsics, depth_m[row, column]
    local = np.stack([(column - camera.cx) / camera.fx * z, (row - camera.cy) / camera.fy * z, z], axis=1)
    return local @ frame.camera_to_world[:3, :3].T + frame.camera_to_world[:3, 3]


@pytest.mark.slow
def test_the_capture_reads_as_rgbd_frames_of_a_lidar_phone(capture: Capture) -> None:
    assert (capture.kind, capture.format, len(capture.frames)) == ("rgbd", "nerfstudio", FRAMES)
    for frame in capture.frames:
        assert frame.load_depth_m().shape == (192, 256)
        assert frame.load_rgb is not None
        assert frame.load_rgb().shape == (720, 960, 3)


@pytest.mark.slow
def test_depth_lies_on_the_surface_but_for_noise(capture: Capture, scene: Mesh) -> None:
    surface = cKDTree(sample(scene, 400_000, np.random.default_rng(0)).xyz)
    gap = np.concatenate([surface.query(points_of(frame)[::20])[0] for frame in capture.frames])
    assert np.median(gap) < 0.02
    assert np.quantile(gap, 0.5) > 0.001  # a sensor without noise would prove nothing


@pytest.mark.slow
def test_edges_have_flying_pixels_and_grazing_surfaces_have_holes(capture: Capture, scene: Mesh) -> None:
    surface = cKDTree(sample(scene, 400_000, np.random.default_rng(0)).xyz)
    flying = [(surface.query(points_of(frame)[::5])[0] > 0.05).mean() for frame in capture.frames]
    assert 0.0005 < np.mean(flying) < 0.05
    holes = [(frame.load_depth_m()[96:, 64:192] == 0).mean() for frame in capture.frames]
    assert 0.001 < np.mean(holes) < 0.2


@pytest.mark.slow
def test_photos_and_depth_show_the_same(capture: Capture) -> None:
    """The dress is dark and bluish, the floor is neither: in the photo and where the depth says the dress is."""
    frame = capture.frames[2]
    assert frame.load_rgb is not None
    depth_m = frame.load_depth_m()
    photo = np.asarray(Image.fromarray(frame.load_rgb()).resize((256, 192))).astype(int)
    xyz = points_of(frame)
    row, column = np.nonzero(depth_m)
    teal = photo[row, column, 2] > photo[row, column, 0] + 15
    assert teal[(xyz[:, 1] > 0.15) & (np.hypot(xyz[:, 0], xyz[:, 2]) < 0.35)].mean() > 0.6
    assert teal[xyz[:, 1] < 0.02].mean() < 0.1


@pytest.mark.slow
def test_poses_are_rotations_and_circle_the_dress(folder: Path) -> None:
    poses = np.array(
        [frame["transform_matrix"] for frame in json.loads((folder / "transforms.json").read_text())["frames"]]
    )
    turn = poses[:, :3, :3]
    assert np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(turn), 1)
    assert (turn[:, 1, 1] > 0.5).all()  # OpenGL: a camera's Y is up
    heading = np.sort(np.arctan2(poses[:, 0, 3], poses[:, 2, 3]))
    assert np.diff(heading).max() < 2 * np.pi / FRAMES + 0.2


@pytest.mark.slow
def test_the_zip_holds_exactly_the_folder(archive: Path, folder: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        assert sorted(opened.namelist()) == sorted(
            path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
        )


@pytest.mark.slow
def test_one_seed_gives_one_capture_and_another_gives_another(tmp_path: Path) -> None:
    small = surfaces.hemisphere()
    first, again, other = (
        simulate_capture(small, tmp_path / name, frames=1, seed=seed).read_bytes()
        for name, seed in (("a", 4), ("b", 4), ("c", 5))
    )
    assert first == again
    assert first != other


@pytest.mark.slow
def test_depth_is_sixteen_bit_millimetres(folder: Path) -> None:
    depth = np.asarray(Image.open(folder / "depth" / "0000.png"))
    assert depth.dtype == np.uint16
    assert 500 < np.median(depth[depth > 0]) < 4000


def test_the_dress_is_open_whole_and_of_a_person_s_size() -> None:
    dress = garment()
    edges = edges_of(dress.faces)
    assert (edges.size <= 2).all()
    assert component_count(edges.border_ends) >= 4  # neck, hem, two sleeves; seams on top
    assert 1.0 < np.ptp(dress.vertices[:, 1]) < 1.2
    assert dress.rgb is not None
    assert dress.vertices[:, 1].min() > 0.02  # nowhere does it touch the floor
