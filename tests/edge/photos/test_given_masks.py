"""Photos with masks, from the files to depth: nothing that a mask hides becomes surface."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from tests.support import captures
from tests.support.photos.walkaround import Walkaround, render_walkaround

pytestmark = pytest.mark.slow


def thing_seen(walk: Walkaround, pose: np.ndarray) -> np.ndarray:
    """(H,W) bool: whether a photo's pixel shows the shell."""
    camera = walk.intrinsics
    x, y = (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    along = RaycastingScene(walk.thing).cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T)).along
    return np.isfinite(along).reshape(camera.height, camera.width)


def test_what_masks_hide_has_no_depth_and_what_they_show_has_it_as_before(tmp_path: Path) -> None:
    """The file has the paths of another machine, as Nerfstudio writes them."""
    walk = render_walkaround(tmp_path / "images", views=10, arc=120, size=(480, 360))
    camera = walk.intrinsics
    for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True):
        captures.save_png(tmp_path / "masks" / f"{photo.name}.png", np.uint8(255 * thing_seen(walk, pose)))
    frames = [
        {"file_path": f"/home/ada/shell/images/{photo.stem}.png", "transform_matrix": (pose @ captures.FLIP).tolist()}
        for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True)
    ]
    size = {"w": camera.width, "h": camera.height}
    lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5, "cy": camera.cy + 0.5}
    (tmp_path / "transforms.json").write_text(json.dumps(size | lens | {"frames": frames}))
    capture = read_capture(tmp_path)
    assert (len(capture.photos), capture.warnings) == (10, ())
    truth, _ = trimesh.sample.sample_surface(trimesh.Trimesh(walk.thing.vertices, walk.thing.faces), 60_000, seed=0)
    covered = []
    for frame in to_depth(capture).frames:
        assert frame.load_mask is not None
        assert (frame.load_mask() == thing_seen(walk, frame.camera_to_world)).mean() > 0.99
        depth = frame.load_depth_m()
        away, _ = cKDTree(truth).query(captures.back_project(frame))
        assert np.quantile(away, 0.95) < 0.01
        covered.append((depth > 0).sum() / thing_seen(walk, frame.camera_to_world).sum())
    assert np.median(covered) > 0.6
