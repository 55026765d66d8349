"""Look up the colours of points on triangles: of vertices, and of a texture; name textures that are absent."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.images import check_pixels
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.sample_surface import ColourAt
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import in_row, say

_SOME = 3  # names in a warning
_MAX_TEXELS = 1_000_000_000  # of all textures of a file: 60 of 4,096 pixels a side, which take ten seconds


class TexturePixels:
    """Adds up the pixels of a file's textures, before they are decoded: a picture of one colour takes few bytes."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._count = 0

    def add(self, size: tuple[int, int]) -> None:
        """Count a texture of this width and height. Raises IMAGE_TOO_LARGE, CAPTURE_TOO_LARGE."""
        width, height = check_pixels(size, "texture")
        self._count += width * height
        if self._count > _MAX_TEXELS:
            what = say("has_textures_of_more_megapixels", most=_MAX_TEXELS // 10**6)
            hints = (say("export_mesh_with_smaller_textures"),)
            raise CaptureError("CAPTURE_TOO_LARGE", what, file=self._file, hints=hints)


def vertex_colours(rgb: Bytes, faces: Ints) -> ColourAt:
    """Return a function that interpolates vertex colours (V,3) uint8 over the triangles."""

    def colour_at(triangle: Ints, weights: Floats) -> Bytes:
        return rgb8(np.rint(np.einsum("nc,ncd->nd", weights, rgb[faces[triangle]])).astype(np.int16))

    return colour_at


def face_colours(rgb: Bytes) -> ColourAt:
    """Return a function that has the colour of each triangle (F,3) uint8 all over it."""

    def colour_at(triangle: Ints, weights: Floats) -> Bytes:
        return np.asarray(rgb[triangle])

    return colour_at


def nearest_texels(pixels: Bytes, uv: Floats) -> Bytes:
    """Look up the nearest texel at uv (N,2), with repeat wrapping; v 0 is the picture's lower edge."""
    return texels_at(pixels, np.nan_to_num(uv[:, 0]) % 1.0, 1.0 - np.nan_to_num(uv[:, 1]) % 1.0)


def texels_at(pixels: Bytes, x: Floats, y: Floats) -> Bytes:
    """Look up the texels at x and y (N,) in [0,1] of a picture's sides, from its upper left corner."""
    height, width = pixels.shape[:2]
    columns = np.minimum((x * width).astype(np.int64), width - 1)
    rows = np.minimum((y * height).astype(np.int64), height - 1)
    texels: Bytes = pixels[rows, columns]
    return texels


def absent_textures(file: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return the warning that a mesh's textures of these names are not in the capture, () without any."""
    absent = sorted(set(names))
    if not absent:
        return ()
    some = ", ".join(name[:80] for name in absent[:_SOME])
    names = say("names_and_others", names=some) if len(absent) > _SOME else some
    return (in_row(": ", (file, say("textures_not_in_capture", names=names))),)
