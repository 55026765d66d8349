"""Read a photo file (JPEG, PNG, WebP, TIFF, HEIC): size and EXIF from its header, pixels decoded on demand.

Pixels keep the file's own orientation: the EXIF orientation is returned as `turns`, not applied, and the rotation that
HEIC and TIFF decoders apply by themselves is undone. So portrait and landscape photos share one camera.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.colour_profile import grey_as_rgb, in_srgb, profile_of, rgb_of
from capture2vr.edge.capture.files import translate_errors
from capture2vr.edge.capture.images import broken_image, check_pixels, read_bytes
from capture2vr.edge.errors import CaptureError
from capture2vr.order.raw_photos import is_raw_photo
from capture2vr.sentences.sentence import say

_HEAD_BYTES = 16
_PILLOW_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF")
_REDUCTIONS = (2, 4, 8)  # divisors of the sides that JPEG can be decoded at: ten times as fast at an eighth
_JPEG = b"\xff\xd8"

# Numbers of EXIF 2.32 tags; _CAMERA is the Exif sub-directory.
_MAKE, _MODEL, _ORIENTATION, _CAMERA = 0x010F, 0x0110, 0x0112, 0x8769
_FOCAL_MM, _FOCAL_35MM, _WIDTH, _HEIGHT, _PLANE_X, _PLANE_UNIT = 0x920A, 0xA405, 0xA002, 0xA003, 0xA20E, 0xA210
_DNG_VERSION = 0xC612
_PICTURE_TAGS = (_MAKE, _MODEL, _ORIENTATION, _DNG_VERSION)
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # of the focal plane's resolution: inch, centimetre, millimetre, micron
_DIAGONAL_35MM = math.hypot(36, 24)  # mm; phones compute the 35 mm equivalent by the diagonal, as 4:3 is not 3:2
# Focal length over the longer side: 11 mm to 290 mm on 35 mm film. Values outside are ignored: programs that shrink a
# photo leave the tag of its focal plane's resolution unchanged, which gives ten times the true focal length.
_FOCAL_RANGE = (0.3, 8.0)
# EXIF orientation -> clockwise quarter turns to the upright picture; mirrored pictures stay mirrored.
_TURNS = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}

Tags = dict[int, Any]
"""EXIF tags: number -> value, of whatever type the file has."""
_Decoder = Literal["opencv", "pillow", "heif"]


def read_header(path: Path, file: str) -> Header:
    """Read the size and the EXIF tags of a photo file. Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE."""
    if is_raw_photo(file):
        raise broken_image(file, say("raw_picture_not_read"))
    return _heif_header(path, file) if first_bytes(path, file)[4:8] == b"ftyp" else _plain_header(path, file)


def first_bytes(path: Path, file: str) -> bytes:
    """Read the first 16 bytes of a file, which identify its format (magic number)."""
    with translate_errors(file, "file"), path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a photo file.

    size     (width, height) as stored
    turns    as in `Photo`
    turned   clockwise quarter turns that the decoder already applies by itself
    alpha    whether the file may have an alpha channel
    """

    size: tuple[int, int]
    decoder: _Decoder
    tags: Tags
    turns: int
    turned: int
    alpha: bool = False


def _header_as_stored(header: Header) -> Header:
    """Undo the decoder's own rotation in a header's size."""
    return replace(header, size=header.size[::-1]) if header.turned % 2 else header


def _plain_header(path: Path, file: str) -> Header:
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # Pillow only warns up to twice its limit; `check_pixels` below checks ours
    with warnings.catch_warnings(), _translate_image_errors(file):
        warnings.simplefilter("ignore")  # damaged tags are read as far as possible
        with Image.open(path, formats=_PILLOW_FORMATS) as image:
            size, mode, tiff = image.size, image.mode, image.format == "TIFF"
            alpha = mode.endswith(("A", "a")) or "transparency" in image.info
            # Not `image.getexif()`: for tags behind the pixels it would decode a whole PNG.
            tags = _tags(lambda: Image.Image.getexif(image))
    if _DNG_VERSION in tags:
        raise broken_image(file, "is a raw picture (DNG), which is not read")
    turns = _TURNS.get(tags.get(_ORIENTATION, 1), 0)
    # OpenCV decodes CMYK to wrong colours.
    decoder: _Decoder = "pillow" if mode == "CMYK" else "opencv"
    return _header_as_stored(Header(check_pixels(size, file), decoder, tags, turns, turns if tiff else 0, alpha=alpha))


