"""What search takes of a collection, and a page of what it finds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from capture2vr.storage.catalogue.collection import Row, Shard
from capture2vr.storage.catalogue.reader import LoadRows
from capture2vr.storage.catalogue.row_filter import RowFilter


@dataclass(frozen=True, slots=True)
class CollectionListing:
    """A collection as its current signed index lists it.

    token   changes with every change of the index, such as the hash of its bytes
    count   rows in all
    leaves  returns the shards, in the order of their keys, that have keys behind one; "": all of them
    rows    reads the rows of a shard
    changed (token of an earlier root) -> the shards that this one lists no more, and those that it lists first; None
            where that root is not known any more
    """

    version: int
    token: str
    count: int
    leaves: Callable[[str], Iterable[Shard]]
    rows: LoadRows
    changed: Callable[[str], tuple[Sequence[Shard], Sequence[Shard]] | None] = lambda _: None


@dataclass(frozen=True, slots=True)
class Search:
    """Which rows are wanted: those that a filter accepts, of keys behind `after`, at most `limit`."""

    wanted: RowFilter
    after: str
    limit: int

    @property
    def takes_all(self) -> bool:
        """Whether every row is wanted that was not removed."""
        return self.wanted == RowFilter()


@dataclass(frozen=True, slots=True)
class FoundRows:
    """A page of rows, by key. version: of the index that lists them; next: `after` of the next page, None: no more."""

    version: int
    rows: tuple[Row, ...]
    next: str | None
