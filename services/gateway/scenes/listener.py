"""What a listener of a scene has not been told yet."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from capture2vr.gateway.scenes.moves import MovedItem, Moves
from capture2vr.storage.scenes.scene import MOST_ITEMS


@dataclass(slots=True, eq=False)
class Listener:
    """One event stream. Of each thing that is moved it keeps the newest place only, however slowly its client reads.

    client  who listens: streams are counted for each
    news    is set whenever there is something to tell
    """

    client: str
    news: asyncio.Event = field(default_factory=asyncio.Event)
    _is_stale: bool = True  # whether the scene has to be read: at first it has
    _moved: dict[str, tuple[str, MovedItem]] = field(default_factory=dict)

    def change(self) -> None:
        """Queue the event that the arrangement has changed."""
        self._is_stale = True
        self.news.set()

    def move(self, moves: Moves) -> None:
        """Note where things are now. Things beyond as many as a scene has are made up, and left out."""
        for item in moves.items:
            if item.id in self._moved or len(self._moved) < MOST_ITEMS:
                self._moved[item.id] = (moves.sender, item)
        self.news.set()

    def take_change(self) -> bool:
        """Return whether the scene has changed since the last call."""
        was_stale, self._is_stale = self._is_stale, False
        return was_stale

    def take_moves(self) -> list[tuple[str, MovedItem]]:
        """Return the things that were moved since the last call, each with its sender."""
        moved, self._moved = self._moved, {}
        return list(moved.values())