def _heif_header(path: Path, file: str) -> Header:
    import pillow_heif

    data = read_bytes(path, file)
    with _translate_image_errors(file):
        image = pillow_heif.open_heif(data)
        size = image.size  # raises where the file has no picture
    tags = _tags(lambda: _block_tags(image.info.get("exif")))
    turned = _irot(data)
    return _header_as_stored(Header(check_pixels(size, file), "heif", tags, turned, turned))


def _irot(data: bytes) -> int:
    """Return the clockwise quarter turns that a HEIF decoder applies, from the box `irot`, which counts them
    anticlockwise (ISO/IEC 23008-12, 6.5.10). Previews in the file have the same rotation. 0 for mirrored pictures:
    these are left as decoded."""
    at = data.find(b"\0\0\0\x09irot")
    if not 0 <= at < len(data) - 8 or b"\0\0\0\x09imir" in data:
        return 0
    return -data[at + 8] % 4


def _block_tags(block: bytes | None) -> Any:
    """Parse a block of EXIF bytes."""
    from PIL import Image

    exif = Image.Exif()
    exif.load(block or b"")
    return exif


def _tags(read: Callable[[], Any]) -> Tags:
    """Return the picture's tags that are used here and all tags of the camera; an empty dict when they are damaged."""
    try:
        exif = read()
        return {tag: exif[tag] for tag in _PICTURE_TAGS if tag in exif} | dict(exif.get_ifd(_CAMERA))
    except Exception:  # noqa: BLE001 - damaged tags raise anything at all; the picture is usable without them
        return {}


def camera_key(tags: Tags, focal_px: float | None, size: tuple[int, int]) -> str:
    """Return a key that is equal for photos of one camera at one focal length and image size.

    It has the focal length in mm and in pixels: digital zoom changes only one of them, and some files have only one.
    """
    maker = (" ".join(str(tags.get(tag, "unknown")).split())[:64] for tag in (_MAKE, _MODEL))
    focal = f"{_positive(tags.get(_FOCAL_MM)):.3g} mm, {focal_px or 0:.0f} px"
    return f"{' '.join(maker)}, {focal}, {size[0]} x {size[1]}"


def focal_px(tags: Tags, size: tuple[int, int]) -> float | None:
    """Return the focal length in pixels for a picture of `size`, from the 35 mm equivalent or from the sensor's size.

    None where the tags are missing or the value is not within _FOCAL_RANGE.
    """
    film_mm = _positive(tags.get(_FOCAL_35MM))
    focal = film_mm / _DIAGONAL_35MM * math.hypot(*size) if film_mm else _sensor_focal_px(tags, size)
    low, high = _FOCAL_RANGE
    return focal if low <= focal / max(size) <= high else None


def _sensor_focal_px(tags: Tags, size: tuple[int, int]) -> float:
    """Return the focal length in pixels from its mm and the focal plane's resolution; 0 where a tag is missing.

    That resolution is for the size that the camera wrote, which may not be `size` any more.
    """
    written = max(_positive(tags.get(_WIDTH)), _positive(tags.get(_HEIGHT))) or max(size)
    px_per_mm = _positive(tags.get(_PLANE_X)) / _UNIT_MM.get(tags.get(_PLANE_UNIT, 2), math.inf)
    return _positive(tags.get(_FOCAL_MM)) * px_per_mm * max(size) / written


def _positive(value: Any) -> float:
    """Convert a tag's value to a positive float, or 0 if it is not one: files have values of any type."""
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return 0.0
    return number if 0 < number < math.inf else 0.0


@contextmanager
def _translate_image_errors(file: str) -> Iterator[None]:
    """Translate every exception of an image decoder into IMAGE_UNREADABLE."""
    try:
        with translate_errors(file, "picture"):
            yield
    except CaptureError as error:
        if error.code != "CAPTURE_UNREADABLE":
            raise
        raise broken_image(file, error.message) from None


