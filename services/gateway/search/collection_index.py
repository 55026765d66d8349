"""One collection's search index on the disk: answer from it, bring it up to date, and delete it once nobody uses it."""

from __future__ import annotations

import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from capture2vr.gateway.search.index_file import create_file, opened, read_meta, transaction
from capture2vr.gateway.search.listing import CollectionListing, FoundRows, Search
from capture2vr.gateway.search.query import find_rows
from capture2vr.gateway.search.updates import UnfitForIndex, build, difference, has, is_small, update
from capture2vr.process.private_files import private_folder
from capture2vr.storage.catalogue.faults import SHARD_MISSING, CatalogueFault

ReadListing = Callable[[], CollectionListing]
"""Reads a collection's current index from the store, and verifies it."""

_AGAIN_S = 3_600.0  # until an index that could not be made is tried again
_STORE_AGAIN_S = 60.0  # until a store that did not answer is asked again
_WAIT_S = 2.0  # for another request's small change of the same index
_TRIES = 10  # to make a large index, while shards are replaced
_BUSY = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)

_log = logging.getLogger(__name__)


class BuildStopped(Exception):  # noqa: N818 - nothing went wrong
    """The gateway ends, or the index is not wanted any more."""


class NoRoomForIndex(Exception):  # noqa: N818 - it reads as what it is
    """The index is larger than allowed, or the disk is nearly full."""


@dataclass(slots=True, eq=False)
class CollectionIndex:
    """An index's file, and who uses it.

    users      threads that may have the file open; it is deleted only when there is none
    is_doomed  it is deleted once nobody uses it
    building   a thread makes a large change
    again_at   when a change may be tried again after one that failed, on the monotonic clock
    """

    path: Path
    users: int = 0
    is_doomed: bool = False
    building: bool = False
    again_at: float = 0.0
    _changing: threading.Lock = field(default_factory=threading.Lock)

    @property
    def size(self) -> int:
        """Bytes on the disk."""
        return sum(path.stat().st_size for path in self._paths() if path.exists())

    @property
    def used(self) -> float:
        """Unix time of its last use; 0 where there is no file."""
        return self.path.stat().st_mtime if self.path.exists() else 0.0

    @property
    def is_needed(self) -> bool:
        """Whether there is anything to know about it: a file, a user, or when it may be tried again."""
        return self.users > 0 or self.path.exists() or time.monotonic() < self.again_at

    @property
    def may_change(self) -> bool:
        """Whether a change may begin."""
        return not self.building and not self.is_doomed and time.monotonic() >= self.again_at

    def find(self, search: Search, token: str | None) -> FoundRows | None:
        """Return a page from the file; None where it has not the index with this token (None: any that is whole)."""
        if not self.path.exists():
            return None
        try:
            with opened(self.path) as connection, transaction(connection, writes=False):
                stored, version = read_meta(connection)
                if not stored or token not in (None, stored):
                    return None
                rows = tuple(find_rows(connection, search))
        except sqlite3.Error as error:
            self._give_up(error)
            return None
        with suppress(FileNotFoundError):
            os.utime(self.path)
        return FoundRows(version, rows, rows[-1].key if len(rows) == search.limit else None)

    def catch_up(self, read: ReadListing) -> bool:
        """Make a small change that the file lacks. Returns False where it needs more than that, or cannot be changed.

        The collection's index is read once nobody else changes the file, so that no older one replaces a newer.
        Raises CatalogueFault, OSError.
        """
        if not self.path.exists() or not self.may_change or not self._changing.acquire(timeout=_WAIT_S):
            return False
        try:
            return self._catch_up(read())
        except (UnfitForIndex, sqlite3.Error) as error:
            self._give_up(error)
            return False
        finally:
            self._changing.release()

    def _catch_up(self, listing: CollectionListing) -> bool:
        with opened(self.path) as connection:
            stored, _ = read_meta(connection)
            if stored == listing.token:
                return True
            missing = difference(connection, listing)
            if not stored or not is_small(connection, missing):
                return False
            update(connection, listing, missing)
            return True

    def make(self, read: ReadListing, pause: Callable[[], None]) -> None:
        """Make the file, or a large change of it. `pause` is called now and then; what it raises ends this."""
        try:
            with self._changing:
                self._make(read, pause)
        except BuildStopped:
            pass
        except FileNotFoundError:  # the collection
            self.is_doomed = True
        except (UnfitForIndex, NoRoomForIndex, sqlite3.Error) as error:
            self._give_up(error)
        except (CatalogueFault, OSError) as error:  # of the store, which may answer later
            self.again_at = time.monotonic() + _STORE_AGAIN_S
            _log.warning("a search index is not complete, trying again in a minute: %s", error)

    def _make(self, read: ReadListing, pause: Callable[[], None]) -> None:
        if not self.path.exists():
            private_folder(self.path.parent)
            create_file(self.path)
        for tries_left in reversed(range(_TRIES)):
            listing = read()
            try:
                with opened(self.path) as connection:
                    if not has(connection, listing):
                        build(connection, listing, difference(connection, listing), pause)
                return
            except CatalogueFault as fault:
                if fault.code != SHARD_MISSING or not tries_left:
                    raise

    def _give_up(self, error: Exception) -> None:
        """Have the file deleted, and begin anew: at once where it was damaged, else after a while."""
        if getattr(error, "sqlite_errorcode", None) in _BUSY:
            return
        _log.warning("deleting a search index that cannot be used: %s: %s", type(error).__name__, error)
        self.is_doomed = True
        if not isinstance(error, sqlite3.DatabaseError) or isinstance(error, sqlite3.OperationalError):
            self.again_at = time.monotonic() + _AGAIN_S

    def remove(self) -> None:
        """Delete the file, which nobody may have open."""
        for path in self._paths():
            path.unlink(missing_ok=True)
        self.is_doomed = False

    def _paths(self) -> tuple[Path, ...]:
        return tuple(self.path.with_name(f"{self.path.name}{suffix}") for suffix in ("-wal", "-shm", ""))
