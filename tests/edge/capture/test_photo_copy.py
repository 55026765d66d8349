"""Copies of photos: decoded once, as good as the photo, and no copy where the file is as good itself."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.capture.photo_copy import COPY_PX, PhotoCopy, keep_copy
from capture2vr.edge.capture.picture import PhotoPixels
from capture2vr.edge.errors import CaptureError


def scene(width: int, height: int) -> np.ndarray:
    """A picture with shading, edges and colours, as a photo has them: sixteen square patches on its longer side."""
    rng = np.random.default_rng(1)
    patch = max(width, height) / 16
    coarse = rng.integers(0, 256, (max(1, round(height / patch)), max(1, round(width / patch)), 3), np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


class Whole:
    """A photo of this size that counts how often it is decoded, and at which sizes."""

    def __init__(self, width: int, height: int) -> None:
        self.rgb = scene(width, height)
        self.asked: list[int | None] = []

    def __call__(self, longest: int | None = None) -> np.ndarray:
        self.asked.append(longest)
        shrink = max(1.0, max(self.rgb.shape) / (longest or max(self.rgb.shape)))
        size = tuple(max(1, round(side / shrink)) for side in self.rgb.shape[1::-1])
        return np.asarray(cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def test_a_photo_is_decoded_once_however_often_and_wherever_it_is_read() -> None:
    whole = Whole(2400, 1800)
    copy = PhotoCopy(whole)
    with ThreadPoolExecutor(4) as pool:
        sizes = [picture.shape for picture in pool.map(copy, [480, 800, COPY_PX, 640] * 4)]
    assert sizes[:4] == [(360, 480, 3), (600, 800, 3), (1440, 1920, 3), (480, 640, 3)]
    assert whole.asked == [COPY_PX]


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(200, 2600), st.integers(200, 2600), st.integers(320, COPY_PX))
def test_a_copy_shows_what_the_photo_shows(width: int, height: int, longest: int) -> None:
    whole = Whole(width, height)
    copied, expected = PhotoCopy(whole)(longest), whole(longest)
    # The sides are rounded twice.
    assert np.abs(np.subtract(copied.shape, expected.shape)).max() <= 1
    same = cv2.resize(copied, expected.shape[1::-1]).astype(int)
    assert np.abs(same - expected).mean() < 2


def test_more_pixels_than_a_copy_has_come_from_the_photo() -> None:
    whole = Whole(2400, 1800)
    copy = PhotoCopy(whole)
    assert copy().shape == (1800, 2400, 3)
    assert copy(2000).shape == (1500, 2000, 3)
    assert whole.asked == [None, 2000]


def test_a_photo_that_cannot_be_decoded_is_an_error_each_time() -> None:
    copy = keep_copy(PhotoPixels(lambda: b"\xff\xd8 no picture", "IMG_1.jpg", "opencv", (4000, 3000), 0))
    for _ in range(2):
        with pytest.raises(CaptureError) as raised:
            copy(640)
        assert raised.value.file == "IMG_1.jpg"


@pytest.mark.parametrize(
    ("decoder", "size", "copied"),
    [
        ("opencv", (1920, 1440), False),
        ("opencv", (1600, 2400), True),
        ("pillow", (800, 600), False),
        ("heif", (800, 600), True),  # it decodes slowly, and at its full size alone
    ],
)
def test_a_file_that_decodes_fast_is_its_own_copy(decoder: str, size: tuple[int, int], copied: bool) -> None:
    pixels = PhotoPixels(bytes, "IMG_1", decoder, size, 0)
    assert isinstance(keep_copy(pixels), PhotoCopy) == copied
