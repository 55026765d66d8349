"""Check that an image is complete and not too large to be decoded: first by its header, then by decoding it."""

from __future__ import annotations

import mmap
import struct
from functools import cache
from pathlib import Path
from types import ModuleType

from PIL import Image, UnidentifiedImageError

from capture2vr.gateway.strip import exr, jpeg, png
from capture2vr.gateway.strip.in_place import Buffer, UnreadableError
from capture2vr.gateway.uploads.sniff import Kind
from capture2vr.sentences.sentence import say

MAX_PIXELS = 100_000_000  # 300 MB decoded; phones' largest sensors have 200 megapixels, binned to 12 or 50
_MAX_DECODED_PIXELS = 24_000_000  # larger images are not decoded fully: 72 MB each, on two threads
# Of a PNG: 66 megapixels, 50 with alpha, or 33 of 16 bits. Decoders keep two pictures, for animations.
_MAX_DECODED_BYTES = 200_000_000
_MAX_SCANS = 100  # of a JPEG; encoders write about ten
# Of a JPEG, pixels × scans: its decoder visits all pixels in each scan, which takes 15 ms for 24 megapixels. 100
# megapixels in 12 scans are fine.
_MAX_SCANNED_PIXELS = 1_500_000_000
_MAX_SIDE = 65_535  # pixels: JPEG's limit
# Pillow's formats that are decoded here. A JPEG file of several pictures, "MPO", is opened as a JPEG, because Pillow
# knows the name MPO only in a process that has opened a JPEG before.
_FORMATS = ("JPEG", "WEBP", "TIFF", "HEIF")


class TooLargeError(Exception):
    """The image has too many pixels."""


def check_image(kind: Kind, path: Path, data: Buffer) -> None:
    """Check an image's size and content. data: memory map of the file at `path`

    Raises TooLargeError, UnreadableError.
    """
    width, height = _size(kind, path, data)
    if width < 1 or height < 1:
        raise UnreadableError(say("image_size_wrong_pixels", width=width, height=height))
    if width * height > MAX_PIXELS or max(width, height) > _MAX_SIDE:
        limit = f"{MAX_PIXELS // 1_000_000} megapixels"
        raise TooLargeError(say("image_has_pixels_most_allowed", width=width, height=height, limit=limit))
    if kind is Kind.PNG:
        if (decoded := max(png.raw_bytes(data), 3 * width * height)) > _MAX_DECODED_BYTES:
            limit = f"{_MAX_DECODED_BYTES // 1_000_000} MB"
            raise TooLargeError(say("image_pixels_take_mb", size=decoded // 1000000, limit=limit))
        png.check_pixels(data)
    elif kind is Kind.JPEG:
        _check_jpeg(path, data, width * height)
    elif kind in (Kind.WEBP, Kind.TIFF) and width * height <= _MAX_DECODED_PIXELS:
        _decode(path, draft=False)


def _size(kind: Kind, path: Path, data: Buffer) -> tuple[int, int]:
    """Return (width, height) from the image's header. Raises UnreadableError."""
    if kind is Kind.PNG:  # read here, because Pillow would parse text chunks too
        if len(data) < 33 or data[12:16] != b"IHDR":
            raise UnreadableError(say("not_png_image_although_name"))
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if kind is Kind.EXR:
        if data[:4] != b"v/1\x01":
            raise UnreadableError(say("not_exr_image_although_name"))
        return exr.size(data)
    return _pillow_size(path)


def _pillow_size(path: Path) -> tuple[int, int]:
    pillow = load_pillow()
    try:
        with pillow.open(path, formats=_FORMATS) as image:
            return int(image.width), int(image.height)
    except UnidentifiedImageError:
        raise UnreadableError(say("not_image_can_be_read_although")) from None
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - Pillow's plugins raise anything on damaged headers
        raise UnreadableError(say("image_header_damaged", error=error)) from None


def _check_jpeg(path: Path, data: Buffer, pixels: int) -> None:
    """Decode a JPEG at an eighth of its size, which reads every byte and needs a 64th of the memory.

    A progressive JPEG needs more memory, so a large one is not decoded.
    """
    if (scans := jpeg.count_scans(data)) > _MAX_SCANS:
        raise UnreadableError(say("jpeg_has_scans_most_read", scans=scans, most=_MAX_SCANS))
    if scans * pixels > _MAX_SCANNED_PIXELS and jpeg.is_progressive(data):
        most = _MAX_SCANNED_PIXELS // pixels
        raise TooLargeError(say("jpeg_has_scans_most_allowed", scans=scans, most=most, pixels=pixels))
    if pixels <= _MAX_DECODED_PIXELS or not jpeg.is_progressive(data):
        _decode(path, draft=True)


def _decode(path: Path, *, draft: bool) -> None:
    try:
        with load_pillow().open(path, formats=_FORMATS) as image:
            if draft:
                image.draft(None, (max(1, image.width // 8), max(1, image.height // 8)))
            image.load()
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - Pillow's plugins raise anything on damaged pixels
        raise UnreadableError(say("image_damaged_cut_short", error=error)) from None


@cache
def load_pillow() -> ModuleType:
    """Return Pillow's Image module with HEIF support, and without its size limit (ours, above, is stricter)."""
    import pillow_heif

    pillow_heif.register_heif_opener()
    Image.MAX_IMAGE_PIXELS = None
    return Image


def map_file(path: Path) -> mmap.mmap:
    """Memory-map a file, writable: only accessed parts are in memory. Raises UnreadableError for an empty file."""
    with path.open("r+b") as file:
        try:
            return mmap.mmap(file.fileno(), 0)
        except ValueError:
            raise UnreadableError(say("file_empty")) from None
