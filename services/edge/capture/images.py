"""Images: the header is read before anything is decoded, so a picture of 60,000 x 60,000 pixels costs nothing."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Bytes, Floats
from services.edge.capture.files import reading
from services.edge.errors import CaptureError

MAX_PIXELS = 100_000_000  # the largest phone sensors give 200 MP raw and 50 MP pictures; 100 MP is 300 MB decoded
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_HEADER_BYTES = 2**18  # EXIF with a thumbnail and a colour profile lie before a JPEG's size


def broken_image(file: str, reason: str) -> CaptureError:
    return CaptureError("IMAGE_UNREADABLE", reason, file=file, hints=("export the capture again",))


def image_size(path: Path, file: str) -> tuple[int, int]:
    """(width, height) from the header, checked against MAX_PIXELS.

    Raises IMAGE_TOO_LARGE, and IMAGE_UNREADABLE for what is no image or for a PNG cut off before its end.
    """
    head, tail = _ends(path, file)
    size = header_size(head)
    if size is None:
        raise broken_image(file, "is not a PNG, JPEG or TIFF image" if head else "is empty")
    if head.startswith(_PNG) and b"IEND" not in tail:
        raise broken_image(file, "is cut off: the PNG has no end")
    return check_pixels(size, file)


def _ends(path: Path, file: str) -> tuple[bytes, bytes]:
    try:
        with path.open("rb") as stream:
            head = stream.read(64)
            if head.startswith(_JPEG) or head[:4] in _TIFF_ORDER:
                head += stream.read(_HEADER_BYTES)
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - 64))
            return head, stream.read()
    except OSError as error:
        raise broken_image(file, f"cannot be opened ({error.strerror})") from None


def check_pixels(size: tuple[int, int], file: str, most: int = MAX_PIXELS) -> tuple[int, int]:
    """The `size`. Raises IMAGE_TOO_LARGE above `most` pixels, and IMAGE_UNREADABLE without any."""
    width, height = size
    if width * height > most:
        reason = f"is {width} x {height} pixels; at most {most // 10**6} megapixels are read"
        raise CaptureError("IMAGE_TOO_LARGE", reason, file=file, hints=("send a smaller picture",))
    if width < 1 or height < 1:
        raise broken_image(file, "has no pixels")
    return size


def header_size(head: bytes) -> tuple[int, int] | None:
    """(width, height) that a PNG, JPEG or TIFF header states, None for anything else."""
    if head.startswith(_PNG) and len(head) >= 24 and head[12:16] == b"IHDR":
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if head.startswith(_JPEG):
        return _jpeg_size(head)
    return _tiff_size(head) if head[:4] in _TIFF_ORDER else None


def _jpeg_size(head: bytes) -> tuple[int, int] | None:
    """Walk the segments up to the start of frame, which holds the size."""
    at = 2
    while at + 9 <= len(head) and head[at] == 0xFF:
        marker = head[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        at += 1 if marker == 0xFF else 2 + struct.unpack(">H", head[at + 2 : at + 4])[0]
    return None


_TIFF_ORDER = {b"II*\0": "<", b"MM\0*": ">"}


def _tiff_size(head: bytes) -> tuple[int, int] | None:
    """Width (tag 256) and height (tag 257) of the first directory, when it lies within the header bytes."""
    order = _TIFF_ORDER[head[:4]]
    sides = {256: 0, 257: 0}
    try:
        (at,) = struct.unpack_from(order + "I", head, 4)
        (entries,) = struct.unpack_from(order + "H", head, at)
        for index in range(entries):
            tag, kind = struct.unpack_from(order + "HH", head, at + 2 + 12 * index)
            if tag in sides:
                (sides[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), head, at + 10 + 12 * index)
    except struct.error:
        return None
    return sides[256], sides[257]


def read_bytes(path: Path, file: str) -> bytes:
    with reading(file, "file"):
        return path.read_bytes()


def decode_grey(data: bytes, file: str) -> Floats:
    """One channel of any depth, values as stored: (H,W) float32. Raises IMAGE_UNREADABLE."""
    import cv2

    return _one_channel(_decode(data, file, cv2.IMREAD_UNCHANGED), file)


def decode_depth(data: bytes, file: str) -> Floats:
    """As `decode_grey`, refusing 8 bits a pixel: apps write pictures of depth so, and they have no unit."""
    import cv2

    pixels = _decode(data, file, cv2.IMREAD_UNCHANGED)
    if pixels.dtype == np.uint8:
        raise broken_image(file, "has 8 bits per pixel: a picture of depth, not depth")
    return _one_channel(pixels, file)


def _one_channel(pixels: NDArray[Any], file: str) -> Floats:
    if pixels.ndim != 2:
        raise broken_image(file, f"has {pixels.shape[2]} channels; depth and confidence have one")
    return pixels.astype(np.float32)


def decode_rgb(data: bytes, file: str) -> Bytes:
    """(H,W,3) uint8 sRGB in the sensor's orientation, the one that the intrinsics describe."""
    import cv2

    pixels = _decode(data, file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.ascontiguousarray(pixels[..., ::-1], dtype=np.uint8)


def _decode(data: bytes, file: str, flags: int) -> NDArray[Any]:
    import cv2

    size = header_size(data[:_HEADER_BYTES])
    if size is None:
        raise broken_image(file, "is not a PNG, JPEG or TIFF image")
    check_pixels(size, file)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise broken_image(file, "cannot be decoded")
    return np.asarray(pixels)
