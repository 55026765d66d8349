"""Pictures of 360 degrees are told from others, and split into views that show what is there."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.panorama import ALL_SIDES, VIEWS, views_of
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
    assert "3 of 3 panoramas" in " ".join(capture.warnings)
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


@pytest.mark.parametrize(("told", "views"), [(3, 5 * VIEWS), (2, 2 * VIEWS + 3)])
def test_where_most_of_one_size_are_panoramas_all_are(told: int, views: int, tmp_path: Path) -> None:
    """Of a plain wall the pixels tell too little. Pictures of another size are others."""
    folder = save(tmp_path / "a", told, scene())
    for number in range(told, 5):
        Image.fromarray(plain_ground()).save(folder / f"{number}.jpg")
    Image.fromarray(plain_ground()[::2, ::2]).save(folder / "small.jpg")
    assert len(read_capture(folder).photos) == views + 1


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


def part(folder: Path, left: int, top: int, width: int, height: int, *, count: int = 3, shrink: int = 1) -> Path:
    """Cut panoramas with XMP that says from where, in smaller copies."""
    facts = {
        "FullPanoWidthPixels": WIDTH,
        "FullPanoHeightPixels": WIDTH // 2,
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "CroppedAreaLeftPixels": left,
        "CroppedAreaTopPixels": top,
    }
    xmp = XMP.replace(b"/>", "".join(f' GPano:{name}="{value}"' for name, value in facts.items()).encode() + b"/>")
    rgb = coloured(sphere())[top : top + height, left : left + width]
    return save(folder, count, np.asarray(Image.fromarray(rgb).reduce(shrink)), xmp=xmp)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 200), st.integers(20, 110), st.integers(100, 440), st.integers(60, 100), st.sampled_from([1, 2]))
def test_a_part_of_a_panorama_is_split_within_what_it_shows(
    left: int, top: int, width: int, below: int, shrink: int
) -> None:
    height = 160 + below - top
    with tempfile.TemporaryDirectory() as folder:
        capture = read_capture(part(Path(folder) / "a", left, top, width, height, shrink=shrink))
        photo = capture.photos[-1]
        assert photo.focal_px == pytest.approx(WIDTH / 8 / shrink, rel=0.03)
        turn = np.radians((left + width / 2) / WIDTH * 360 - 180 if len(capture.photos) == 3 else _turn(photo.name))
        at = [(np.arange(0, side, 7) + 0.5 - side / 2) / photo.focal_px for side in photo.size]
        x, y = np.meshgrid(*at)
        towards = np.stack([x * np.cos(turn) + np.sin(turn), y, np.cos(turn) - x * np.sin(turn)], axis=-1)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        assert np.abs(photo.load()[::7, ::7].astype(int) - coloured(towards)).max() <= 14
        assert np.arctan(photo.size[0] / 2 / photo.focal_px) * 2 <= np.radians(min(90, width / WIDTH * 360)) + 0.05


def _turn(name: str) -> float:
    return float(name.split("@")[1])


def test_a_low_part_of_a_panorama_stays_a_photo(tmp_path: Path) -> None:
    assert len(read_capture(part(tmp_path / "a", 100, 150, 300, 40)).photos) == 3


def test_one_part_of_a_panorama_is_refused_by_its_angle(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="one panorama of 180 degrees"):
        read_capture(part(tmp_path / "a", 160, 80, 320, 160, count=1))


def test_an_angle_of_many_noughts_costs_no_more_than_its_length(tmp_path: Path) -> None:
    photo = read_capture(save(tmp_path / "a", 3, scene(), xmp=XMP)).photos[0]
    for angle in (b"0" * 200_000, b"0." + b"0" * 200_000):
        for digit, up in ((b"", (0, -1, 0)), (b"1", None)):
            (tmp_path / "b.jpg").write_bytes(XMP.replace(b'"/>', b'" GPano:PosePitchDegrees="' + angle + digit))
            assert views_of(tmp_path / "b.jpg", photo, ALL_SIDES)[0].up_in_camera == up


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
    assert "37 of 50 panoramas" in " ".join(capture.warnings)
