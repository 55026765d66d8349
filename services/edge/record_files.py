"""Files of records of one kind, which are read in parts: they may be larger than memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PART = 1_000_000
"""Most records of a part: of points, some 50 MB."""


def records_in_parts(path: Path, kind: np.dtype[Any]) -> Iterator[NDArray[Any]]:
    """Yield the records of a file, in order, in arrays of at most PART."""
    with path.open("rb") as stream:
        while len(records := np.fromfile(stream, kind, PART)):
            yield records
