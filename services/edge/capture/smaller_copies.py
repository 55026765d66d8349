"""Leave out the smaller copies of photos: thumbnails, `images_2` beside `images`, a JPEG beside its HEIC.

Copies have the name of their photo, in another folder or with another suffix, and show the same. Cameras that number
their photos alike do not: so a few of the pictures that two folders have under one name are compared.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations, islice

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.images import read_bytes, same_shape
from capture2vr.edge.capture.picture import PhotoPixels, read_header
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_SIDE = 32  # pixels of the pictures that are compared
_ALIKE = 8.0
"""Mean difference of their greys, of 255: a copy as a small JPEG is off by 2, the next photo by 20 and more."""
_COMPARED = 3  # photos of two folders
_MOST_SERIES = 100  # of pictures of one folder and suffix
_MOST_PAIRS = 20  # of folders that are compared: each takes up to half a second

_Series = Mapping[str, str]
"""Pictures of one folder and suffix: stem -> name."""


def without_copies(folder: Folder, names: Sequence[str]) -> tuple[list[str], tuple[str, ...]]:
    """Return the pictures without those that are smaller copies of others, and a warning where there are some."""
    series: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        stem, suffix = posixpath.splitext(name)
        series.setdefault((posixpath.dirname(name), suffix), {})[posixpath.basename(stem).lower()] = name
    copies: dict[str, str] = {}
    for one, other in islice(_sharing(list(series.values())), _MOST_PAIRS):
        larger, smaller = _by_size(folder, one, other)
        copies = {smaller[stem]: larger[stem] for stem in smaller.keys() & larger.keys()} | copies
    if not copies:
        return list(names), ()
    first = next(name for name in names if name in copies)
    warning = say("smaller_copies_left_out", count=len(copies), first=first, photo=copies[first])
    return [name for name in names if name not in copies], (warning,)


def _sharing(series: list[dict[str, str]]) -> Iterator[tuple[_Series, _Series]]:
    """Yield the pairs of series that have pictures of the same names."""
    return ((one, other) for one, other in combinations(series[:_MOST_SERIES], 2) if not one.keys().isdisjoint(other))


def _by_size(folder: Folder, one: _Series, other: _Series) -> tuple[_Series, _Series]:
    """Return the series of the larger pictures and that of their smaller copies; both empty where they are none."""
    shared = [stem for stem in one if stem in other]
    chosen = [shared[round(at)] for at in np.linspace(0, len(shared) - 1, min(_COMPARED, len(shared)))]
    balance = 0
    for stem in chosen:
        try:
            larger = _larger(folder, one[stem], other[stem])
        except CaptureError:  # it cannot be read, which is said of it as a photo
            return {}, {}
        if not larger:
            return {}, {}
        balance += larger
    return (one, other) if balance > 0 else (other, one)


def _larger(folder: Folder, one: str, other: str) -> int:
    """Return 1 where the first of two pictures that show the same is the larger, -1 for the second, 0 for others."""
    (width, height), turns, pixels = _picture(folder, one)
    (w, h), other_turns, other_pixels = _picture(folder, other)
    if not same_shape((width, height), (w, h)):
        return 0
    by_bytes = folder.path(one).stat().st_size >= folder.path(other).stat().st_size
    if (width, height) == (w, h) and posixpath.splitext(one)[1] == posixpath.splitext(other)[1]:
        return 0
    off = np.abs(_greys(pixels, turns) - _greys(other_pixels, other_turns)).mean()
    if off > _ALIKE:
        return 0
    return 1 if width * height > w * h or (width * height == w * h and by_bytes) else -1


def _picture(folder: Folder, name: str) -> tuple[tuple[int, int], int, PhotoPixels]:
    """Return a picture's upright size, its quarter turns to that, and its pixels, which are not yet decoded."""
    path = folder.path(name)
    header = read_header(path, name)
    pixels = PhotoPixels(partial(read_bytes, path, name), name, header.decoder, header.size, header.turned)
    return header.size[::-1] if header.turns % 2 else header.size, header.turns, pixels


def _greys(pixels: PhotoPixels, turns: int) -> Floats:
    """Return the upright picture's greys, 32 by 32."""
    import cv2

    small = cv2.resize(pixels(8 * _SIDE), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    return np.rot90(small.mean(axis=2), -turns)
