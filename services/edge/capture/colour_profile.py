"""Convert the colours of pictures to 8-bit sRGB: by their ICC profile, and from more bits."""

from __future__ import annotations

from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes

_SRGB = b"sRGB"
_MARKS, _TIFF = (b"ICC_PROFILE", b"iCCP", b"ICCP"), (b"II", b"MM")
"""What stands before a profile in a JPEG, PNG and WebP: a look takes microseconds, Pillow three milliseconds."""
_HEAD_BYTES = 2**18  # in which it stands: only metadata comes before it
_MOST_BYTES = 2**22  # of a profile: that of a display has 500 bytes, of a printer a million


def rgb_of(image: Any) -> Bytes:
    """Convert a Pillow image to (h,w,3) uint8 as its numbers are. Pillow itself clips 16-bit grey to white."""
    if not image.mode.startswith("I"):
        return np.asarray(image.convert("RGB"), np.uint8)
    values = np.asarray(image).astype(np.int64)
    top = 65_535 if "16" in image.mode or values.max(initial=0) > 255 else 255
    grey = np.clip((values * 255 + top // 2) // top, 0, 255).astype(np.uint8)
    return grey_as_rgb(grey)


def grey_as_rgb(pixels: Bytes) -> Bytes:
    """Repeat a grey channel (h,w) or (h,w,n), with or without alpha, to three equal channels."""
    return np.repeat(pixels.reshape(*pixels.shape[:2], -1)[..., :1], 3, axis=2)


def profile_of(data: bytes) -> bytes:
    """Return the ICC profile of a JPEG, PNG, WebP or TIFF; b"" without one."""
    if not data.startswith(_TIFF) and not any(mark in data[:_HEAD_BYTES] for mark in _MARKS):
        return b""
    from PIL import Image

    try:
        with Image.open(BytesIO(data)) as image:
            return bytes(image.info.get("icc_profile") or b"")
    except Exception:  # noqa: BLE001 - the decoder reports what is wrong with a picture, and better
        return b""


def in_srgb(pixels: Bytes, profile: bytes) -> Bytes:
    """Return pixels (h,w,3) in sRGB, as their ICC profile says; as they are without one, or with one that is damaged.

    iPhones photograph in Display P3: taken for sRGB, such a photo is pale.
    """
    transform = _to_srgb(profile) if profile and len(profile) <= _MOST_BYTES else None
    if transform is None:
        return pixels
    from PIL import Image

    return np.asarray(transform.apply(Image.fromarray(np.ascontiguousarray(pixels))), np.uint8)


@lru_cache(maxsize=8)
def _to_srgb(profile: bytes) -> Any:
    """Return the transform of a profile of RGB to sRGB; None where none is needed, or it cannot be made."""
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(BytesIO(profile))
        if opened.profile.xcolor_space.strip() != "RGB" or _SRGB in profile or "srgb" in _name(opened):
            return None
        intent, target = ImageCms.Intent.RELATIVE_COLORIMETRIC, ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
        return ImageCms.ImageCmsTransform(opened, target, "RGB", "RGB", intent)
    except (OSError, ValueError, TypeError, ImageCms.PyCMSError):
        return None


def _name(opened: Any) -> str:
    return str(opened.profile.profile_description or "").lower()
