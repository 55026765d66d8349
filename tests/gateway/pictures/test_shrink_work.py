"""Small pictures are the photos as a reconstruction sees them: upright by the same rule, whatever their format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.photos import read_photo
from capture2vr.gateway.pictures.shrink_work import LONGEST_PX, shrink

RGB = np.random.default_rng(3).integers(0, 256, (6, 8, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)  # 64 x 48
FORMATS = {
    "JPEG": (".jpg", {"quality": 95, "subsampling": 0}),
    "PNG": (".png", {}),
    "WEBP": (".webp", {"lossless": True}),
    "TIFF": (".tif", {}),
    "HEIF": (".heic", {"quality": -1, "chroma": 444}),
}


def written(folder: Path, kind: str, orientation: int, picture: Image.Image) -> Path:
    suffix, options = FORMATS[kind]
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = folder / f"photo{suffix}"
    picture.save(path, kind, exif=exif.tobytes(), **options)
    return path


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("orientation", range(1, 9))
def test_it_is_upright_as_the_reconstruction_has_it(tmp_path: Path, kind: str, orientation: int) -> None:
    path = written(tmp_path, kind, orientation, Image.fromarray(RGB))
    photo = read_photo(Folder(tmp_path, (path.name,)), path.name)
    upright = np.rot90(photo.load(), -photo.turns).astype(int)
    small = np.asarray(shrink(path), int)
    assert small.shape == upright.shape
    assert np.abs(small - upright).mean() < 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
def test_a_large_one_is_shrunk_and_a_small_one_is_not(tmp_path: Path, kind: str) -> None:
    large = Image.fromarray(RGB).resize((2400, 1800))
    assert shrink(written(tmp_path, kind, 6, large)).size == (LONGEST_PX * 3 // 4, LONGEST_PX)
    assert shrink(written(tmp_path, kind, 1, Image.fromarray(RGB))).size == (64, 48)


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGBA", "I;16"])
def test_pictures_of_other_modes_are_shown(tmp_path: Path, mode: str) -> None:
    Image.new(mode, (20, 10)).save(tmp_path / "a.png")
    assert (shrink(tmp_path / "a.png").mode, shrink(tmp_path / "a.png").size) == ("RGB", (20, 10))


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_a_grey_picture_of_16_bits_has_its_shades(tmp_path: Path, name: str) -> None:
    shades = np.linspace(0, 65_535, 48 * 64).reshape(48, 64).astype(np.uint16)
    Image.fromarray(shades).save(tmp_path / name)
    expected = read_photo(Folder(tmp_path, (name,)), name).load().astype(int)
    assert np.abs(np.asarray(shrink(tmp_path / name), int) - expected).max() <= 1
    Image.fromarray(shades.repeat(40, axis=0).repeat(40, axis=1)).save(tmp_path / name)
    assert np.asarray(shrink(tmp_path / name)).std() > 60


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_a_picture_with_damaged_exif_is_shown(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a{FORMATS[kind][0]}"
    Image.fromarray(RGB).save(path, kind, exif=b"Exif\0\0" + bytes(40))
    assert shrink(path).size == (64, 48)
