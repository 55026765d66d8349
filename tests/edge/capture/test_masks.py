"""Masks are found as every program names them, and what they hide is not used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, no_tick
from capture2vr.edge.cameras.screening import screen
from capture2vr.edge.capture.files import Folder, open_folder
from capture2vr.edge.capture.masks import mask_file, with_masks
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.capture.photos import pictures, read, read_photo
from capture2vr.edge.photos.undistorted import extend_colours
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import cut_out
from tests.support import captures

WIDTH, HEIGHT = 64, 48
DISC = np.hypot(*np.meshgrid(np.arange(WIDTH) - 30, np.arange(HEIGHT) - 20)) < 15
NAMES = ("1.jpg", "2.jpg", "3.jpg")


@pytest.mark.parametrize(
    ("photo", "mask"),
    [
        ("images/a.jpg", "masks/a.jpg.png"),  # COLMAP
        ("images/left/a.jpg", "masks/left/a.jpg.png"),
        ("images/a.jpg", "masks/a.png"),
        ("images/a.jpg", "images/masks/a.png"),
        ("a.jpg", "mask/a.PNG"),
        ("a.jpg", "masks/a_mask.png"),  # Metashape
        ("images/a.jpg", "images/a_mask.png"),
        ("images/a.jpg", "images/a.jpg.mask.png"),  # RealityCapture
        ("a.jpg", "a.mask.png"),
    ],
)
def test_masks_are_found_as_programs_name_them_and_are_no_photos(photo: str, mask: str, tmp_path: Path) -> None:
    for name in (photo, mask, photo.replace("a.", "b.")):
        captures.save_jpg(tmp_path / name, captures.picture(0))
    folder = open_folder(tmp_path)
    assert mask_file(folder, photo) == mask
    assert pictures(folder) == [photo, photo.replace("a.", "b.")]


@pytest.mark.parametrize("names", [("masks/a.jpg", "masks/b.jpg"), ("b.jpg", "death_mask.jpg"), ("a.jpg", "mask.jpg")])
def test_photos_of_masks_are_photos(names: tuple[str, ...], tmp_path: Path) -> None:
    for name in names:
        captures.save_jpg(tmp_path / name, captures.picture(0))
    assert pictures(open_folder(tmp_path)) == list(names)


def photo_with_mask(folder: Path, mask: np.ndarray, form: str = "masks/1.jpg.png") -> Photo:
    captures.save_jpg(folder / "1.jpg", np.full((HEIGHT, WIDTH, 3), 120, np.uint8))
    captures.save_png(folder / form, mask)
    return read_photo(open_folder(folder), "1.jpg")


def mask_of(photo: Photo) -> Bools:
    (masked,), warnings = with_masks([photo], no_tick)
    assert warnings == ()
    assert masked.mask is not None
    return masked.mask


@pytest.mark.parametrize(
    "pixels",
    [
        np.uint8(255 * DISC),
        np.uint8(DISC),  # 0 and 1
        np.uint16(65_535 * DISC),
        np.repeat(np.uint8(200 * DISC)[..., None], 3, axis=2),
        np.dstack([np.full((HEIGHT, WIDTH, 3), 255, np.uint8), np.uint8(255 * DISC)]),  # white, and transparent
        np.uint8(255 * DISC).repeat(2, axis=0).repeat(2, axis=1),  # of twice the size
    ],
)
def test_masks_of_any_depth_and_size_say_the_same(pixels: np.ndarray, tmp_path: Path) -> None:
    mask = mask_of(photo_with_mask(tmp_path, pixels))
    assert (cv2.resize(mask.astype(np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) != DISC).mean() < 0.01


def test_a_mask_of_the_upright_picture_is_turned_as_the_photo_is_stored(tmp_path: Path) -> None:
    photo = photo_with_mask(tmp_path, np.uint8(255 * np.rot90(DISC, -1)))
    assert (mask_of(replace(photo, turns=1)) == DISC).all()


@pytest.mark.parametrize(
    ("pixels", "why"),
    [
        (np.zeros((HEIGHT, WIDTH), np.uint8), "hides everything"),
        (np.full((HEIGHT, HEIGHT), 255, np.uint8), "48 × 48 pixels does not fit the photo of 64 × 48"),
    ],
)
def test_a_mask_that_cannot_be_is_told_and_costs_itself(pixels: np.ndarray, why: str, tmp_path: Path) -> None:
    (photo,), (warning,) = with_masks([photo_with_mask(tmp_path, pixels)], no_tick)
    assert photo.mask is None
    assert why in warning


def test_a_broken_mask_is_told(tmp_path: Path) -> None:
    photo = photo_with_mask(tmp_path, np.uint8(DISC))
    (tmp_path / "masks/1.jpg.png").write_bytes(b"no picture")
    (photo,), (warning,) = with_masks([photo], no_tick)
    assert photo.mask is None
    assert "masks/1.jpg.png" in warning


def write_photos(folder: Path, masks: tuple[str, ...]) -> Folder:
    for index, name in enumerate(NAMES):
        captures.save_jpg(folder / name, captures.picture(index))
    for name in masks:
        captures.save_png(folder / "masks" / name, np.uint8(255 * DISC))
    return open_folder(folder)


def test_photos_without_a_mask_and_masks_without_a_photo_are_told(tmp_path: Path) -> None:
    capture = read(write_photos(tmp_path, ("1.png", "4.png")))
    assert [photo.name for photo in capture.photos] == list(NAMES)
    assert capture.warnings == ("masks that have the name of no photo were not used: masks/4.png",)
    assert with_masks(capture.photos, no_tick)[1] == ("photos without a mask: 2 of 3; their background counts too",)


def test_one_photo_is_cut_by_its_mask(tmp_path: Path) -> None:
    photo_with_mask(tmp_path, np.uint8(255 * DISC))
    capture = read_capture(tmp_path)
    assert capture.kind == "image"
    assert (cut_out(capture.photos[0]).mask == DISC).all()


def rgba(luma: int, folder: Path) -> Photo:
    """A picture with a pattern about this luma where the disc is, and nothing around it."""
    pattern = np.random.default_rng(0).integers(0, 8, (HEIGHT, WIDTH, 1)) + luma
    pixels = np.where(DISC[..., None], np.repeat(pattern, 3, axis=2), 0)
    captures.save_png(folder / "1.png", np.dstack([pixels, 255 * DISC]).astype(np.uint8))
    return read_photo(open_folder(folder), "1.png")


@pytest.mark.parametrize(("luma", "used"), [(60, 1), (2, 0)])
def test_what_is_transparent_makes_no_photo_dark(luma: int, used: int, tmp_path: Path) -> None:
    photos, _ = with_masks([rgba(luma, tmp_path)], no_tick)
    assert photos[0].mask is not None
    accepted, verdicts = screen(photos, tick=no_tick)
    assert (len(accepted), [verdict.verdict for verdict in verdicts]) == (used, ["dark"] * (1 - used))


def test_an_alpha_channel_that_hides_nothing_is_no_mask(tmp_path: Path) -> None:
    captures.save_png(tmp_path / "1.png", np.full((HEIGHT, WIDTH, 4), 255, np.uint8))
    (photo,), warnings = with_masks([read_photo(open_folder(tmp_path), "1.png")], no_tick)
    assert (photo.mask, warnings) == (None, ())


def test_a_photo_that_is_transparent_everywhere_is_told(tmp_path: Path) -> None:
    captures.save_png(tmp_path / "1.png", np.zeros((HEIGHT, WIDTH, 4), np.uint8))
    (photo,), (warning,) = with_masks([read_photo(open_folder(tmp_path), "1.png")], no_tick)
    assert photo.mask is None
    assert "1 of 1 masks cannot be used; the first: 1.png: its mask hides everything" in warning


def test_what_is_transparent_tints_no_rim() -> None:
    """Two pixels beyond the outline, and in its last pixel, which is half black, the colour is the object's."""
    rgb = np.where(DISC[..., None], np.uint8([200, 100, 50]), np.uint8(0))
    rim = DISC & ~cv2.erode(DISC.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    rgb[rim] //= 2
    near = cv2.dilate(DISC.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    extended = extend_colours(rgb, DISC)
    assert (extended[near] == [200, 100, 50]).all()
    assert (extended[0, -1] == 0).all()
