"""Pictures of 360 degrees are told from others, and split into views that show what is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.panorama import VIEWS
from capture2vr.edge.capture.photos import MAX_PHOTOS
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture

XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
WIDTH = 640


def sphere(width: int = WIDTH) -> Floats:
    """Unit vectors (h,w,3), in OpenCV axes, that the pixels of a panorama show."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = ((np.arange(width // 2) + 0.5) / (width // 2) - 0.5) * np.pi
    across, down = np.meshgrid(longitude, latitude)
    return np.stack([np.sin(across) * np.cos(down), np.sin(down), np.cos(across) * np.cos(down)], axis=-1)


def coloured(towards: Floats) -> Bytes:
    """A colour for each direction, which tells it."""
    return np.asarray(np.clip(127.5 + 120 * towards, 0, 255), np.uint8)


def save(folder: Path, count: int, rgb: Bytes, **settings: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    for number in range(count):
        Image.fromarray(rgb).save(folder / f"{number}.jpg", quality=98, **settings)
    return folder


def scene() -> Bytes:
    """A panorama with detail everywhere, as real ones have."""
    towards = sphere()
    detail = sum(
        np.sin(k * towards @ np.array([a, b, c])) for k, a, b, c in [(9, 1, 2, 0), (14, 0, 1, 2), (21, 2, 0, 1)]
    )
    return np.asarray(np.clip(127 + 40 * np.asarray(detail)[..., None] + 40 * towards, 0, 255), np.uint8)


def test_a_view_shows_what_lies_in_its_direction(tmp_path: Path) -> None:
    capture = read_capture(save(tmp_path / "a", 3, coloured(sphere()), xmp=XMP))
    assert len(capture.photos) == 3 * VIEWS
    assert "3 of 3 pictures of all 360 degrees" in " ".join(capture.warnings)
    for photo in capture.photos:
        turn = np.radians(float(photo.name.split("@")[1]))
        assert photo.size == (WIDTH // 4, WIDTH // 4)
        assert photo.focal_px == pytest.approx(WIDTH / 8)
        at = (np.arange(0, 160, 10) + 0.5 - 80) / (WIDTH / 8)
        x, y = np.meshgrid(at, at)
        towards = np.stack([x * np.cos(turn) + np.sin(turn), y, np.cos(turn) - x * np.sin(turn)], axis=-1)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        seen = photo.load()[::10, ::10].astype(int)
        assert np.abs(seen - coloured(towards)).max() <= 8
        assert photo.load(80).shape == (80, 80, 3)


def test_views_to_one_side_follow_each_other(tmp_path: Path) -> None:
    names = [each.name for each in read_capture(save(tmp_path / "a", 3, scene(), xmp=XMP)).photos]
    assert names[:4] == ["0.jpg@000", "1.jpg@000", "2.jpg@000", "0.jpg@045"]


def test_without_its_description_a_panorama_is_told_by_its_pixels(tmp_path: Path) -> None:
    assert len(read_capture(save(tmp_path / "a", 3, scene())).photos) == 3 * VIEWS


def rolled() -> Bytes:
    return np.roll(scene(), 90, axis=0)  # its poles are within it


def plain_ground() -> Bytes:
    """A thing in the middle of plain cloth: the first and the last column are alike, and all rows at the rim."""
    picture = np.full((WIDTH // 2, WIDTH, 3), 200, np.uint8)
    picture[100:220, 250:400] = scene()[100:220, 250:400]
    return picture


@pytest.mark.parametrize("picture", [rolled, plain_ground, lambda: scene()[:, : WIDTH // 2], lambda: scene()[20:]])
def test_other_pictures_stay_whole(picture: Callable[[], Bytes], tmp_path: Path) -> None:
    assert len(read_capture(save(tmp_path / "a", 3, picture())).photos) == 3


def test_gravity_is_known_where_the_camera_was_level(tmp_path: Path) -> None:
    level = read_capture(save(tmp_path / "a", 3, scene(), xmp=XMP)).photos[0]
    tilted = XMP.replace(b'"/>', b'" GPano:PosePitchDegrees="-12.5"/>')
    assert level.up_in_camera == (0, -1, 0)
    assert read_capture(save(tmp_path / "b", 3, scene(), xmp=tilted)).photos[0].up_in_camera is None
    even = XMP.replace(b'"/>', b'" GPano:PoseRollDegrees="0.0"/>')
    assert read_capture(save(tmp_path / "c", 3, scene(), xmp=even)).photos[0].up_in_camera == (0, -1, 0)


def test_one_panorama_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="one picture of all 360 degrees") as error:
        read_capture(save(tmp_path / "a", 1, scene(), xmp=XMP))
    assert error.value.code == "CAPTURE_LOW_OVERLAP"


def test_of_many_panoramas_as_many_are_used_as_photos_may_be(tmp_path: Path) -> None:
    capture = read_capture(save(tmp_path / "a", 50, scene()[:: WIDTH // 64, :: WIDTH // 64], xmp=XMP))
    assert len(capture.photos) == MAX_PHOTOS // VIEWS * VIEWS
    assert "37 of 50 pictures" in " ".join(capture.warnings)
