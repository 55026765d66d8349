"""A point cloud as a file has it, in parts: for files that are too large to be in memory at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats

LARGE = 4_000_000
"""Points from which on a file is read in parts: as many as a phone's longest scan, 100 MB."""
PART = 1_000_000
"""Most points of a part: 50 MB while they are decoded."""


@dataclass(frozen=True, slots=True)
class RawPart:
    """Some points: xyz (N,3) float64, perhaps not finite; colours (N,3) as stored, or None."""

    xyz: Floats
    colours: NDArray[Any] | None


@dataclass(frozen=True, slots=True)
class RawParts:
    """All points of a file: how many its header announces, a function that reads them anew, and warnings."""

    count: int
    read: Callable[[], Iterator[RawPart]]
    warnings: tuple[str, ...] = ()
