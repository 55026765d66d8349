"""Walks as people take them: they turn back, hold the phone upright and sideways, zoom, and edit some photos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.read_capture import read_capture
from tests.edge.cameras.test_structure_from_motion import centre_errors, centres
from tests.support.photos.walkaround import Shot, render_walkaround

pytestmark = pytest.mark.slow
SIZE = (640, 480)
SIDEWAYS, ZOOMED, TAGGED, EDITED = Shot(), Shot(zoom=2), Shot(upright="tag"), Shot(upright="pixels")


@pytest.mark.parametrize(
    ("walk", "cameras"),
    [
        pytest.param({"back": True}, 1, id="a walk that turns and goes back"),
        pytest.param({"shots": (SIDEWAYS, TAGGED, SIDEWAYS, EDITED)}, 2, id="held both ways"),
        pytest.param({"shots": (SIDEWAYS, SIDEWAYS, ZOOMED)}, 2, id="two focal lengths"),
        pytest.param({"shots": (SIDEWAYS, TAGGED, EDITED), "exif": False}, 2, id="files that tell no focal length"),
    ],
)
def test_all_photos_are_placed(tmp_path: Path, walk: dict[str, Any], cameras: int) -> None:
    taken = render_walkaround(tmp_path, views=16, arc=180.0, size=SIZE, **walk)
    photos = read_capture(tmp_path).photos
    assert len({photo.camera for photo in photos}) == cameras
    alignment = align(photos)
    assert len(alignment.views) == len(photos)
    assert centre_errors(centres(alignment), taken.camera_to_world[:, :3, 3]).max() < 0.01


def test_each_camera_gets_its_own_focal_length(tmp_path: Path) -> None:
    taken = render_walkaround(tmp_path, views=12, arc=120.0, size=SIZE, shots=(SIDEWAYS, ZOOMED))
    alignment = align(read_capture(tmp_path).photos)
    focal = np.array([view.intrinsics.fx for view in alignment.views]) / taken.intrinsics.fx
    assert len(focal) == 12
    assert focal[::2] == pytest.approx(1, rel=0.01)
    assert focal[1::2] == pytest.approx(2, rel=0.01)
