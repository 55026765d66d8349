"""Where things of a scene are while somebody moves them. Nothing of it is stored: it is told to those who watch.

What a request brings is hostile until it has been validated; so is what another gateway sends, which may be newer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, TypeAdapter

from capture2vr.storage.scenes.scene import STRICT, ItemId, Position, Rotation, Scale, check_unit

MOST_MOVED = 8
"""Most things of one report: two hands hold two, and eight fit into a notification of Postgres, of 8,000 bytes."""


@dataclass(frozen=True, slots=True)
class MovedItem:
    """An object of an arrangement that is being moved. The fields are those of a `PlacedAsset`."""

    id: ItemId
    position_m: Position
    rotation: Rotation
    scale: Scale

    __pydantic_config__ = STRICT

    def __post_init__(self) -> None:
        check_unit(self.rotation)


@dataclass(frozen=True, slots=True)
class Moves:
    """What one device is moving. `sender`: a name that it has given itself, by which it knows its own reports again."""

    sender: ItemId
    items: Annotated[tuple[MovedItem, ...], Field(min_length=1, max_length=MOST_MOVED)]

    __pydantic_config__ = STRICT


_MOVES = TypeAdapter(Moves)


def moves_from_json(text: str) -> Moves:
    """Parse what another gateway has sent. Raises ValueError."""
    return _MOVES.validate_json(text)


def moves_as_json(moves: Moves) -> str:
    """Return what is sent to other gateways."""
    return _MOVES.dump_json(moves).decode()
