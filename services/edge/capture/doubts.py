"""Doubt what was read, where it is hardly what its writer meant: a sentence of each doubt, which never holds a job.

What a person can answer is in `order/questions.py`, by the codes of these sentences.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Cloud, Photo
from capture2vr.order.reading import FileReading
from capture2vr.sentences.sentence import say, with_values

_SOME = 100_000  # points that are looked at, in the file's order
_FEW = 0.01  # share of the points at either end that a few strays may be
_LONG = 100.0  # times the next side: no surface that anybody scans is so narrow, but a column of numbers is so long
_ONE_BY_ONE, _EVEN = 0.9, 1e-3  # share of equal steps in a coordinate that counts, and how equal they are
_DARK, _LIGHT = 12, 243  # codes up to which all colours are black, and from which on they are white
_OF_MATERIALS = ("glb", "gltf", "obj")  # formats whose materials may well be white
_FEET = re.compile(r"(?<![a-z])(ft|feet|foot|us-?ft)(?![a-z])", re.IGNORECASE)
_WIDE = 100.0  # degrees that a photo spans, from which on its lens is one for which few programs have a model


def doubts_about(capture: Capture, names: Sequence[str], reading: FileReading) -> tuple[str, ...]:
    """Return the doubts about a capture that was read from files of these names; nothing is doubted that a person
    said."""
    if capture.cloud is None:
        return tuple(_about_lenses(capture.photos))
    feet = not reading.unit and capture.scale_confidence != "metric" and any(map(_FEET.search, names))
    return (*_about_cloud(capture.cloud, capture, reading), *((say("doubt_feet"),) if feet else ()))


def _about_cloud(cloud: Cloud, capture: Capture, reading: FileReading) -> Iterator[str]:
    xyz = cloud.xyz[:_SOME] if capture.format == "xyz" else cloud.xyz[:: max(1, len(cloud.xyz) // _SOME)]
    low, high = np.quantile(xyz, (_FEW, 1 - _FEW), axis=0)
    second, longest = np.sort(high - low)[1:]
    if capture.format == "xyz" and not reading.columns:
        if any(map(_counts, xyz.T)):
            yield with_values(say("doubt_column_counts"), cloud.of_table)
        elif longest > _LONG * second:
            long = say("doubt_one_side_long", times=longest / max(second, 1e-300))
            yield with_values(long, cloud.of_table)
    if capture.format not in _OF_MATERIALS and cloud.rgb is not None and (alike := _alike(cloud)):
        yield alike


def _counts(values: Floats) -> bool:
    """Return whether a coordinate (N,) counts the points: it goes up by the same step, one after another."""
    step = np.diff(values)
    usual = float(np.median(step))
    even = np.abs(step - usual) < _EVEN * abs(usual)
    return len(step) > 2 and bool((step > 0).all() and even.mean() > _ONE_BY_ONE)


def _alike(cloud: Cloud) -> str | None:
    assert cloud.rgb is not None
    some = cloud.rgb[:: max(1, len(cloud.rgb) // _SOME)]
    if some.max() <= _DARK:
        return say("doubt_colours_black")
    return say("doubt_colours_white") if some.min() >= _LIGHT else None


def _about_lenses(photos: Sequence[Photo]) -> Iterator[str]:
    if flat := [photo.name for photo in photos if photo.size[0] == 2 * photo.size[1]]:
        yield say("doubt_two_to_one", count=len(flat), photo=flat[0])
    angles = {photo.name: _degrees_across(photo) for photo in photos}
    if wide := [name for name, angle in angles.items() if angle > _WIDE]:
        yield say("doubt_wide_lens", count=len(wide), photo=wide[0], degrees=angles[wide[0]])


def _degrees_across(photo: Photo) -> float:
    """Return the angle that a photo's longer side spans; 0 where its focal length is not known."""
    focal = photo.intrinsics.fx if photo.intrinsics else photo.focal_px
    return float(2 * np.degrees(np.arctan(max(photo.size) / 2 / focal))) if focal else 0.0
