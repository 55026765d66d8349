"""Rendered photos show their shapes where the cameras say; openings, thin parts and depth are measured right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.rays import RaycastingScene
from tests.bench import rendered_figures
from tests.bench.photo_sets import rendered
from tests.bench.rendered_figures import Comparison, depth_by_luma, is_visible, to_truth, true_depth
from tests.support import scenes
from tests.support.photos.rendered import photos, shapes, stage
from tests.support.photos.rendered.photos import RenderedPhotos, Subject
from tests.support.photos.rendered.shapes import Shape
from tests.support.photos.rendered.stage import Material, Stage
from tests.support.surfaces import grid

CAMERA = Intrinsics(240.0, 240.0, 159.5, 119.5, 320, 240)
BLACK, BRIGHT = Material((0.0,) * 3, (0.0,) * 3), Material((0.8,) * 3, (0.8,) * 3)
PLACE = np.array([0.06, -0.04, 0.05])  # of the small ball's middle


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage, "_VOXELS", 24)
    monkeypatch.setattr(stage, "_SKY_RAYS", 2)
    monkeypatch.setattr(rendered_figures, "_SAMPLES", 60_000)
    monkeypatch.setattr(rendered_figures, "_TRUE_SAMPLES", 60_000)
    monkeypatch.setattr(rendered_figures, "_OPENING_SAMPLES", 5_000)
    monkeypatch.setattr(rendered_figures, "_SEEN_SAMPLES", 5_000)


def ball(radius: float, middle: Floats) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(np.asarray(made.vertices) + middle, np.asarray(made.faces))


def bright_place(picture: Floats) -> Floats:
    """(2,) column and row of the middle of what is bright."""
    row, column = np.nonzero(picture > picture.max() / 8)
    return np.array([column.mean(), row.mean()])


def projected(xyz: Floats, pose: Floats, camera: Intrinsics) -> Floats:
    x, y, z = np.linalg.inv(pose)[:3] @ [*xyz, 1]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


# Photos


def test_the_product_reads_cameras_that_show_the_shape_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = Subject(lambda: Shape(ball(0.008, PLACE)), BRIGHT, BLACK, room=0.0)
    monkeypatch.setattr(photos, "SUBJECTS", {"ball": subject})
    monkeypatch.setattr(photos, "_RINGS", ((2, 30.0), (1, 60.0)))
    monkeypatch.setattr(photos, "CAMERA", CAMERA)
    known, made = rendered("ball", tmp_path)
    assert known.truth is not None
    again, _ = rendered("ball", tmp_path, render=False)
    capture = read_capture(tmp_path)
    assert len(capture.photos) == 3
    for photo in capture.photos:
        assert photo.camera_to_world is not None
        assert photo.intrinsics is not None
        assert photo.camera_to_world == pytest.approx(made.cameras[photo.name], abs=1e-9)
        assert again.cameras[photo.name] == pytest.approx(made.cameras[photo.name], abs=0)
        grey = np.asarray(Image.open(tmp_path / photo.name).convert("L"), np.float64)
        assert bright_place(grey) == pytest.approx(projected(PLACE, photo.camera_to_world, photo.intrinsics), abs=0.4)


def test_a_mirror_shows_the_ball_below_itself() -> None:
    side = np.linspace(-0.4, 0.4, 9)
    x, y = np.meshgrid(side, side, indexing="ij")
    mirror = grid(np.stack([x, y, 0 * x], axis=-1))
    light = Stage([(ball(0.008, PLACE), BRIGHT), (mirror, Material((0.0,) * 3, (0.0,) * 3, mirrored=1.0))], bright=0.0)
    pose = scenes.look_at((0.5, 0.3, 0.3), PLACE.tolist())
    picture = light.picture(pose, CAMERA)[..., 1]
    row, column = np.round(projected(PLACE * [1, 1, -1], pose, CAMERA)).astype(int)[::-1]
    assert picture[row, column] > 0.1
    assert np.median(picture) == 0


def test_glass_bends_by_snells_law() -> None:
    down, up = np.array([[0.6, 0.0, -0.8]]), np.array([[0.0, 0.0, 1.0]])
    inside = stage._refract(down, up, 1 / 1.5)
    assert inside[0] == pytest.approx([0.4, 0, -np.sqrt(1 - 0.16)])
    assert stage._refract(inside, up, 1.5) == pytest.approx(down)
    flat = np.array([[0.8, 0.0, -0.6]])  # from glass no light gets out so flat
    assert stage._refract(flat, up, 1.5) == pytest.approx(np.array([[0.8, 0, 0.6]]))


def test_dark_places_are_noisier_for_their_light() -> None:
    rng = np.random.default_rng(0)
    light = np.repeat(np.array([0.005, 0.5], np.float32), 40_000).reshape(2, 200, 200, 1) * np.ones(3, np.float32)
    dark, bright = (photos._developed(each, rng).astype(float) for each in light)
    assert bright.mean() > 180
    assert dark.mean() < 20
    assert dark.std() / dark.mean() > 5 * bright.std() / bright.mean()


@pytest.mark.slow
@pytest.mark.parametrize("make", [shapes.basket, shapes.cup, shapes.shoe, shapes.dress])
def test_a_shape_stands_on_the_table_and_closes_none_of_its_openings(make: Callable[[], Shape]) -> None:
    shape = make()
    low, high = shape.mesh.vertices.min(axis=0), shape.mesh.vertices.max(axis=0)
    assert (high - low).max() == pytest.approx(shapes.SIZE_M)
    assert low[2] >= 0
    found = Comparison(shape.mesh, RenderedPhotos({}, CAMERA, shape)).openings()
    assert found["closed openings %"] == pytest.approx(0, abs=1)
    assert found["mesh over openings %"] == pytest.approx(0, abs=0.3)


@pytest.mark.parametrize("make", [shapes.head, shapes.rounded_box, shapes.bottle, shapes.apple])
def test_a_closed_shape_is_whole_and_has_its_front_outside(make: Callable[[], Shape]) -> None:
    made = make().mesh
    for body in trimesh.Trimesh(made.vertices, made.faces, process=False).split(only_watertight=False):
        assert body.is_watertight
        assert body.volume > 0


# Figures


def around(mesh: Mesh) -> dict[str, Floats]:
    middle = mesh.vertices.mean(axis=0)
    poses = scenes.orbit(6, radius=0.8, height=0.5, target=middle.tolist())
    return {f"{number}.jpg": pose for number, pose in enumerate(poses)}


def tub() -> tuple[Mesh, Mesh]:
    """A tube of radius .1 and height .3 with a bottom, and the disk that would close its top."""
    turn = np.linspace(0, 2 * np.pi, 121)
    ring = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), 0 * turn], axis=-1)
    wall = grid(np.linspace(0, 1, 31)[:, None, None] * [0, 0, 0.3] + ring)
    disk = grid(np.linspace(0, 1, 11)[:, None, None] * ring)
    return concatenate([wall, disk]), Mesh(np.add(disk.vertices, (0, 0, 0.3)), disk.faces)


def test_a_filled_opening_is_seen_and_an_open_one_is_not() -> None:
    open_tub, lid = tub()
    known = RenderedPhotos(around(open_tub), CAMERA, Shape(open_tub, lid))
    as_it_is = Comparison(open_tub, known).openings()
    assert as_it_is == {
        "closed openings %": pytest.approx(0, abs=0.5),
        "mesh over openings %": pytest.approx(0, abs=0.2),
        "filled over openings %": 0.0,
    }
    domed = Mesh(
        lid.vertices + [0, 0, 0.03] * (1 - np.square(lid.vertices[:, :2]).sum(axis=1) / 0.01)[:, None], lid.faces
    )
    for cover, closed in ((lid, 100), (domed, 100), (half_of(lid), 50)):
        whole = concatenate([open_tub, cover])
        made_up = np.arange(len(whole.vertices)) >= len(open_tub.vertices)
        filled = Comparison(whole, known, made_up).openings()
        assert filled["filled over openings %"] == pytest.approx(filled["mesh over openings %"], abs=0.5)
        assert filled["closed openings %"] == pytest.approx(closed, abs=2.5)
        area = 0.01 * np.pi * closed / 100  # of the lid, beside wall and bottom
        assert filled["mesh over openings %"] == pytest.approx(100 * area / (area + 0.07 * np.pi), abs=1.5)


def half_of(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[(mesh.vertices[mesh.faces, 0] >= -1e-9).all(axis=1)])


def test_what_is_missing_and_what_is_wrong_are_counted_where_photos_see() -> None:
    whole = ball(0.15, np.array([0, 0, 0.15]))
    known = RenderedPhotos(around(whole), CAMERA, Shape(whole))
    same = Comparison(whole, known).surface()
    assert same == {"accurate %": pytest.approx(100, abs=0.6), "complete %": pytest.approx(100, abs=0.6)}
    assert Comparison(half_of(whole), known).surface()["complete %"] == pytest.approx(50, abs=3)
    high = Mesh(whole.vertices, whole.faces[(whole.vertices[whole.faces, 2] > 0.03).all(axis=1)])
    assert Comparison(high, known).surface()["complete %"] == pytest.approx(100, abs=0.6), "no photo sees below"
    doubled = concatenate([whole, Mesh(np.add(whole.vertices, (1.0, 0, 0)), whole.faces)])
    assert Comparison(doubled, known).surface()["accurate %"] == pytest.approx(50, abs=0.5)
    assert set(Comparison(whole, known).openings().values()) == {None}


def test_only_the_front_of_a_ball_is_visible_and_only_in_the_picture() -> None:
    whole = ball(0.15, np.zeros(3))
    scene, pose = RaycastingScene(whole), scenes.look_at((3.0, 0, 0), (0, 0, 0))
    visible = is_visible(scene, pose, CAMERA, whole.vertices)
    assert visible[whole.vertices[:, 0] > 0.02].all()
    assert not visible[whole.vertices[:, 0] < 0.0].any()
    aside = scenes.look_at((3.0, 0, 0), (3.0, 3.0, 0))
    assert not is_visible(scene, aside, CAMERA, whole.vertices).any()


def rod(radius: float, high: float) -> Mesh:
    made = trimesh.creation.cylinder(radius, high, sections=24)
    return Mesh(np.add(made.vertices, (0, 0, high / 2)), np.asarray(made.faces))


@pytest.mark.slow
def test_thin_parts_have_a_length_a_width_and_webs() -> None:
    axis = np.column_stack([np.zeros((600, 2)), np.linspace(0.002, 0.298, 600), np.full(600, 0.002)])
    known = RenderedPhotos({}, CAMERA, Shape(rod(0.002, 0.3), axes=(axis,)))

    def measured(mesh: Mesh) -> dict[str, float | None]:
        return Comparison(mesh, known).thin_parts()

    assert measured(rod(0.002, 0.3)) == {"webs %": 0, "length %": 100, "width": pytest.approx(1, abs=0.02)}
    assert measured(rod(0.0035, 0.15)) == {
        "webs %": 0,
        "length %": pytest.approx(50, abs=1.5),
        "width": pytest.approx(1.75, abs=0.05),
    }
    web = grid(np.array([[[0, 0, 0.1], [0.1, 0, 0.1]], [[0, 0, 0.2], [0.1, 0, 0.2]]], float))
    share = 0.01 / (0.01 + 2 * np.pi * 0.002 * 0.3)
    assert measured(concatenate([rod(0.002, 0.3), web]))["webs %"] == pytest.approx(100 * 0.9 * share, abs=1.5)
    assert measured(ball(0.1, np.array([1.0, 0, 0]))) == {"webs %": 100, "length %": 0, "width": None}


def test_depth_is_counted_by_luma() -> None:
    whole = ball(0.15, np.zeros(3))
    poses = scenes.orbit(4, radius=0.9, height=0.2, target=(0, 0, 0))
    known = RenderedPhotos({f"{number}.jpg": pose for number, pose in enumerate(poses)}, CAMERA, Shape(whole))
    scene = RaycastingScene(whole)
    nothing: Any = None
    turn = cv2.Rodrigues(np.array([0.2, 0.9, -0.4]))[0]
    other = np.eye(4)  # the capture's frame is turned, twice as large, and elsewhere
    other[:3, :3], other[:3, 3] = turn, (3, 2, 1)
    frames = []
    for name, pose in known.cameras.items():
        true = true_depth(scene, known, Frame(name, CAMERA, pose, nothing))
        depth = 2 * np.where(np.isfinite(true), true, 0).astype(np.float32)
        depth[:120] *= 1.1  # wrong above
        depth[:, :160] = 0  # none on the left
        rgb = np.full((*depth.shape, 3), 10, np.uint8)
        rgb[:120] = 70
        ours = other @ np.block([[pose[:3, :3], 2 * pose[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]])
        frames.append(frame(name, ours, depth, rgb))
    laid = to_truth(known, frames)
    assert laid[:3, :3] == pytest.approx(turn.T / 2)
    found = depth_by_luma(known, frames, laid)
    assert list(found) == ["luma 0 to 20", "luma 20 to 40", "luma 40 to 60", "luma 60 to 90", "luma over 90"]
    assert found["luma 20 to 40"] is None
    assert [float(each) for each in (found["luma 0 to 20"] or "").split(",")] == pytest.approx([50, 0], abs=2)
    assert [float(each) for each in (found["luma 60 to 90"] or "").split(",")] == pytest.approx([50, 100], abs=2)


def frame(name: str, pose: Floats, depth: Floats, rgb: Any) -> Frame:
    return Frame(name, CAMERA, pose, lambda: depth, load_rgb=lambda: rgb)
