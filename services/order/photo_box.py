"""A rectangle in a photo: which part of it shows the thing. The command line, the HTTP API and the wire share it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

LEAST_SIDE = 0.01
"""Shortest side of a rectangle, as a share of the photo's: 40 pixels of a phone's photo; less is a slip of the hand."""

HOW = (
    "give left,top,right,bottom as shares of the upright photo's width and height, such as 0.2,0.1,0.8,0.95; "
    "of pixels, divide by the photo's width and height"
)
"""What to do about a wrong rectangle."""


class InvalidBox(ValueError):  # noqa: N818 - it reads as what it is
    """A rectangle that is none. The message is a sentence for people: what is wrong, with the numbers."""


@dataclass(frozen=True, slots=True)
class PhotoBox:
    """A rectangle, as shares of the upright photo's width and height: (0, 0) is its top left corner, (1, 1) the bottom
    right one. Shares hold at every resolution; those of pixels are x / width and y / height.
    """

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def of(cls, values: Sequence[float]) -> PhotoBox:
        """Make a rectangle of left, top, right, bottom. Raises InvalidBox where that is none inside the photo."""
        if len(values) != 4:
            raise InvalidBox(f"the rectangle has {len(values)} numbers instead of four")
        box = cls(*map(float, values))
        if not all(math.isfinite(value) for value in values):
            raise InvalidBox(f"the rectangle {box} has numbers that are not finite")
        if min(values) < 0 or max(values) > 1:
            raise InvalidBox(f"the rectangle {box} reaches beyond the photo, whose sides go from 0 to 1")
        if box.right <= box.left or box.bottom <= box.top:
            raise InvalidBox(f"the rectangle {box} is empty: its right must exceed its left, its bottom its top")
        if min(box.width, box.height) < LEAST_SIDE:
            raise InvalidBox(f"the rectangle {box} is narrower than {LEAST_SIDE:.0%} of the photo")
        return box

    @classmethod
    def parse(cls, text: str) -> PhotoBox:
        """Parse "left,top,right,bottom". Raises InvalidBox."""
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            raise InvalidBox(f"'{text}' is not four numbers with commas between them") from None
        return cls.of(values)

    @property
    def values(self) -> tuple[float, float, float, float]:
        """left, top, right, bottom."""
        left, top, right, bottom = astuple(self)
        return left, top, right, bottom

    @property
    def width(self) -> float:
        """Share of the photo's width."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Share of the photo's height."""
        return self.bottom - self.top

    def grown(self, share: float) -> PhotoBox:
        """Return the rectangle, larger on every side by this share of its own width and height, inside the photo."""
        dx, dy = share * self.width, share * self.height
        left, top = max(0.0, self.left - dx), max(0.0, self.top - dy)
        return PhotoBox(left, top, min(1.0, self.right + dx), min(1.0, self.bottom + dy))

    def __str__(self) -> str:
        """The form that `parse` reads, to three digits."""
        return ",".join(f"{value:.3g}" for value in self.values)


WHOLE = PhotoBox(0.0, 0.0, 1.0, 1.0)
"""The whole photo."""
