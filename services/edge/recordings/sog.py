"""Read the centres of Gaussian splats from PlayCanvas' SOG: `meta.json` and WebP pictures, a pixel of each for a splat.

Format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/. A `.sog` is a zip of them. Places
are 16 bits in two pictures, between the least and greatest of their logarithms; colours are numbers of a list, and the
opacity is their picture's alpha. In the first version colours and the opacity's logit are shares instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.files import Folder, read_json, translate_errors, unreadable
from capture2vr.edge.capture.images import check_pixels, read_bytes
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.ply import LEAST_OPACITY
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings.splat_files import capture_of_splats
from capture2vr.edge.splats.spz import HARMONIC
from capture2vr.sentences.sentence import say

_META, _LEVELS = "meta.json", "lod-meta.json"
_PLACES, _COLOURS = "means", "sh0"


def matches(folder: Folder) -> bool:
    """Return whether there are pictures of splats with their description, or such for each level of detail."""
    if folder.has(_LEVELS):
        return True
    if not folder.has(_META) or not folder.directly_in("", ".webp"):
        return False
    meta = read_json(folder.path(_META), _META)
    return isinstance(meta, Mapping) and _PLACES in meta and _COLOURS in meta


def read(folder: Folder) -> Capture:
    """Read the centres and colours. Raises CaptureError, naming the file; levels of detail are refused by name."""
    if folder.has(_LEVELS):
        hint = say("export_splats_as_ply")
        raise CaptureError("CAPTURE_UNREADABLE", say("splats_in_levels"), file=_LEVELS, hints=(hint,))
    meta = read_json(folder.path(_META), _META)
    with translate_errors(_META, "SOG"):
        places, colours = meta[_PLACES], meta[_COLOURS]
        count = int(meta["count"] if "count" in meta else places["shape"][0])
        if not 0 < count <= MAX_POINTS:
            raise too_many_points(count, _META)
        low, high = (_pixels(folder, name, count)[:, :3].astype(np.uint16) for name in places["files"][:2])
        logs = _between(places, (low + 256 * high) / 65_535)
        light = _pixels(folder, colours["files"][0], count)
        tint, seen = _listed(colours, light) if "codebook" in colours else _shared(colours, light)
        xyz = np.sign(logs) * np.expm1(np.abs(logs))
        return capture_of_splats("sog", _META, xyz, rgb8(tint * HARMONIC + 0.5, 255.0), seen)


def _pixels(folder: Folder, written: object, count: int) -> Bytes:
    """Return the first `count` pixels (N,4) of a picture. Raises IMAGE_TOO_LARGE, CAPTURE_UNREADABLE."""
    from PIL import Image

    name = folder.resolve(written, by=_META)
    data = read_bytes(folder.path(name), name)
    with translate_errors(name, "picture"), Image.open(BytesIO(data), formats=("WEBP",)) as image:
        width, height = check_pixels(image.size, name)
        if width * height < count:
            raise unreadable(name, say("has_fewer_pixels_than_splats", pixels=width * height, count=count))
        return np.asarray(image.convert("RGBA")).reshape(-1, 4)[:count]


def _between(given: Mapping[str, Any], shares: Floats) -> Floats:
    """Return the values (N,k) that are shares of the way from the least to the greatest of each column."""
    least, most = (np.array(given[end][: shares.shape[1]], np.float64) for end in ("mins", "maxs"))
    return np.asarray(least + (most - least) * shares)


def _listed(given: Mapping[str, Any], pixels: Bytes) -> tuple[Floats, Any]:
    """Return colours (N,3) as numbers of a list, and which are seen."""
    values = np.array(given["codebook"], np.float64)
    if values.ndim != 1:  # each pixel would be a list
        raise ValueError("its codebook is no list of numbers")
    return values[pixels[:, :3]], pixels[:, 3] >= LEAST_OPACITY * 255


def _shared(given: Mapping[str, Any], pixels: Bytes) -> tuple[Floats, Any]:
    """Return colours (N,3) as shares, and which are seen by their opacity's logit."""
    values = _between(given, pixels / 255)
    return values[:, :3], values[:, 3] >= np.log(LEAST_OPACITY / (1 - LEAST_OPACITY))
