"""The rectangle of a request: checked, with a problem document for one that is none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated

from fastapi import Query

from capture2vr.gateway.errors import Problem
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox
from capture2vr.sentences.sentence import say

BoxQuery = Annotated[
    str,
    Query(
        max_length=400,
        description="Rectangle around the object in a photo: left,top,right,bottom as shares of the upright photo's "
        "width and height, or x,y of a place on the object; of several photos behind it ,photo= and the file's name; "
        "empty: what stands out of a "
        "single photo, else the largest object near the middle.",
        examples=["0.2,0.1,0.8,0.95"],
    ),
]
"""The query parameter `box`."""


def parse_box(text: str) -> PhotoBox | None:
    """Parse the query parameter `box`; None where it is empty. Raises Problem BOX_INVALID."""
    with _as_problem():
        return PhotoBox.parse(text) if text else None


def require_box(values: Sequence[float | str] | None) -> None:
    """Check the field `box` of a job request, where it is given. Raises Problem BOX_INVALID."""
    with _as_problem():
        if values is not None:
            PhotoBox.of(values)


@contextmanager
def _as_problem() -> Iterator[None]:
    try:
        yield
    except InvalidBox as error:
        raise Problem(422, "BOX_INVALID", say("box_what", what=error), hints=(HOW,)) from None
