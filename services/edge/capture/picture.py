"""One picture: its header, checked before anything is decoded, and its pixels, decoded when they are asked for.

Pixels are as the sensor gave them, in the order of the file: the orientation tag is told as `turns`, not applied, and
the turn that decoders of HEIC and TIFF make by themselves is taken back. So upright and sideways photos share a camera.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from services.edge.arrays import Bytes
from services.edge.capture.files import reading
from services.edge.capture.images import broken_image, check_pixels, read_bytes
from services.edge.errors import CaptureError

_HEAD_BYTES = 16
_PILLOW_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF")
_REDUCTIONS = (2, 4, 8)  # of the sides, that JPEG can be decoded at: ten times as fast at an eighth
_JPEG = b"\xff\xd8"

# EXIF 2.32 tags, and the camera's directory.
_MAKE, _MODEL, _ORIENTATION, _CAMERA = 0x010F, 0x0110, 0x0112, 0x8769
_FOCAL_MM, _FOCAL_35MM, _WIDTH, _HEIGHT, _PLANE_X, _PLANE_UNIT = 0x920A, 0xA405, 0xA002, 0xA003, 0xA20E, 0xA210
_DNG_VERSION = 0xC612
_PICTURE_TAGS = (_MAKE, _MODEL, _ORIENTATION, _DNG_VERSION)
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # of the focal plane's resolution: inch, centimetre, millimetre, micron
_DIAGONAL_35MM = math.hypot(36, 24)  # phones compare diagonals: their 4:3 has not the width of 3:2
# Of the longer side, equal to 11 mm and 290 mm on 35 mm film. Programs that shrink a photo leave the resolution of its
# focal plane as it was, which gives ten times the focal length; none is better than such a one.
_FOCAL_RANGE = (0.3, 8.0)
# Quarter turns clockwise that bring rows and columns upright, by orientation; mirrored ones stay mirrored.
_TURNS = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}

Tags = dict[int, Any]
"""EXIF: number of the tag -> value, of any type that the file says."""
_Decoder = Literal["opencv", "pillow", "heif"]


def read_header(path: Path, file: str) -> Header:
    """Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE."""
    return _heif_header(path, file) if first_bytes(path, file)[4:8] == b"ftyp" else _plain_header(path, file)


def first_bytes(path: Path, file: str) -> bytes:
    """As many as tell what kind of file it is."""
    with reading(file, "file"), path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


@dataclass(frozen=True, slots=True)
class Header:
    """size: as stored; turns: as `Photo` has them; turned: those that the decoder makes by itself."""

    size: tuple[int, int]
    decoder: _Decoder
    tags: Tags
    turns: int
    turned: int


def _stored(size: tuple[int, int], decoder: _Decoder, tags: Tags, turns: int, turned: int) -> Header:
    """From the `size` that the decoder tells."""
    return Header(size[::-1] if turned % 2 else size, decoder, tags, turns, turned)


def _plain_header(path: Path, file: str) -> Header:
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # its own limit only warns up to twice its number; ours is judged below
    with warnings.catch_warnings(), _as_image(file):
        warnings.simplefilter("ignore")  # of damaged tags, which are read as far as they go
        with Image.open(path, formats=_PILLOW_FORMATS) as image:
            size, mode, tiff = image.size, image.mode, image.format == "TIFF"
            # Not `image.getexif()`, which decodes a whole PNG to look for tags behind its pixels.
            tags = _tags(lambda: Image.Image.getexif(image))
    if _DNG_VERSION in tags:
        raise broken_image(file, "is a raw picture")
    turns = _TURNS.get(tags.get(_ORIENTATION, 1), 0)
    # OpenCV reads CMYK, and shows other colours than everybody else.
    decoder: _Decoder = "pillow" if mode == "CMYK" else "opencv"
    return _stored(check_pixels(size, file), decoder, tags, turns, turns if tiff else 0)


def _heif_header(path: Path, file: str) -> Header:
    import pillow_heif

    data = read_bytes(path, file)
    with _as_image(file):
        image = pillow_heif.open_heif(data)
        size = image.size  # raises where the file has no picture
    tags = _tags(lambda: _block_tags(image.info.get("exif")))
    turned = _irot(data)
    return _stored(check_pixels(size, file), "heif", tags, turned, turned)


def _irot(data: bytes) -> int:
    """Quarter turns clockwise that a HEIF decoder makes: the box `irot` counts them the other way (ISO/IEC 23008-12,
    6.5.10). Previews in the file are turned alike. A mirrored picture is left as decoded."""
    at = data.find(b"\0\0\0\x09irot")
    if not 0 <= at < len(data) - 8 or b"\0\0\0\x09imir" in data:
        return 0
    return -data[at + 8] % 4


def _block_tags(block: bytes | None) -> Any:
    from PIL import Image

    exif = Image.Exif()
    exif.load(block or b"")
    return exif


def _tags(read: Callable[[], Any]) -> Tags:
    """Those of the picture that are used here and all of the camera's; none where they are damaged."""
    try:
        exif = read()
        return {tag: exif[tag] for tag in _PICTURE_TAGS if tag in exif} | dict(exif.get_ifd(_CAMERA))
    except Exception:  # noqa: BLE001 - damaged tags raise anything at all; a picture without them still is one
        return {}


def camera_key(tags: Tags, focal_px: float | None, size: tuple[int, int]) -> str:
    """Of both focal lengths: digital zoom changes one of them, and some files tell only the other."""
    maker = (" ".join(str(tags.get(tag, "unknown")).split())[:64] for tag in (_MAKE, _MODEL))
    focal = f"{_positive(tags.get(_FOCAL_MM)):.3g} mm, {focal_px or 0:.0f} px"
    return f"{' '.join(maker)}, {focal}, {size[0]} x {size[1]}"


