"""Smaller copies of photos are left out, and photos of other cameras, which have the same names, are not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.read_capture import read_capture


def picture(seed: int, width: int = 320, height: int = 240) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    large = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    return cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA)


def write(path: Path, pixels: np.ndarray, **exif: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    tags = Image.Exif()
    if exif:
        tags[0x0112] = exif["orientation"]
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, exif=tags)


def read(folder: Path) -> tuple[list[str], tuple[str, ...]]:
    capture = read_capture(folder)
    assert capture.kind == "photos"
    return [photo.name for photo in capture.photos], capture.warnings


@pytest.mark.parametrize("small", ["images_2", "thumbs", "a"])
def test_a_folder_of_smaller_copies_is_left_out(tmp_path: Path, small: str) -> None:
    for index in range(5):
        write(tmp_path / "images" / f"IMG_{index}.jpg", picture(index))
        write(tmp_path / small / f"IMG_{index}.jpg", picture(index, 160, 120))
    names, warnings = read(tmp_path)
    assert names == [f"images/IMG_{index}.jpg" for index in range(5)]
    (warning,) = warnings
    assert "left out: 5" in warning
    assert f"{small}/IMG_0.jpg of images/IMG_0.jpg" in warning


def test_of_several_sizes_the_largest_stays(tmp_path: Path) -> None:
    for index in range(4):
        for by, place in ((4, "images_4"), (2, "images_2"), (1, "images"), (8, "images_8")):
            write(tmp_path / place / f"{index}.png", picture(index, 640 // by, 480 // by))
    names, _ = read(tmp_path)
    assert names == [f"images/{index}.png" for index in range(4)]


def test_another_format_of_a_photo_beside_it_is_left_out(tmp_path: Path) -> None:
    for index in range(3):
        write(tmp_path / f"IMG_{index}.png", picture(index))
        write(tmp_path / f"IMG_{index}.jpg", picture(index, 160, 120))
    assert read(tmp_path)[0] == [f"IMG_{index}.png" for index in range(3)]


def test_a_copy_that_was_turned_upright_is_one(tmp_path: Path) -> None:
    for index in range(3):
        write(tmp_path / "full" / f"{index}.jpg", picture(index), orientation=6)
        write(tmp_path / "small" / f"{index}.jpg", np.rot90(picture(index, 160, 120), -1))
    assert read(tmp_path)[0] == [f"full/{index}.jpg" for index in range(3)]


def test_what_has_no_copy_stays(tmp_path: Path) -> None:
    for index in range(4):
        write(tmp_path / "full" / f"{index}.jpg", picture(index))
    for index in (1, 2, 3, 7):
        write(tmp_path / "small" / f"{index}.jpg", picture(index, 160, 120))
    names, warnings = read(tmp_path)
    assert names == [*(f"full/{index}.jpg" for index in range(4)), "small/7.jpg"]
    assert "left out: 3" in warnings[0]


@pytest.mark.parametrize("size", [(320, 240), (160, 120), (240, 240)], ids=["as large", "smaller", "another shape"])
def test_two_cameras_that_number_alike_are_both_read(tmp_path: Path, size: tuple[int, int]) -> None:
    for index in range(4):
        write(tmp_path / "phone" / f"IMG_{index}.jpg", picture(index))
        write(tmp_path / "camera" / f"IMG_{index}.jpg", picture(100 + index, *size))
    names, warnings = read(tmp_path)
    assert len(names) == 8
    assert warnings == ()


def test_a_broken_copy_is_told_as_a_broken_photo(tmp_path: Path) -> None:
    for index in range(4):
        write(tmp_path / "full" / f"{index}.jpg", picture(index))
        (tmp_path / f"{index}.jpg").write_bytes(b"\xff\xd8\xff\xe0 nonsense")
    capture = read_capture(tmp_path)
    assert len(capture.photos) == 4
    assert len(capture.verdicts) == 4
