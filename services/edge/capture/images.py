"""Read the size of PNG, JPEG and TIFF images from their headers, and decode them.

The size is checked before anything is decoded, so that a picture of 60,000 x 60,000 pixels allocates nothing.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.files import translate_errors
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_PIXELS = 100_000_000  # the largest phone sensors give 200 MP raw and 50 MP pictures; 100 MP is 300 MB decoded
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_SAME_SHAPE = 0.02  # relative tolerance of the aspect ratio
_MOST_SEGMENTS = 10_000  # of a JPEG before its size; phones write about ten, or a hundred with a map of depths


def broken_image(file: str, reason: str) -> CaptureError:
    """Return an IMAGE_UNREADABLE error."""
    return CaptureError("IMAGE_UNREADABLE", reason, file=file, hints=(say("export_capture_again"),))


def image_size(path: Path, file: str) -> tuple[int, int]:
    """Read (width, height) from an image file's header.

    Raises IMAGE_TOO_LARGE above MAX_PIXELS, and IMAGE_UNREADABLE for other formats or for a PNG that is cut off.
    """
    with _mapped(path, file) as data:
        size = header_size(data)
        if size is None:
            raise broken_image(file, say("not_png_jpeg_tiff_image"))
        if data[:8] == _PNG and data.find(b"IEND", max(0, len(data) - 64)) < 0:
            raise broken_image(file, say("cut_off_end_png_missing"))
    return check_pixels(size, file)


@contextmanager
def _mapped(path: Path, file: str) -> Iterator[mmap.mmap]:
    """Map a file into memory, of which only what is looked at is read: a TIFF's size may be behind its pixels."""
    try:
        with path.open("rb") as stream:
            data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise broken_image(file, say("cannot_be_opened", why=error.strerror)) from None
    except ValueError:
        raise broken_image(file, say("file_empty")) from None
    with data:
        yield data


def check_pixels(size: tuple[int, int], file: str, most: int = MAX_PIXELS) -> tuple[int, int]:
    """Return the `size`. Raises IMAGE_TOO_LARGE above `most` pixels, and IMAGE_UNREADABLE for a size of 0."""
    width, height = size
    if width * height > most:
        reason = say("x_pixels_most_megapixels_read", width=width, height=height, most=most // 10**6)
        raise CaptureError("IMAGE_TOO_LARGE", reason, file=file, hints=(say("send_smaller_picture"),))
    if width < 1 or height < 1:
        raise broken_image(file, say("x_pixels_has_no_pixels", width=width, height=height))
    return size


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether two pictures have the same aspect ratio, but for the rounded sides of scaled copies."""
    return bool(abs(size[0] * other[1] - other[0] * size[1]) <= _SAME_SHAPE * other[0] * size[1])


def header_size(head: bytes | mmap.mmap) -> tuple[int, int] | None:
    """Return (width, height) from the bytes of a PNG, JPEG or TIFF, None for any other format.

    The first 24 of a PNG suffice; a JPEG's size comes after its metadata, a TIFF's may be at its end.
    """
    if head[:8] == _PNG and len(head) >= 24 and head[12:16] == b"IHDR":
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if head[:2] == _JPEG:
        return _jpeg_size(head)
    return _tiff_size(head) if head[:4] in _TIFF_ORDER else None


def check_header(data: bytes, file: str) -> None:
    """Check the size in a picture's header, where it tells it, before anything is decoded.

    Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE as `check_pixels`.
    """
    size = header_size(data)
    if size is not None:
        check_pixels(size, file)


def _jpeg_size(head: bytes | mmap.mmap) -> tuple[int, int] | None:
    """Return (width, height) from the start-of-frame segment of a JPEG, or None when it is not in `head`."""
    at = 2
    for _ in range(_MOST_SEGMENTS):
        if at + 9 > len(head) or head[at] != 0xFF:
            break
        marker = head[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        at += 1 if marker == 0xFF else 2 + struct.unpack(">H", head[at + 2 : at + 4])[0]
    return None


_TIFF_ORDER = {b"II*\0": "<", b"MM\0*": ">"}


def _tiff_size(head: bytes | mmap.mmap) -> tuple[int, int] | None:
    """Return width (tag 256) and height (tag 257) of a TIFF's first directory, or None when it is not in `head`."""
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
    """Read a whole file; errors of the operating system become CAPTURE_UNREADABLE."""
    with translate_errors(file, "file"):
        return path.read_bytes()


def decode_grey(data: bytes, file: str) -> Floats:
    """Decode a one-channel image of any bit depth to (H,W) float32, values as stored. Raises IMAGE_UNREADABLE."""
    import cv2

    return _one_channel(_decode(data, file, cv2.IMREAD_UNCHANGED), file)


def decode_depth(data: bytes, file: str) -> Floats:
    """Decode as `decode_grey`, but refuse 8 bits per pixel: these are previews of depth, whose values have no unit."""
    import cv2

    pixels = _decode(data, file, cv2.IMREAD_UNCHANGED)
    if pixels.dtype == np.uint8:
        raise broken_image(file, say("depth_has_8_bits"))
    return _one_channel(pixels, file)


def has_8_bits(data: bytes, file: str) -> bool:
    """Return whether an image has 8 bits a value, as previews of depth have. Raises IMAGE_UNREADABLE."""
    import cv2

    return _decode(data, file, cv2.IMREAD_UNCHANGED).dtype == np.uint8


def _one_channel(pixels: NDArray[Any], file: str) -> Floats:
    if pixels.ndim != 2:
        raise broken_image(file, say("has_channels_depth_confidence_image", count=pixels.shape[2]))
    return pixels.astype(np.float32)


def decode_rgb(data: bytes, file: str) -> Bytes:
    """Decode to (H,W,3) uint8 sRGB without applying the orientation tag: the intrinsics are for pixels as stored."""
    import cv2

    pixels = _decode(data, file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.ascontiguousarray(pixels[..., ::-1], dtype=np.uint8)


def _decode(data: bytes, file: str, flags: int) -> NDArray[Any]:
    """Decode with OpenCV, after checking format and size. Raises IMAGE_UNREADABLE and IMAGE_TOO_LARGE."""
    import cv2

    size = header_size(data)
    if size is None:
        raise broken_image(file, say("not_png_jpeg_tiff_image"))
    check_pixels(size, file)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise broken_image(file, say("cannot_be_decoded_image_data"))
    return np.asarray(pixels)
