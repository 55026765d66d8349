"""Is a picture whole, and small enough to be decoded by anybody? Asked of its header first, of its pixels only then."""

from __future__ import annotations

import mmap
import struct
from functools import cache
from pathlib import Path
from types import ModuleType

from PIL import Image, UnidentifiedImageError

from services.gateway.uploads import exr, jpeg, png
from services.gateway.uploads.cleaned import Buffer, UnreadableError
from services.gateway.uploads.sniff import Kind

MOST_PIXELS = 100_000_000  # phones' largest are 200 megapixels binned to 12 or 50; a decoded one is 300 MB
_MOST_DECODED = 24_000_000  # pixels that may be held decoded here: 72 MB, on two threads
_MOST_SIDE = 65_535  # what JPEG can say


class TooLargeError(Exception):
    """More pixels than anybody should be made to decode."""


def check_image(kind: Kind, path: Path, data: Buffer) -> None:
    """Raises TooLargeError or UnreadableError. `data` maps the file at `path`."""
    width, height = _size(kind, path, data)
    if width < 1 or height < 1:
        raise UnreadableError(f"the picture has {width:,} × {height:,} pixels")
    if width * height > MOST_PIXELS or max(width, height) > _MOST_SIDE:
        raise TooLargeError(f"{width:,} × {height:,} pixels are more than {MOST_PIXELS // 1_000_000} megapixels")
    if kind is Kind.PNG:
        png.check_pixels(data)
    elif kind is Kind.JPEG:
        _check_jpeg(path, data, width * height)
    elif kind in (Kind.WEBP, Kind.TIFF) and width * height <= _MOST_DECODED:
        _decode(path, draft=False)


def _size(kind: Kind, path: Path, data: Buffer) -> tuple[int, int]:
    if kind is Kind.PNG:  # read here because Pillow reads text chunks on its way
        if len(data) < 33 or data[12:16] != b"IHDR":
            raise UnreadableError("this is no PNG, whatever its name says")
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if kind is Kind.EXR:
        if data[:4] != b"v/1\x01":
            raise UnreadableError("this is no EXR, whatever its name says")
        return exr.size(data)
    return _pillow_size(path)


def _pillow_size(path: Path) -> tuple[int, int]:
    pillow = _pillow()
    try:
        with pillow.open(path, formats=("JPEG", "MPO", "WEBP", "TIFF", "HEIF")) as image:
            return int(image.width), int(image.height)
    except UnidentifiedImageError:
        raise UnreadableError("this is no picture that can be read, whatever its name says") from None
    except Exception as error:  # noqa: BLE001 - Pillow's plugins raise anything on damaged headers
        raise UnreadableError(f"the picture's header is damaged: {error}") from None


def _check_jpeg(path: Path, data: Buffer, pixels: int) -> None:
    """Decode at an eighth of the size: every byte is read, a 64th of the memory used, unless it is progressive."""
    if pixels <= _MOST_DECODED or not jpeg.is_progressive(data):
        _decode(path, draft=True)


def _decode(path: Path, *, draft: bool) -> None:
    try:
        with _pillow().open(path) as image:
            if draft:
                image.draft(None, (max(1, image.width // 8), max(1, image.height // 8)))
            image.load()
    except Exception as error:  # noqa: BLE001 - Pillow's plugins raise anything on damaged pixels
        raise UnreadableError(f"the picture is damaged or cut short: {error}") from None


@cache
def _pillow() -> ModuleType:
    """Pillow's Image with HEIF and without its own size limit, which only warns up to twice its number."""
    import pillow_heif

    pillow_heif.register_heif_opener()
    Image.MAX_IMAGE_PIXELS = None
    return Image


def mapped(path: Path) -> mmap.mmap:
    """The file as a writable buffer, in memory only where it is touched. Raises UnreadableError for an empty file."""
    with path.open("r+b") as file:
        try:
            return mmap.mmap(file.fileno(), 0)
        except ValueError:
            raise UnreadableError("the file is empty") from None
