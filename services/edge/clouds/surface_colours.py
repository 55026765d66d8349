"""Look up the colours of points on triangles: of vertices, and of a texture; name textures that are absent."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.sample_surface import ColourAt
from capture2vr.sentences.sentence import in_row, say

_SOME = 3  # names in a warning


def vertex_colours(rgb: Bytes, faces: Ints) -> ColourAt:
    """Return a function that interpolates vertex colours (V,3) uint8 over the triangles."""

    def colour_at(triangle: Ints, weights: Floats) -> Bytes:
        return rgb8(np.rint(np.einsum("nc,ncd->nd", weights, rgb[faces[triangle]])).astype(np.int16))

    return colour_at


def nearest_texels(pixels: Bytes, uv: Floats) -> Bytes:
    """Look up the nearest texel at uv (N,2), with repeat wrapping; v 0 is the picture's lower edge."""
    height, width = pixels.shape[:2]
    u, v = np.nan_to_num(uv[:, 0]) % 1.0, 1.0 - np.nan_to_num(uv[:, 1]) % 1.0
    columns = np.minimum((u * width).astype(np.int64), width - 1)
    rows = np.clip((v * height).astype(np.int64), 0, height - 1)
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
