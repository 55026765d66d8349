"""Visibility of assets and collections: who may read them besides their tenant, and which lists show them.

An asset has a visibility of its own, or that of the collections that list it. A collection without one has the
gateway's default. Stored in the asset's catalogue entry, and in the collection's signed index.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class Visibility(StrEnum):
    """Who may read something besides its tenant."""

    PRIVATE = "private"
    """Nobody, but for those to whom it is shared."""
    UNLISTED = "unlisted"
    """Whoever has its address; no list of others shows it."""
    PUBLIC = "public"
    """Everybody, also the pages of other sites; public collections list it."""


_WIDER = (Visibility.PRIVATE, Visibility.UNLISTED, Visibility.PUBLIC)


def parse_visibility(stored: object) -> Visibility | None:
    """Convert a stored value; None where there is none. One that is not known is private: it cannot be less."""
    if stored is None or stored == "":
        return None
    try:
        return Visibility(str(stored))
    except ValueError:
        return Visibility.PRIVATE


def effective(own: Visibility | None, of_collections: Iterable[Visibility | None]) -> Visibility | None:
    """Return an asset's visibility: its own, else the widest of its collections'; None: the gateway's default."""
    if own is not None:
        return own
    return max((each for each in of_collections if each is not None), key=_WIDER.index, default=None)


def is_open(visibility: Visibility | None) -> bool:
    """Return whether others may read it: it is public or unlisted."""
    return visibility in (Visibility.PUBLIC, Visibility.UNLISTED)


def lists(collection: Visibility | None, asset: Visibility | None) -> bool:
    """Return whether a collection of this visibility lists an asset with this one of its own.

    The tenant's own collections list everything. One that others may read leaves out what is private or unlisted.
    """
    return not is_open(collection) or asset in (None, Visibility.PUBLIC)
