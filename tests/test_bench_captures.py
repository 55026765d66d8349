"""The bench of captures: cameras of other programs land where they should, and the table has what was measured."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, Photo
from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.silhouette import cast_pixels
from capture2vr.storage.bundle import Bundle
from tests.bench import captures
from tests.bench.borne_out import likeness_of_patches
from tests.bench.outlines import depths_under, votes_of_outlines
from tests.bench.photo_sets import (
    PhotoSet,
    above_the_ground,
    agreed_points,
    bundler_cameras,
    statue,
    statue_points,
    thinned,
    write_transforms,
)
from tests.bench.seam import seam_figures
from tests.conftest import data_folder
from tests.support import scenes, surfaces

SIZE = (96, 64)
LENS = (120.0, -0.13, 0.1)  # f, k1, k2
NAMES = ("b.jpg", "a.jpg", "c.jpg")


def bundler_camera(number: int) -> tuple[Floats, Floats]:
    """Rotation and translation of a camera that has the origin 4 units before it, along -z."""
    turn = cv2.Rodrigues(np.array([0.2, 0.5 * number, -0.1]))[0]
    return turn, np.array([0.1 * number, -0.2, -4.0])


def bundler_file() -> str:
    lines = ["# Bundle file v0.3", f"{len(NAMES)} 1"]
    for number in range(len(NAMES)):
        turn, shift = bundler_camera(number)
        lines += [" ".join(map(repr, row)) for row in np.array([LENS, *turn, shift]).tolist()]
    return "\n".join([*lines, "0 0 0", "255 0 0", "1 0 5 0.0 0.0", ""])


def bundler_pixel(xyz: Floats, number: int) -> Floats:
    """(N,2) pixels from the picture's upper left corner, by the formulas of Bundler's manual."""
    turn, shift = bundler_camera(number)
    camera = xyz @ turn.T + shift
    at = -camera[:, :2] / camera[:, 2:]
    focal, k1, k2 = LENS
    squared = np.square(at).sum(axis=1, keepdims=True)
    out = focal * (1 + k1 * squared + k2 * squared**2) * at
    return np.array(SIZE) / 2 + out * [1, -1]


# Cameras


def test_a_point_lands_in_the_pixel_where_bundler_has_it(tmp_path: Path) -> None:
    images, folder = tmp_path / "images", tmp_path / "capture"
    images.mkdir()
    folder.mkdir()
    for name in NAMES:
        Image.new("RGB", SIZE).save(images / name)
    lens, poses = bundler_cameras(bundler_file(), NAMES, SIZE)
    write_transforms(folder, images, lens, poses)
    xyz = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 3))
    photos = {photo.name: photo for photo in read_capture(folder).photos}
    assert set(photos) == set(NAMES)
    for number, name in enumerate(NAMES):
        photo = photos[name]
        assert photo.intrinsics is not None
        assert photo.camera_to_world is not None
        camera, to_camera = photo.intrinsics, np.linalg.inv(photo.camera_to_world)
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        turn, _ = cv2.Rodrigues(to_camera[:3, :3])
        pixel, _ = cv2.projectPoints(xyz, turn, to_camera[:3, 3], matrix, np.array(photo.distortion))
        # Pixel centres are at integers here, corners in Bundler's file.
        assert pixel[:, 0] + 0.5 == pytest.approx(bundler_pixel(xyz, number), abs=1e-6)


def test_cameras_of_several_lenses_or_without_names_are_refused() -> None:
    with pytest.raises(ValueError, match="2 names for 3 cameras"):
        bundler_cameras(bundler_file(), NAMES[:2], SIZE)
    other = bundler_file().replace(repr(LENS[0]), "130.0", 1)
    with pytest.raises(ValueError, match="one lens"):
        bundler_cameras(other, NAMES, SIZE)


def test_a_photo_is_known_by_its_file_and_a_film_by_its_time() -> None:
    known = PhotoSet(Path(), {"a.jpg": np.eye(4), "49": 2 * np.eye(4)})
    assert known.camera("a.jpg")[0, 0] == 1
    assert known.camera("walk.mp4 at 3.27 s")[0, 0] == 2  # 15 frames a second


# Points of depth maps


def depth_maps(frames: tuple[Frame, ...]) -> list[PosedPicture]:
    def posed(frame: Frame) -> PosedPicture:
        camera = frame.intrinsics
        focal = np.array([camera.fx / camera.width, camera.fy / camera.height])
        middle = np.array([(camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height])
        nothing: Any = None
        return PosedPicture(np.linalg.inv(frame.camera_to_world), focal, middle, nothing, frame.load_depth_m)

    return [posed(frame) for frame in frames]


@pytest.fixture(scope="module")
def table() -> list[PosedPicture]:
    """Depth maps of a sphere of radius .15 on a table."""
    frames = scenes.film(scenes.table_with_sphere(), scenes.orbit(14, radius=0.6, height=0.3))
    return depth_maps(frames)


def test_points_that_few_depth_maps_have_are_left_out(table: list[PosedPicture]) -> None:
    wrong = PosedPicture(
        table[0].to_camera, table[0].focal, table[0].middle, table[0].load_rgb, lambda: 0.8 * table[0].depth()
    )
    xyz = agreed_points([wrong, *table[1:]], least=2)
    off = np.minimum(np.abs(xyz[:, 2]), np.abs(np.linalg.norm(xyz - [0, 0, 0.15], axis=1) - 0.15))
    assert off.max() < 0.005
    assert len(xyz) > 50_000
    assert len(agreed_points([wrong, table[7]], least=1)) < 0.02 * len(xyz)


def test_the_thing_is_above_the_ground_and_near_the_middle(table: list[PosedPicture]) -> None:
    up = np.array([0.0, 0, 1])
    xyz = above_the_ground(agreed_points(table), np.array([0, 0, 0.1]), 0.4, up)
    assert np.linalg.norm(xyz - [0, 0, 0.15], axis=1) == pytest.approx(0.15, abs=0.005)
    assert 0.015 < xyz[:, 2].min() < 0.06, "lower down no camera sees the sphere"
    assert xyz[:, 2].max() == pytest.approx(0.3, abs=0.005)


def test_one_point_of_a_cell_remains() -> None:
    few = np.random.default_rng(0).uniform(size=(200, 3))
    many = np.concatenate([few, few.repeat(50, axis=0)])
    left = thinned(many)
    assert len(left) <= 200
    assert len(left) > 190
    assert (left[:, None] == few[None]).all(axis=2).any(axis=1).all()


@pytest.mark.slow
@pytest.mark.data
def test_the_statues_depth_maps_lie_on_the_points_of_its_cameras(data_dir: Path) -> None:
    """`cameras.out` has points too: another computation than the depth maps, in the same frame."""
    lines = (data_folder() / "photos_statue" / "cameras.out").read_text().splitlines()[2 + 5 * 32 :]
    sparse = np.array([line.split() for line in lines[::3]], float)
    dense = statue_points()
    low, high = dense.min(axis=0) + 0.02, dense.max(axis=0) - 0.02
    near = sparse[((sparse > low) & (sparse < high)).all(axis=1)]
    size = np.ptp(dense, axis=0).max()
    gap, _ = captures.cKDTree(dense).query(near)
    assert len(near) > 1_000
    assert (gap < 0.005 * size).mean() > 0.9
    assert len(statue().cameras) == 32


# Figures


def row_and_frames(mesh: Mesh) -> tuple[captures.Row, Bundle, list[Frame]]:
    """A mesh in the capture's frame, and points of the whole sphere in the frame of another program's cameras."""
    rng = np.random.default_rng(0)
    other = np.eye(4)  # from the capture's frame
    other[:3, :3], other[:3, 3] = 3.0 * cv2.Rodrigues(np.array([0.4, -1.1, 0.3]))[0], (5, -7, 2)
    nothing: Any = None
    cameras, frames = {}, []
    for number, eye in enumerate(rng.normal(size=(6, 3))):
        ours = scenes.look_at(2 * eye, (0, 0, 0))
        frames.append(Frame(f"{number}.jpg", nothing, ours, nothing))
        cameras[f"{number}.jpg"] = other @ ours
    points = surfaces.sampled(surfaces.sphere(), 5_000) @ other[:3, :3].T + other[:3, 3]
    capture = Capture("photos", "test", photos=(Photo("0.jpg", SIZE, "phone", nothing),))
    row = captures.Row(capture, known=PhotoSet(Path(), cameras), points=points)
    return row, Bundle("preview", {"mesh.ply": ply_bytes(mesh)}, {}), frames


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(captures, "_SAMPLES", 200_000)


@pytest.mark.usefixtures("few_samples")
def test_points_on_the_mesh_are_counted_in_whatever_frame_they_are() -> None:
    row, bundle, frames = row_and_frames(surfaces.sphere())
    shares = captures._shares_of_points(row, bundle, frames)
    titles = [f"reference within {each} %" for each in ("0.5", "1", "2")]
    assert list(shares) == [*titles, "borne out", "deeper, by outlines"]
    assert list(shares.values())[:3] == pytest.approx([100, 100, 100], abs=1)


@pytest.mark.usefixtures("few_samples")
def test_points_where_the_mesh_is_missing_are_not() -> None:
    whole = surfaces.sphere()
    upper = Mesh(whole.vertices, whole.faces[(whole.vertices[whole.faces, 2] > 0).all(axis=1)])
    row, bundle, frames = row_and_frames(upper)
    shares = captures._shares_of_points(row, bundle, frames)
    assert list(shares.values())[:3] == pytest.approx([51, 51.5, 53], abs=2)
    assert captures._shares_of_points(captures.Row(row.capture), bundle, frames) == dict.fromkeys(shares)


def print_from(eye: tuple[float, float, float]) -> PosedPicture:
    """A photo of a print of random blots on the plane z = 0."""
    pose = scenes.look_at(eye, (0, 0, 0))
    blots = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, (400, 400)).astype(np.float32), (0, 0), 6)
    x, y = (np.mgrid[:240, :240].reshape(2, -1)[::-1] - 119.5) / 200
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ pose[:3, :3].T
    at = pose[:2, 3] - rays[:, :2] * pose[2, 3] / rays[:, 2:]
    tone = 128 + 600 * blots[tuple(np.clip(((at + 1) * 200).astype(int), 0, 399).T)]
    rgb = np.repeat(np.clip(tone, 0, 255).astype(np.uint8).reshape(240, 240, 1), 3, axis=2)
    return PosedPicture(np.linalg.inv(pose), np.full(2, 200 / 240), np.full(2, 0.5), lambda: rgb)


def test_patches_of_the_true_surface_look_alike_in_all_photos() -> None:
    ground = Mesh(np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    photos = [print_from(eye) for eye in ((0.9, 0.1, 1.5), (-0.5, 0.8, 1.5), (-0.4, -0.9, 1.5))]
    places = np.column_stack([np.random.default_rng(1).uniform(-0.3, 0.3, (500, 2)), np.zeros(500)])
    up = np.broadcast_to([0.0, 0.0, 1.0], places.shape)
    scene = RaycastingScene(ground)
    assert np.median(likeness_of_patches(places, up, photos, scene)) > 0.9
    assert np.median(likeness_of_patches(places + 0.1 * up, up, photos, scene)) < 0.5
    assert np.isnan(likeness_of_patches(places, -up, photos, scene)).all()  # no photo sees the other side
    assert np.isnan(likeness_of_patches(places - 0.2 * up, up, photos, scene)).all()  # hidden by the surface


def ball(radius: float) -> Mesh:
    shape = trimesh.creation.icosphere(5, radius)
    return Mesh(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces, np.int64))


def photo_of_a_red_ball(eye: tuple[float, float, float]) -> PosedPicture:
    """A photo of a red ball of radius 0.5 before grey."""
    pose, focal = scenes.look_at(eye, (0, 0, 0)), 1.2
    scene = RaycastingScene(ball(0.5))
    photo = PosedPicture(np.linalg.inv(pose), np.full(2, focal), np.full(2, 0.5), lambda: rgb)
    found = cast_pixels(photo, scene, 300, 300)[0].face >= 0
    rgb = np.where(found[:, None], [180, 30, 30], [128, 128, 120]).astype(np.uint8).reshape(300, 300, 3)
    return photo


def test_outlines_tell_which_of_two_surfaces_is_the_object_s() -> None:
    photos = [photo_of_a_red_ball(eye) for eye in ((2, 0, 0.5), (-1, 1.7, 0.5), (0.2, 0, 2))]
    true, larger = ball(0.5), ball(0.53)
    smaller = surfaces.sampled(ball(0.47), 80_000)
    outwards = smaller / np.linalg.norm(smaller, axis=1, keepdims=True)
    depth = depths_under(true, smaller, outwards, 1.0)
    np.testing.assert_allclose(depth, 0.03, atol=0.002)
    ours, background = votes_of_outlines(true, depth, photos)
    assert background < 0.05 * ours
    ours, background = votes_of_outlines(larger, depth, photos)
    assert ours < 0.05 * background


def test_a_true_outline_is_that_of_the_camera() -> None:
    camera = Intrinsics(100.0, 100.0, 59.5, 39.5, 120, 80)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    known = PhotoSet(Path(), {"a.jpg": scenes.look_at((3, 0, 0), (0, 0, 0))}, ball, camera)
    nothing: Any = None
    photo = PosedPicture(nothing, nothing, nothing, nothing, name="a.jpg")
    mask = captures._Outline(known)(photo)
    assert mask.shape == (320, 480)
    radius = 100 * 4 * np.tan(np.arcsin(0.5 / 3))  # in pixels of the mask, which is four times as large
    assert mask.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    row, column = np.nonzero(mask)
    assert (column.mean(), row.mean()) == pytest.approx((239.5, 159.5), abs=0.2)


# The table


FIGURES = {"placed": "20 of 20", "triangles": 123_456, "lace %": 1.25, "psnr": None}


def test_words_choose_rows_and_the_table_has_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(names: list[str], out: Path | None, *, module: str) -> Iterator[tuple[str, dict[str, Any]]]:
        for name in names:
            assert (out, module) == (tmp_path, "tests.bench.captures")
            folder = tmp_path / captures.slug(name)
            folder.mkdir()
            (folder / "photo-1.jpg").write_bytes(b"jpeg")
            yield name, FIGURES

    monkeypatch.setattr(captures, "_measured", measured)
    captures.main(["statue", "given", "--out", str(tmp_path)])
    captures.main(["ToF", "--out", str(tmp_path)])
    assert capsys.readouterr().out.splitlines() == [
        "| capture | placed | triangles | lace % | psnr |",
        "|---|---|---|---|---|",
        "| statue, cameras given | 20 of 20 | 123,456 | 1.25 |  |",
        "| capture | placed | triangles | lace % | psnr |",
        "|---|---|---|---|---|",
        "| ToF still (own view) | 20 of 20 | 123,456 | 1.25 |  |",
    ]
    page = (tmp_path / "index.html").read_text()
    assert '<img src="tof-still-own-view/photo-1.jpg" alt="photo-1">' in page
    assert "<td>triangles<td>123,456" in page


def test_a_row_that_fails_is_named_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(command: list[str], **_: object) -> Any:
        failed = command[-2] == "a"
        done = captures.subprocess.CompletedProcess[str](command, int(failed))
        done.stdout, done.stderr = f"read\n{json.dumps(FIGURES)}\n", "Traceback\nCaptureError: too few\n"
        return done

    monkeypatch.setattr(captures.subprocess, "run", run)
    assert list(captures._measured(["a", "b"], None)) == [("b", FIGURES)]
    assert capsys.readouterr().err == "a: CaptureError: too few\n"


def test_each_row_has_a_folder_of_its_own() -> None:
    assert len({captures.slug(name) for name in captures.ROWS}) == len(captures.ROWS)


def test_a_seam_is_what_bends_more_where_measured_and_filled_surface_meet() -> None:
    ball = trimesh.creation.icosphere(4, 1.0)
    filled = ball.vertices[:, 2] < 0
    even = seam_figures(Mesh(ball.vertices, ball.faces), filled)
    ring = 1 + 0.02 * np.random.default_rng(0).normal(size=len(filled)) * (np.abs(ball.vertices[:, 2]) < 0.1)
    torn = seam_figures(Mesh(ball.vertices * ring[:, None], ball.faces), filled)
    assert even["seam °"] == pytest.approx(even["skin °"], rel=0.1)
    assert torn["skin °"] == even["skin °"]
    assert torn["seam °"] is not None
    assert torn["seam °"] > 2 * torn["skin °"]  # type: ignore[operator]
    assert seam_figures(Mesh(ball.vertices, ball.faces), filled & False)["seam °"] is None
