"""Array types, and the two callables that stages pass to each other: a distance function and a progress tick.

Frames: *capture* is the frame and units of the files; *unit* has the bounding box centred at 0 with its longest side 1;
*asset* is metres, Y up, origin on the floor under the object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

Picked = TypeVar("Picked", bound=np.generic)
Item = TypeVar("Item")

DistanceFn = Callable[[Floats], tuple[Floats, Floats]]
"""(N,3) queries in the unit frame -> unsigned distance (N,), gradient (N,3)."""

Tick = Callable[[float], None]
"""Callback for progress and cancellation: called between parts of the work with the fraction done in [0,1]; raises
`Cancelled` to stop the work."""


def no_tick(fraction: float) -> None:
    """Ignore progress: the default `Tick` of a caller that neither shows progress nor cancels."""


def part_of(tick: Tick, start: float, end: float) -> Tick:
    """Return a tick for one part of the work: it maps that part's fraction to the range from `start` to `end`."""
    return lambda fraction: tick(start + (end - start) * fraction)


def evenly(items: Sequence[Item], most: int) -> Sequence[Item]:
    """Choose at most so many items, the first and then every second, third or so."""
    return items[:: max(1, -(-len(items) // most))]


def pick(rows: NDArray[Picked] | None, which: Bools | Ints) -> NDArray[Picked] | None:
    """Select rows by a mask or by indices: rows[which], or None if `rows` is None."""
    return None if rows is None else rows[which]


def smoothstep(value: Floats, bounds: tuple[float, float]) -> Floats:
    """Smoothstep: 0 below the first bound, 1 above the second, smooth in between."""
    t = np.clip((value - bounds[0]) / (bounds[1] - bounds[0]), 0, 1)
    smooth: Floats = t * t * (3 - 2 * t)
    return smooth
