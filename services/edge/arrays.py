"""The array types and the two callables that stages hand each other.

Frames: *capture* is the frame and units of the files; *unit* has the bounding box centred at 0 with its longest side 1;
*asset* is metres, Y up, origin on the floor under the object.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

DistanceFn = Callable[[Floats], tuple[Floats, Floats]]
"""(N,3) queries in the unit frame -> unsigned distance (N,), gradient (N,3)."""

Tick = Callable[[float], None]
"""Called between slabs with the fraction done in [0,1]; raises `Cancelled` to stop the work."""


def no_tick(fraction: float) -> None:
    """The tick of a caller who neither watches nor cancels."""
