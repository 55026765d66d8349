"""Search a collection without an index: read its shards one by one, for a limited time."""

from __future__ import annotations

import time
from collections.abc import Callable

from capture2vr.gateway.search.listing import CollectionListing, FoundRows, Search
from capture2vr.storage.catalogue.collection import Row

SCAN_S = 2.0
"""A page that takes longer ends early: people see the first of what is found, and no proxy gives up."""


def scan(listing: CollectionListing, search: Search, *, clock: Callable[[], float] = time.monotonic) -> FoundRows:
    """Read the shards behind `after` until a page is full or the time is up; a page may then be short or empty.

    Its `next` is the last key that was looked at, so that no row is passed over. Raises CatalogueFault.
    """
    found: list[Row] = []
    end = clock() + SCAN_S
    for shard in listing.leaves(search.after):
        last = search.after
        for row in listing.rows(shard):
            last = max(last, row.key)
            if row.key > search.after and search.wanted.accepts(row):
                found.append(row)
                if len(found) == search.limit:
                    return FoundRows(listing.version, tuple(found), row.key)
        if clock() > end and last > search.after:
            return FoundRows(listing.version, tuple(found), last)
    return FoundRows(listing.version, tuple(found), None)