def focal_px(tags: Tags, size: tuple[int, int]) -> float | None:
    """In pixels of a picture of `size`, from the focal length's equivalent on film or from that of the sensor."""
    film_mm = _positive(tags.get(_FOCAL_35MM))
    focal = film_mm / _DIAGONAL_35MM * math.hypot(*size) if film_mm else _sensor_focal_px(tags, size)
    low, high = _FOCAL_RANGE
    return focal if low <= focal / max(size) <= high else None


def _sensor_focal_px(tags: Tags, size: tuple[int, int]) -> float:
    """0 where a tag is missing. The focal plane's resolution holds for the size that the camera wrote."""
    written = max(_positive(tags.get(_WIDTH)), _positive(tags.get(_HEIGHT))) or max(size)
    px_per_mm = _positive(tags.get(_PLANE_X)) / _UNIT_MM.get(tags.get(_PLANE_UNIT, 2), math.inf)
    return _positive(tags.get(_FOCAL_MM)) * px_per_mm * max(size) / written


def _positive(value: Any) -> float:
    """0 for what is no positive number: tags of any type are found in any place."""
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return 0.0
    return number if 0 < number < math.inf else 0.0


@contextmanager
def _as_image(file: str) -> Iterator[None]:
    """Whatever a decoder throws at hostile bytes is IMAGE_UNREADABLE."""
    try:
        with reading(file, "picture"):
            yield
    except CaptureError as error:
        if error.code != "CAPTURE_UNREADABLE":
            raise
        raise broken_image(file, error.message) from None


@dataclass(frozen=True, slots=True)
class PhotoPixels:
    """Where a photo's pixels come from: a `LoadPhoto`. Raises IMAGE_UNREADABLE."""

    read: Callable[[], bytes]
    file: str
    decoder: _Decoder
    size: tuple[int, int]
    turned: int

    def __call__(self, longest: int | None = None) -> Bytes:
        import cv2

        shrink = max(1.0, max(self.size) / (longest or math.inf))
        data = self.read()
        with _as_image(self.file):
            pixels = np.rot90(self._decoded(data, shrink), self.turned)
        width, height = self.size
        if pixels.shape[:2] not in [(height // by, width // by) for by in (1, *_REDUCTIONS)]:
            raise broken_image(self.file, f"decodes to {pixels.shape[1]} x {pixels.shape[0]}, not what its header says")
        smaller = max(1, round(width / shrink)), max(1, round(height / shrink))
        if pixels.shape[1::-1] != smaller:
            pixels = np.asarray(cv2.resize(pixels, smaller, interpolation=cv2.INTER_AREA), np.uint8)
        return np.ascontiguousarray(pixels)

    def _decoded(self, data: bytes, shrink: float) -> Bytes:
        """(h,w,3) as the decoder turns it; where it can, a half, quarter or eighth of the size."""
        if self.decoder == "heif":
            return _decode_heif(data)
        return _decode_pillow(data) if self.decoder == "pillow" else _decode_opencv(data, self.file, self._by(shrink))

    def _by(self, shrink: float) -> int:
        """What the decoder may divide the sides by: where that leaves a remainder, its last pixels reach past the
        picture, which would shift what is scaled from there."""
        return max((by for by in _REDUCTIONS if by <= shrink and not any(side % by for side in self.size)), default=1)


def alpha_channel(path: Path, file: str) -> Bytes | None:
    """(h,w) uint8 as stored, of a PNG, WebP or TIFF that has one. Raises IMAGE_UNREADABLE."""
    import cv2

    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    with _as_image(file):
        pixels = cv2.imdecode(np.frombuffer(read_bytes(path, file), np.uint8), flags)
    if pixels is None or pixels.ndim < 3 or pixels.shape[2] != 4:
        return None
    return np.asarray(pixels[..., 3] // (257 if pixels.dtype == np.uint16 else 1), np.uint8)


def _decode_heif(data: bytes) -> Bytes:
    import pillow_heif

    pixels = np.asarray(pillow_heif.open_heif(data, convert_hdr_to_8bit=True))
    return pixels[..., :3] if pixels.ndim == 3 and pixels.shape[2] > 2 else _grey(pixels)


def _grey(pixels: Bytes) -> Bytes:
    """Three equal channels from one, alone or with transparency."""
    return np.repeat(pixels.reshape(*pixels.shape[:2], -1)[..., :1], 3, axis=2)


def _decode_pillow(data: bytes) -> Bytes:
    from PIL import Image

    with Image.open(BytesIO(data), formats=_PILLOW_FORMATS) as image:
        return np.asarray(image.convert("RGB"))


def _decode_opencv(data: bytes, file: str, by: int) -> Bytes:
    import cv2

    flags = cv2.IMREAD_COLOR
    if data.startswith(_JPEG):
        _check_whole(data, file)
        # Only the decoder of JPEG shrinks by averaging; others drop pixels, after decoding all of them.
        flags = getattr(cv2, f"IMREAD_REDUCED_COLOR_{by}") if by > 1 else flags
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise broken_image(file, "cannot be decoded")
    return np.asarray(pixels[..., ::-1])


def _check_whole(data: bytes, file: str) -> None:
    """A JPEG that was cut off decodes, grey from there on. Its end is looked for behind the start of its pixels: the
    preview among its tags has an end of its own."""
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] != b"\xda":
        padding = data[at + 1 : at + 2] == b"\xff"
        at += 1 if padding else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    if data.find(b"\xff\xd9", at) < 0:
        raise broken_image(file, "is cut off: the JPEG has no end")