@dataclass(frozen=True, slots=True)
class PhotoPixels:
    """Decodes the pixels of a photo: a `LoadPhoto`. Calling it raises IMAGE_UNREADABLE."""

    read: Callable[[], bytes]
    file: str
    decoder: _Decoder
    size: tuple[int, int]
    turned: int

    def __call__(self, longest: int | None = None) -> Bytes:
        import cv2

        shrink = max(1.0, max(self.size) / (longest or math.inf))
        data = self.read()
        with _translate_image_errors(self.file):
            decoded, profile = self._decoded(data, shrink)
            pixels = np.rot90(decoded, self.turned)
        width, height = self.size
        if pixels.shape[:2] not in [(height // by, width // by) for by in (1, *_REDUCTIONS)]:
            what = say(
                "decodes_to_x_pixels_but_header", width=pixels.shape[1], height=pixels.shape[0], w=width, h=height
            )
            raise broken_image(self.file, what)
        smaller = max(1, round(width / shrink)), max(1, round(height / shrink))
        if pixels.shape[1::-1] != smaller:
            pixels = np.asarray(cv2.resize(pixels, smaller, interpolation=cv2.INTER_AREA), np.uint8)
        return np.ascontiguousarray(in_srgb(pixels, profile))

    def _decoded(self, data: bytes, shrink: float) -> tuple[Bytes, bytes]:
        """Decode to (h,w,3), rotated as the decoder does, JPEG at a half, quarter or eighth where that is enough; and
        the ICC profile, b"" without one."""
        if self.decoder == "heif":
            return _decode_heif(data)
        if self.decoder == "pillow":
            return _decode_pillow(data), profile_of(data)
        return _decode_opencv(data, self.file, self._by(shrink)), profile_of(data)

    def _by(self, shrink: float) -> int:
        """Return the largest divisor of both sides, at most `shrink`, that the decoder supports.

        With a remainder the last reduced pixel would reach beyond the picture and shift everything scaled from it."""
        return max((by for by in _REDUCTIONS if by <= shrink and not any(side % by for side in self.size)), default=1)


def pixels_as_stored(path: Path, file: str) -> Any:
    """Decode a PNG, JPEG, WebP or TIFF with the channels and depth that it has; None if OpenCV cannot."""
    import cv2

    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    with _translate_image_errors(file):
        return cv2.imdecode(np.frombuffer(read_bytes(path, file), np.uint8), flags)


def alpha_channel(path: Path, file: str) -> Bytes | None:
    """Decode the alpha channel of a PNG, WebP or TIFF: (h,w) uint8 as stored, or None. Raises IMAGE_UNREADABLE."""
    pixels = pixels_as_stored(path, file)
    if pixels is None or pixels.ndim < 3 or pixels.shape[2] != 4:
        return None
    return np.asarray(pixels[..., 3] // (257 if pixels.dtype == np.uint16 else 1), np.uint8)


def _decode_heif(data: bytes) -> tuple[Bytes, bytes]:
    """Decode a HEIF image to (h,w,3), rotated as the file says, with its ICC profile, b"" without one."""
    import pillow_heif

    image = pillow_heif.open_heif(data, convert_hdr_to_8bit=True)
    pixels, profile = np.asarray(image), bytes(image.info.get("icc_profile") or b"")
    return pixels[..., :3] if pixels.ndim == 3 and pixels.shape[2] > 2 else grey_as_rgb(pixels), profile


def _decode_pillow(data: bytes) -> Bytes:
    from PIL import Image

    with Image.open(BytesIO(data), formats=_PILLOW_FORMATS) as image:
        return rgb_of(image)


def _decode_opencv(data: bytes, file: str, by: int) -> Bytes:
    import cv2

    flags = cv2.IMREAD_COLOR
    if data.startswith(_JPEG):
        _check_jpeg_end(data, file)
        # Only the JPEG decoder reduces by averaging; the others decode everything and then drop pixels.
        flags = getattr(cv2, f"IMREAD_REDUCED_COLOR_{by}") if by > 1 else flags
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise broken_image(file, say("cannot_be_decoded_image_data"))
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8)


def _check_jpeg_end(data: bytes, file: str) -> None:
    """Raise IMAGE_UNREADABLE for a JPEG without an end-of-image marker: decoders fill what is cut off with grey.

    The marker is searched behind the start of the pixels, since the EXIF preview has an end marker of its own."""
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] != b"\xda":
        padding = data[at + 1 : at + 2] == b"\xff"
        at += 1 if padding else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    if data.find(b"\xff\xd9", at) < 0:
        raise broken_image(file, say("cut_off_end_jpeg_missing"))
