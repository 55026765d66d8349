"""Colours of photos are sRGB, whatever profile they came with; and 16-bit grey is no white."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image, ImageCms

from capture2vr.edge.capture.colour_profile import in_srgb, profile_of, rgb_of

PATCHES = np.array([(234, 51, 35), (117, 251, 76), (128, 128, 128), (60, 90, 200)], np.uint8)


def picture() -> np.ndarray:
    return np.repeat(np.repeat(PATCHES[None], 40, axis=0), 40, axis=1).reshape(40, 160, 3)


def profile(space: str) -> bytes:
    return ImageCms.ImageCmsProfile(ImageCms.createProfile(space)).tobytes()


@pytest.mark.parametrize("form", ["JPEG", "PNG", "WEBP", "TIFF"])
def test_the_profile_of_every_format_is_found(form: str) -> None:
    stored = profile("sRGB")
    Image.fromarray(picture()).save(made := io.BytesIO(), form, icc_profile=stored)
    assert profile_of(made.getvalue()) == stored
    Image.fromarray(picture()).save(without := io.BytesIO(), form)
    assert profile_of(without.getvalue()) == b""


@pytest.mark.parametrize("data", [b"", b"ICC_PROFILE", profile("sRGB"), profile("LAB"), bytes(500)])
def test_what_is_srgb_or_no_profile_of_rgb_changes_nothing(data: bytes) -> None:
    np.testing.assert_array_equal(in_srgb(picture(), data), picture())


@pytest.mark.parametrize("mode", ["I;16", "I"])
def test_grey_of_16_bits_keeps_its_shades(mode: str) -> None:
    shades = np.linspace(0, 65_535, 256).astype(np.uint16).reshape(16, 16)
    image = Image.fromarray(shades if mode == "I;16" else shades.astype(np.int32), mode=None)
    assert image.mode == mode
    np.testing.assert_allclose(rgb_of(image)[..., 0], np.arange(256).reshape(16, 16), atol=1)
    few = Image.fromarray(np.arange(256, dtype=np.int32).reshape(16, 16))
    np.testing.assert_array_equal(rgb_of(few)[..., 2], np.arange(256).reshape(16, 16))
