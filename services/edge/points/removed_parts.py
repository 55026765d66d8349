"""Find what a cut has removed that may belong to the object.

A cut removes surroundings; whoever took the photos is asked only about what may not be any. Bare ground, which reaches
far beyond the object, and what is farther away than the cameras are never asked about. Three parts are:

below    a connected part below the supporting plane: a boulder or a pedestal whose top was taken for the ground
support  points of the plane itself, where it ends with the object: a plinth, the slice of a boulder
beside   a separate part over the plane
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.points.outliers import label_components
from capture2vr.edge.points.plane import Plane
from capture2vr.sentences.sentence import say

_LARGE_BASE, _LARGE_APART = 0.1, 0.4
"""Least points of a removed part, over the points kept, that a person is asked about: of one under the object,
and of one that stands beside it."""
_NEAR_SUPPORT = 1.25
"""Farthest that a support reaches from the object's middle, over the object itself: a plinth, a stand. Beyond it is a
table or a floor, of which photos of a statue showed 1.4 and of fruit 2.1 times the thing."""
_UNDER = 3.0
"""Depth below the plane, over the half slab, from which on points are not its noise."""
_BESIDE = say("separate_part_beside_thing")
_BELOW = say("part_below_plane_on_thing")
_SUPPORT = say("what_thing_stands_on_ends")


@dataclass(frozen=True, slots=True)
class _Part:
    """A removed part: what it is, for people, its points over those kept, and the least of it worth a question."""

    what: str
    share: float
    least: float


def largest_doubt(
    xyz: Floats, thing: Bools, near: Bools, plane: Plane | None, half_slab: float, link: float
) -> tuple[str, float]:
    """Find the largest removed part that may belong to the object: a sentence about it, and its share; "", 0 without.

    xyz (N,3); thing (N,) what was kept; near (N,) what is no farther away than the cameras; plane: what was removed as
    the support, half_slab thick on both sides; link: distance between connected points.
    """
    gone = near & ~thing
    parts = [*_apart(xyz, thing, gone, plane, half_slab, link)]
    if plane is not None:
        parts += _support(xyz, thing, gone, plane, half_slab)
    large = [part for part in parts if part.share >= part.least]
    if not large:
        return "", 0.0
    worst = max(large, key=lambda part: part.share)
    return say("removed_has_as_many_points", what=worst.what, share=worst.share), worst.share


def _apart(
    xyz: Floats, thing: Bools, gone: Bools, plane: Plane | None, half_slab: float, link: float
) -> Iterator[_Part]:
    """Yield the largest connected parts that were removed over the plane and below it."""
    heights = np.full(len(xyz), np.inf) if plane is None else plane.height(xyz)
    over, below = gone & (heights > half_slab), gone & (heights < -_UNDER * half_slab)
    for which, what, least in ((over, _BESIDE, _LARGE_APART), (below, _BELOW, _LARGE_BASE)):
        if which.any():
            size = np.bincount(label_components(xyz[which], link)).max()
            yield _Part(what, float(size / thing.sum()), least)


def _support(xyz: Floats, thing: Bools, gone: Bools, plane: Plane, half_slab: float) -> Iterator[_Part]:
    """Yield the points on the plane, where these end near the object."""
    heights = plane.height(xyz)
    on = gone & (np.abs(heights) <= half_slab)
    aside = xyz - heights[:, None] * plane.normal
    away = np.linalg.norm(aside - np.median(aside[thing], axis=0), axis=1)
    if on.any() and np.percentile(away[on], 95) < _NEAR_SUPPORT * np.percentile(away[thing], 95):
        yield _Part(_SUPPORT, float(on.sum() / thing.sum()), _LARGE_BASE)
