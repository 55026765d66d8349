"""Collections of a few rows, cut into leaves, as search reads them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from capture2vr.gateway.search.collection_index import CollectionIndex
from capture2vr.gateway.search.listing import CollectionListing, FoundRows, Search
from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.catalogue.collection import Row, Shard
from capture2vr.storage.catalogue.faults import SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.row_filter import RowFilter

Leaves = Sequence[Sequence[Row]]


def row_named(key: str, label: str = "", *tags: str, updated: int = 0, size: int = 1, state: str = "refined") -> Row:
    """A row of this key."""
    return Row(key, label, tags, 1, state, updated, "ab" * 32, "", size, "good")


def listing_of(leaves: Leaves, version: int = 1) -> CollectionListing:
    """A collection with these leaves."""
    shards = {_shard(rows): tuple(rows) for rows in leaves}
    return CollectionListing(
        version=version,
        token=f"version {version}",
        count=sum(map(len, leaves)),
        leaves=lambda after: (shard for shard in shards if shard.last > after),
        rows=shards.__getitem__,
    )


def _shard(rows: Sequence[Row]) -> Shard:
    sha256 = sha256_hex(repr(rows).encode())
    return Shard(f"shard.{sha256}.json", sha256, 1, len(rows), rows[0].key, rows[-1].key)


def gone(_: Shard) -> tuple[Row, ...]:
    """A leaf that another publisher has replaced."""
    raise CatalogueFault(SHARD_MISSING, "shard", "it is not on the store")


def expected(leaves: Leaves, wanted: RowFilter, after: str = "", limit: int = 100) -> tuple[Row, ...]:
    """What the filter accepts of all rows."""
    behind = (row for rows in leaves for row in rows if row.key > after and wanted.accepts(row))
    return tuple(islice(behind, limit))


def all_pages(index: CollectionIndex, token: str, wanted: RowFilter, limit: int) -> tuple[Row, ...]:
    """All rows that an index finds, page by page."""
    found: list[Row] = []
    after: str | None = ""
    while after is not None:
        page = index.find(Search(wanted, after, limit), token)
        assert isinstance(page, FoundRows)
        found += page.rows
        after = page.next
    return tuple(found)
