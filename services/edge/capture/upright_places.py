"""Map positions in a picture as its file stores it to the upright picture that a person sees."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.picture import read_header


def turn_places(at: Floats, turns: int) -> Floats:
    """Turn positions (N,2), as shares of a picture's sides, clockwise by quarter turns, together with the picture."""
    x, y = at[:, 0], at[:, 1]
    return np.stack([(x, y), (1 - y, x), (1 - x, 1 - y), (y, 1 - x)][turns % 4], axis=1)


@dataclass(frozen=True, slots=True)
class StoredPlaces:
    """Maps positions (N,2) in a stored picture to the upright one, by the file's orientation tag.

    The tag is read when it is called, which raises IMAGE_UNREADABLE: captures have thousands of frames.
    """

    path: Path
    file: str

    def __call__(self, at: Floats) -> Floats:
        return turn_places(at, read_header(self.path, self.file).turns)
