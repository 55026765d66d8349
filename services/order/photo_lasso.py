"""A lasso: a closed line in a photo, around what a recipe leaves out of a capture, or around what it keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, Strict

from capture2vr.order.json_numbers import array_schema, require_number

MOST_LASSOS = 30
"""Most lines of a recipe. With `MOST_CORNERS` and names of 200 characters they stay below the most bytes of one."""
FEWEST_CORNERS, MOST_CORNERS = 3, 64
"""Corners of a line. A finger's line that is thinned to 64 stays within a hundredth of the photo's width."""
_DIGITS = 4
"""Decimals of a corner, as a share of a side: 0.4 pixels of a phone's photo. It bounds a recipe's bytes."""
_LEAST_SIDE = 0.002
"""Shortest side of the rectangle around a line, as a share of the photo's: less is a slip of the hand."""


def _round_share(value: float) -> float:
    return round(value, _DIGITS)


Share = Annotated[float, BeforeValidator(require_number), Field(ge=0, le=1), AfterValidator(_round_share)]
Corner = Annotated[tuple[Share, Share], array_schema(2, 1, least=0)]


@dataclass(frozen=True, slots=True)
class PhotoLasso:
    """A closed line in one photo. What is left out are the points that this photo shows inside of it.

    photo    its file in the capture
    line     corners (x, y) as shares of the upright photo's width and height: (0, 0) is its top left corner. The last
             is joined to the first. Where the line crosses itself, inside is what it goes round an odd number of times
    keeps    whether what is inside is kept instead, and what this photo shows outside of all such lines is left out
    through  whether what is hidden in this photo, behind what it shows there, is left out too
    """

    photo: Annotated[str, Field(min_length=1, max_length=200)]
    line: Annotated[tuple[Corner, ...], Field(min_length=FEWEST_CORNERS, max_length=MOST_CORNERS)]
    keeps: Annotated[bool, Strict()] = False
    through: Annotated[bool, Strict()] = False

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    def __post_init__(self) -> None:
        for axis, side in enumerate(("width", "height")):
            places = [corner[axis] for corner in self.line]
            if max(places) - min(places) < _LEAST_SIDE:
                raise ValueError(
                    f"the line in {self.photo} goes round nothing: its corners span less than {_LEAST_SIDE:.1%} of the "
                    f"photo's {side}. Draw it around something, or leave it out"
                )
