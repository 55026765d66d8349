"""A mark in a photo: which part of it shows the object, by a rectangle around it or a tap on it. The command line, the
HTTP API and the wire share it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from capture2vr.order.one_line import one_line

LEAST_SIDE = 0.01
"""Shortest side of a rectangle, as a share of the photo's: 40 pixels of a phone's photo; less is a slip of the hand."""

MOST_NAME = 200
"""Most characters of the photo's name, as in the lassos of a recipe."""

_PHOTO = ",photo="
"""Stands before the photo's name in a text."""
HOW = (
    "give left,top,right,bottom as shares of the upright photo's width and height, such as 0.2,0.1,0.8,0.95; "
    "or x,y of a place on the object, such as 0.5,0.6; "
    "of pixels, divide by the photo's width and height; of several photos, name the one that it is drawn in, such as "
    "0.2,0.1,0.8,0.95,photo=IMG_1.jpg"
)
"""What to do about a wrong rectangle."""


class InvalidBox(ValueError):  # noqa: N818 - it reads as what it is
    """A rectangle that is none. The message is a sentence for people: what is wrong, with the numbers."""


@dataclass(frozen=True, slots=True)
class PhotoBox:
    """A rectangle, as shares of the upright photo's width and height: (0, 0) is its top left corner, (1, 1) the bottom
    right one. Shares hold at every resolution; those of pixels are x / width and y / height. A tap on the object is a
    rectangle without extent.

    photo  file in the capture that it is drawn in; "": the first photo
    """

    left: float
    top: float
    right: float
    bottom: float
    photo: str = ""

    @classmethod
    def of(cls, values: Sequence[Any]) -> PhotoBox:
        """Make a rectangle of left, top, right, bottom, or a tap of x, y, and perhaps the photo's name.

        Raises InvalidBox where that is none inside a photo.
        """
        named = len(values) == 5 or (len(values) == 3 and isinstance(values[2], str))
        *sides, photo = values if named else (*values, "")
        if len(sides) not in (2, 4):
            raise InvalidBox(f"the rectangle has {len(values)} numbers instead of four")
        try:
            box = cls.unchecked([*sides, _checked_name(photo)])
        except (TypeError, ValueError) as error:
            raise InvalidBox(f"the rectangle is not four numbers, and perhaps a photo's name: {error}") from None
        if not all(map(math.isfinite, box.values)):
            raise InvalidBox(f"the rectangle {box} has numbers that are not finite")
        if min(box.values) < 0 or max(box.values) > 1:
            raise InvalidBox(f"the rectangle {box} reaches beyond the photo, whose sides go from 0 to 1")
        if not box.is_tap:
            box._require_extent()
        return box

    def _require_extent(self) -> None:
        if self.right <= self.left or self.bottom <= self.top:
            raise InvalidBox(f"the rectangle {self} is empty: its right must exceed its left, its bottom its top")
        if min(self.width, self.height) < LEAST_SIDE:
            raise InvalidBox(f"the rectangle {self} is narrower than {LEAST_SIDE:.0%} of the photo")

    @classmethod
    def unchecked(cls, values: Sequence[Any]) -> PhotoBox:
        """Make a rectangle or a tap of what `as_json` says. Raises TypeError and ValueError for what are no numbers."""
        count = 4 if len(values) > 3 else 2
        left, top, right, bottom = [*map(float, values[:count])] * (4 // count)
        return cls(left, top, right, bottom, *values[count:])

    @classmethod
    def parse(cls, text: str) -> PhotoBox:
        """Parse "left,top,right,bottom" or "x,y", and behind it perhaps ",photo=NAME". Raises InvalidBox."""
        numbers, _, photo = text.partition(_PHOTO)
        try:
            values = [float(part) for part in numbers.split(",")]
        except ValueError:
            raise InvalidBox(f"'{text}' is not four numbers with commas between them") from None
        return cls.of([*values, photo] if photo else values)

    @property
    def values(self) -> tuple[float, float, float, float]:
        """left, top, right, bottom."""
        return self.left, self.top, self.right, self.bottom

    @property
    def as_json(self) -> list[Any]:
        """What `of` makes the same rectangle from: left, top, right, bottom, and the photo's name where it has one."""
        return [*self.values, *filter(None, [self.photo])]

    @property
    def text(self) -> str:
        """What `parse` makes the same rectangle from."""
        return ",".join(map(repr, self._numbers)) + self._named

    @property
    def _numbers(self) -> tuple[float, ...]:
        return self.values[:2] if self.is_tap else self.values

    @property
    def _named(self) -> str:
        return _PHOTO + self.photo if self.photo else ""

    @property
    def is_tap(self) -> bool:
        """Whether it is a place on the object, not a rectangle around it."""
        return self.left == self.right and self.top == self.bottom

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
        return PhotoBox(left, top, min(1.0, self.right + dx), min(1.0, self.bottom + dy), self.photo)

    def __str__(self) -> str:
        """The form that `parse` reads, to three digits."""
        return ",".join(f"{value:.3g}" for value in self._numbers) + self._named


def _checked_name(photo: Any) -> str:
    """Return a photo's name unchanged. Raises ValueError for what is none."""
    if not isinstance(photo, str) or len(photo) > MOST_NAME:
        raise ValueError(f"a photo's name is a text of at most {MOST_NAME} characters")
    return one_line(photo)


WHOLE = PhotoBox(0.0, 0.0, 1.0, 1.0)
"""The whole photo."""
