"""`Store`: the interface of object stores. Named objects with content type, etag and conditional puts.

One contract test (tests/storage/test_contract.py) holds for every store.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol, runtime_checkable

# Values of Cache-Control.
IMMUTABLE = "public, max-age=31536000, immutable"  # a year, the longest that caches honour: names contain their sha256
NO_CACHE = "no-cache"  # caches may keep it, but must ask before every use: for catalogues and aliases, which change

# Characters that mean the same in a URL, a shell, an S3 key and a file name on every system. No segment begins with a
# dot, which excludes "..", hidden files and the local store's own folders. ext4's longest file name has 255 bytes.
_SEGMENT = r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}"
_NAME = re.compile(rf"{_SEGMENT}(/{_SEGMENT})*")
_NAME_LIMIT = 512  # characters: S3 takes 1,024 bytes; ours have about 150

LAST = "/~"
"""Added to a folder's name, it sorts behind all objects in the folder, which have no "~". `list` then skips them."""


class ConditionFailed(Exception):  # noqa: N818 - not a fault: somebody else was faster
    """A conditional put was refused: the object is not the one in `if_match`, or exists despite `if_absent`.

    Nothing was written, except where an earlier attempt succeeded and its answer was lost: so read the object again
    before concluding that somebody else wrote it.
    """


@dataclass(frozen=True, slots=True)
class Head:
    """Metadata of an object: size in bytes, etag opaque and unquoted, modified in UTC.

    In listings content_type and cache_control are empty, because S3 does not list them.
    """

    name: str
    size: int
    etag: str
    content_type: str
    cache_control: str
    modified: datetime


class Store(Protocol):
    """An object store. Methods raise FileNotFoundError for a missing object, ValueError for an invalid name, OSError
    where the backend cannot be reached.

    A put is atomic, and durable when it returns: a reader sees the old object or the new one, never a mix.
    """

    def put(
        self,
        name: str,
        data: bytes | Path,
        *,
        content_type: str,
        cache_control: str = IMMUTABLE,
        if_match: str | None = None,
        if_absent: bool = False,
        link: bool = False,
    ) -> Head:
        """Write an object. Raises ConditionFailed unless its etag is `if_match`, or it does not exist (`if_absent`).

        link  nobody will change the file at `data` any more, only delete it: a store may keep a hard link to it instead
              of a copy
        """
        ...

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        """Read at most `length` bytes from `start`; like a slice, fewer or none beyond the end."""
        ...

    def fetch(self, name: str, path: Path) -> None:
        """Download an object of any size into a file. On failure no file is left."""
        ...

    def head(self, name: str) -> Head:
        """Return the metadata of an object."""
        ...

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        """List at most `limit` objects whose names begin with `prefix` and come behind `after`.

        Names in one folder are in byte order. The folder `a` comes behind `a-b` where whole names are compared (AWS,
        and our own stores), and before it where the names of folders are (SeaweedFS).
        """
        ...

    def delete(self, name: str) -> None:
        """Delete an object. A missing one is no error, so that a clean-up can be repeated."""
        ...

    def url(self, name: str) -> str:
        """Return the URL where clients read the object without credentials."""
        ...


@runtime_checkable
class PresigningStore(Protocol):
    """A store that can let clients read private objects for a short time."""

    def presigned_url(self, name: str) -> str:
        """Return a URL that reads the object for a short time without credentials; "" where `url` is for clients."""
        ...


def check_name(name: str) -> str:
    """Return the name unchanged. Raises ValueError for one that no store accepts, including any path traversal."""
    if len(name) > _NAME_LIMIT or not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not a valid object name")
    return name


def list_all(store: Store, prefix: str, *, page: int = 1000) -> Iterator[Head]:
    """Yield every object under a prefix, fetching `page` at a time."""
    after = ""
    while heads := store.list(prefix, after=after, limit=page):
        yield from heads
        after = heads[-1].name
