"""How a camera was held against gravity, as phones write it: by the photo's own upright picture it can be checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from capture2vr.edge.capture import photos
from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.gravity_tags import elevation_deg, up_in_camera
from tests.support.photos.maker_notes import apple_note

# What Core Motion calls gravity, in g along right, top and out of the screen; clockwise quarter turns; up in the
# camera's axes (x right, y down, z ahead) of the stored picture.
HELD = {
    "upright": ((0, -1, 0), 1, (-1, 0, 0)),
    "on its left side": ((-1, 0, 0), 0, (0, -1, 0)),
    "on its right side": ((1, 0, 0), 2, (0, 1, 0)),
    "upside down": ((0, 1, 0), 3, (1, 0, 0)),
    "upright, looking down by 30 degrees": ((0, -0.866, -0.5), 1, (-0.866, 0, -0.5)),
    "flat over a table": ((0, 0, -1), 1, (0, 0, -1)),
    "flat under a ceiling": ((0, 0, 1), 3, (0, 0, 1)),
}


@pytest.mark.parametrize("name", HELD)
def test_up_in_the_stored_picture(name: str) -> None:
    down, turns, up = HELD[name]
    assert up_in_camera({0x927C: apple_note(down)}, turns) == pytest.approx(up, abs=1e-3)


def test_pixels_that_were_rotated_later_are_not_believed() -> None:
    assert up_in_camera({0x927C: apple_note((0, -1, 0))}, 0) is None
    assert up_in_camera({0x927C: apple_note((0, -1, 0))}, 3) is None


@given(st.floats(-180, 180), st.floats(-89, 89), st.floats(-40, 40))
def test_every_way_to_hold_a_phone(heading: float, pitch: float, roll: float) -> None:
    """The phone turns in space, gravity is measured along its axes, and the camera's up turns back to the world's."""
    from scipy.spatial.transform import Rotation

    held = Rotation.from_euler("zxz", [roll, 90 + pitch, heading], degrees=True).as_matrix()
    down = held.T @ [0, 0, -1]  # held: columns are the phone's right, top and out axes in a world with z up
    up = up_in_camera({0x927C: apple_note(down.tolist())}, 1)
    assert up is not None
    right, top, out = held.T
    camera = np.stack([-top, -right, -out], axis=1)  # portrait: the stored picture lies on its side
    assert np.linalg.det(camera) == pytest.approx(1)
    assert camera @ np.array(up) == pytest.approx([0, 0, 1], abs=2e-3)


@pytest.mark.parametrize("value", [None, "high", 91.0, float("nan"), (1, 2), IFDRational(1, 0)])
def test_an_elevation_that_is_none(value: Any) -> None:
    assert elevation_deg({} if value is None else {0x9405: value}) is None


def test_a_photos_file_tells_both(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    camera = exif.get_ifd(0x8769)
    camera[0x927C], camera[0x9405] = apple_note((0, -0.866, -0.5)), IFDRational(-300, 10)
    Image.new("RGB", (64, 48)).save(tmp_path / "IMG_1.jpg", exif=exif)
    photo = photos.read_photo(Folder(tmp_path, ("IMG_1.jpg",)), "IMG_1.jpg")
    assert photo.up_in_camera == pytest.approx((-0.866, 0, -0.5), abs=1e-3)
    assert photo.elevation_deg == pytest.approx(-30)
    Image.new("RGB", (64, 48)).save(tmp_path / "IMG_2.jpg")
    plain = photos.read_photo(Folder(tmp_path, ("IMG_2.jpg",)), "IMG_2.jpg")
    assert (plain.up_in_camera, plain.elevation_deg) == (None, None)
