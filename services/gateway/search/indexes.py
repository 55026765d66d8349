"""Search indexes of collections, in a folder of this gateway: made when they are first needed, limited in number and
size, and thrown away at any time.

A search never waits for a large index: it is made in a thread of its own, and until then the shards are read.
"""

from __future__ import annotations

import asyncio
import hashlib
import shutil
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from capture2vr.gateway.search.collection_index import BuildStopped, CollectionIndex, NoRoomForIndex, ReadListing
from capture2vr.gateway.search.known_roots import KnownRoots
from capture2vr.gateway.search.listing import FoundRows, Search
from capture2vr.gateway.search.scan import scan

SCANNED_ROWS = 2_000
"""Collections up to this size need no index: all their rows are read in some milliseconds."""
_MOST_FILES = 64
_UNUSED_S = 86_400.0  # then an index is deleted, so that labels which another gateway deletes do not stay here
_PERIOD_S = 3_600.0  # between two looks for unused ones
_SPARE_BYTES = 512 << 20  # that stay free on the disk, for the jobs database and uploads


class SearchIndexes:
    """The search indexes of a gateway. All methods but `keep` block, and may be called from any thread.

    folder      of no other process
    most_bytes  of all files together; 0: no indexes, each search reads the shards
    """

    def __init__(self, folder: Path, most_bytes: int) -> None:
        self._folder = folder
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._builder = ThreadPoolExecutor(1, "search-index")  # one at a time: requests need the other core
        self._closing = False
        self.roots = KnownRoots()
        self._indexes = {path.name: CollectionIndex(path) for path in folder.glob("*.db")}

    def close(self) -> None:
        """End what is being made; it goes on from there when it is next needed."""
        self._closing = True
        self._builder.shutdown(cancel_futures=True)

    def search(self, tenant: str, collection: str, read: ReadListing, search: Search) -> FoundRows:
        """Return a page of a tenant's collection, the same with an index and without.

        Raises FileNotFoundError, CatalogueFault, OSError of the store.
        """
        listing = read()
        if search.takes_all or listing.count <= SCANNED_ROWS or not self._most_bytes:
            return scan(listing, search)
        with self._using(_file_name(tenant, collection)) as index:
            found = index.find(search, listing.token)
            if found is None and index.catch_up(read):
                found = index.find(search, None)
            if found is None:
                self._build_soon(index, read)
        return found or scan(listing, search)

    def forget(self, tenant: str) -> None:
        """Delete a tenant's indexes; those in use once they are not."""
        with self._lock:
            for name, index in self._indexes.items():
                if name.startswith(_prefix(tenant)):
                    self._doom(index)

    def sweep(self) -> None:
        """Delete indexes that were not used for a day, and beyond the limits those that were used least recently."""
        oldest, room = time.time() - _UNUSED_S, self._most_bytes
        with self._lock:
            self._indexes = {name: index for name, index in self._indexes.items() if index.is_needed}
            order = sorted(self._indexes.values(), key=lambda index: (index.building, index.used), reverse=True)
            for number, index in enumerate(order):
                room -= index.size
                if not index.building and (index.used < oldest or room < 0 or number >= _MOST_FILES):
                    self._doom(index)

    async def keep(self) -> None:
        """Sweep every hour, until cancelled."""
        while True:
            await asyncio.to_thread(self.sweep)
            await asyncio.sleep(_PERIOD_S)

    @contextmanager
    def _using(self, name: str) -> Iterator[CollectionIndex]:
        """Keep an index's file from being deleted meanwhile."""
        with self._lock:
            index = self._indexes.setdefault(name, CollectionIndex(self._folder / name))
            index.users += 1
        try:
            yield index
        finally:
            self._release(index)

    def _release(self, index: CollectionIndex) -> None:
        with self._lock:
            index.users -= 1
            if index.is_doomed:
                self._doom(index)

    def _doom(self, index: CollectionIndex) -> None:
        index.is_doomed = True
        if index.users == 0:
            index.remove()

    def _build_soon(self, index: CollectionIndex, read: ReadListing) -> None:
        with self._lock:
            if self._closing or not index.may_change:
                return
            index.building = True
            index.users += 1
        self._builder.submit(self._build, index, read)

    def _build(self, index: CollectionIndex, read: ReadListing) -> None:
        try:
            index.make(read, lambda: self._pause(index))
        finally:
            index.building = False
            self._release(index)
            self.sweep()

    def _pause(self, index: CollectionIndex) -> None:
        """Let other threads have their turn. Raises BuildStopped, NoRoomForIndex."""
        if self._closing or index.is_doomed:
            raise BuildStopped
        size = index.size
        if size > self._most_bytes:
            raise NoRoomForIndex(f"it has {size:,} bytes, and GATEWAY_SEARCH_BYTES allows {self._most_bytes:,}")
        if shutil.disk_usage(self._folder).free < _SPARE_BYTES:
            raise NoRoomForIndex(f"the disk of {self._folder} is nearly full")
        time.sleep(0.002)


def _file_name(tenant: str, collection: str) -> str:
    return f"{_prefix(tenant)}{_hash(collection)}.db"


def _prefix(tenant: str) -> str:
    return f"{_hash(tenant)}-"


def _hash(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()[:24]
