"""Photos of two objects on a table: a rectangle in one of them gives its object alone, with masks in all photos."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Capture, Cloud, PhotoVerdict
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.marking.isolate_marked import what_to_keep, with_marked_photo
from capture2vr.edge.marking.marked_object import Mark
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from capture2vr.order.photo_box import PhotoBox
from tests.support import captures
from tests.support.photos.walkaround import Walkaround, render_walkaround

MARKED = 3  # of the photos


def depth_of(mesh: Mesh, walk: Walkaround, pose: Floats) -> Floats:
    """(H,W) depth of a mesh in a photo, infinite beside it."""
    camera = walk.intrinsics
    x, y = (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    along = RaycastingScene(mesh).cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T)).along
    return along.reshape(camera.height, camera.width)


def shown(walk: Walkaround, pose: Floats) -> Bools:
    """(H,W) which pixels show the neighbour, which the shell hides in parts."""
    assert walk.neighbour is not None
    depth = depth_of(walk.neighbour, walk, pose)
    return np.isfinite(depth) & (depth < depth_of(walk.thing, walk, pose))


def surface(mesh: Mesh) -> Floats:
    return trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces), 40_000, seed=0)[0]


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walkaround:
    return render_walkaround(tmp_path_factory.mktemp("walk") / "images", views=16, size=(480, 360), neighbour=True)


@pytest.fixture(scope="module")
def capture(walk: Walkaround) -> Capture:
    camera, folder = walk.intrinsics, walk.photos[0].parent.parent
    frames = [
        {"file_path": f"images/{photo.name}", "transform_matrix": (pose @ captures.FLIP).tolist()}
        for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True)
    ]
    size = {"w": camera.width, "h": camera.height}
    lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5, "cy": camera.cy + 0.5}
    (folder / "transforms.json").write_text(json.dumps(size | lens | {"frames": frames}))
    return to_depth(read_capture(folder))


@pytest.fixture(scope="module")
def around(walk: Walkaround) -> PhotoBox:
    """The rectangle around the neighbour in the photo that it is marked in."""
    mask = shown(walk, walk.camera_to_world[MARKED])
    rows, columns = np.flatnonzero(mask.any(axis=1)) / len(mask), np.flatnonzero(mask.any(axis=0)) / mask.shape[1]
    return PhotoBox(columns[0], rows[0], columns[-1], rows[-1], f"images/{walk.photos[MARKED].name}")


@pytest.fixture(scope="module")
def points(capture: Capture, around: PhotoBox) -> Points:
    return to_points(capture, box=around.grown(0.1), fill="unseen")


@pytest.mark.slow
def test_the_object_in_the_rectangle_is_kept_whole_and_the_one_in_the_middle_goes(
    walk: Walkaround, points: Points
) -> None:
    assert walk.neighbour is not None
    mine, other = surface(walk.neighbour), surface(walk.thing)
    away, _ = cKDTree(mine).query(points.xyz[points.given])
    assert np.quantile(away, 0.5) < 0.003
    assert np.quantile(away, 0.99) < 0.015
    assert (cKDTree(other).query(points.xyz)[0] > 0.02).all()
    over = mine[mine[:, 2] > 0.02]
    assert (cKDTree(points.xyz).query(over)[0] < 0.01).mean() > 0.95
    assert points.cut is not None
    assert (points.cut.kept, points.cut.doubt) == ("object", "")


@pytest.mark.slow
def test_every_photo_has_a_mask_of_the_object_in_the_rectangle(walk: Walkaround, points: Points) -> None:
    overlaps = []
    for view in (*points.texture_views, *points.held_out_views):
        truth = shown(walk, view.camera_to_world)
        if truth.mean() < 0.005:
            continue
        assert view.load_mask is not None
        mask = view.load_mask()
        assert mask.shape == truth.shape
        overlaps.append((mask & truth).sum() / (mask | truth).sum())
    assert len(overlaps) > 10
    assert np.median(overlaps) > 0.9
    assert min(overlaps) > 0.75


@pytest.mark.slow
def test_a_tap_marks_the_rectangle_around_what_it_is_on(capture: Capture, around: PhotoBox) -> None:
    x, y = (around.left + around.right) / 2, (around.top + around.bottom) / 2

    mark = what_to_keep(capture, "auto", PhotoBox.of([x, y, around.photo]))

    assert isinstance(mark, Mark)
    assert mark.box.photo == around.photo
    assert np.allclose(mark.box.values, around.values, atol=0.04)


def test_a_rectangle_is_drawn_in_a_photo_of_the_capture(tmp_path: Path) -> None:
    for name in ("a.png", "b.png", "c.png"):
        captures.save_png(tmp_path / name, np.full((40, 60, 3), 90, np.uint8))
    photos, box = read_capture(tmp_path), PhotoBox(0.1, 0.1, 0.9, 0.9)
    assert with_marked_photo(photos, None) is None
    assert with_marked_photo(photos, box) == replace(box, photo="a.png")
    assert with_marked_photo(photos, replace(box, photo="c.png")) == replace(box, photo="c.png")
    with pytest.raises(CaptureError, match=r"'d\.png'.*a\.png, b\.png, c\.png") as caught:
        with_marked_photo(photos, replace(box, photo="d.png"))
    assert caught.value.code == "BOX_UNKNOWN_PHOTO"
    assert with_marked_photo(photos, replace(box, photo="walk/c.png")) == replace(box, photo="c.png")
    with pytest.raises(CaptureError, match=r"no photo \(ply\)") as caught:
        with_marked_photo(Capture("points", "ply", Cloud(np.zeros((100, 3)))), box)
    assert caught.value.code == "BOX_NOT_APPLICABLE"


def test_a_marked_photo_that_was_not_used_is_named_with_its_advice() -> None:
    verdict = PhotoVerdict("b.jpg", "blur", "Hold the phone still.")
    unused = Capture("rgbd", "photos", verdicts=(PhotoVerdict("a.jpg", "ok"), verdict))
    with pytest.raises(CaptureError, match=r"b\.jpg: could not be used") as caught:
        what_to_keep(unused, "auto", PhotoBox(0.1, 0.1, 0.9, 0.9, "b.jpg"))
    assert caught.value.code == "BOX_PHOTO_UNUSED"
    assert "Hold the phone still." in caught.value.hints
