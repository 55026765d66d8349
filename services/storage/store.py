"""The `Store` seam: named objects with a content type, an etag and conditional puts. One contract test for all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

IMMUTABLE = "public, max-age=31536000, immutable"  # a year, the longest that caches honour: names contain their sha256
NO_CACHE = "no-cache"  # keep, but ask before every use: catalogues and aliases move

# Letters that mean the same in a URL, a shell, an S3 key and a file name on every system. No segment begins with a dot,
# which shuts out "..", hidden files and the local store's own folders. 255 bytes is the longest file name of ext4.
_SEGMENT = r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}"
_NAME = re.compile(rf"{_SEGMENT}(/{_SEGMENT})*")
_NAME_LIMIT = 512  # S3 takes 1,024 bytes; ours stay near 150


class ConditionFailed(Exception):  # noqa: N818 - not a fault: somebody else was faster
    """`if_match` or `if_absent` did not hold; nothing was written.

    After a lost answer the store may refuse a put that did succeed, so read again before concluding who won.
    """


@dataclass(frozen=True, slots=True)
class Head:
    """What a store knows about an object: size in bytes, etag opaque and unquoted, modified in UTC.

    In listings content_type and cache_control are empty: S3 does not list them.
    """

    name: str
    size: int
    etag: str
    content_type: str
    cache_control: str
    modified: datetime


class Store(Protocol):
    """Objects by name. Absent is FileNotFoundError, an impossible name ValueError, an unreachable backend OSError.

    A put is all or nothing and durable when it returns; a reader sees the old object or the new one, never a mix.
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
    ) -> Head:
        """Write an object. Raises ConditionFailed unless its etag is `if_match`, or there is none (`if_absent`)."""
        ...

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        """Bytes from `start`, as a slice gives them: fewer or none beyond the end."""
        ...

    def fetch(self, name: str, path: Path) -> None:
        """Stream an object into a file, whatever its size. On failure the file is not there."""
        ...

    def head(self, name: str) -> Head: ...

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        """At most `limit` objects, in the byte order of their names, that come behind `after`."""
        ...

    def delete(self, name: str) -> None:
        """Remove an object; an absent one is no error, so that a repeated clean-up is none either."""
        ...

    def url(self, name: str) -> str:
        """Where a client reads it without credentials."""
        ...

    def upload_url(self, name: str, *, expires_s: int) -> str:
        """Where a client may PUT it for a while. Raises io.UnsupportedOperation where there is no such address."""
        ...


def check_name(name: str) -> str:
    """The name itself. Raises ValueError for one that no store takes, which covers every kind of path traversal."""
    if len(name) > _NAME_LIMIT or not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no object name")
    return name


def list_all(store: Store, prefix: str, *, page: int = 1000) -> Iterator[Head]:
    """Every object under a prefix, page by page."""
    after = ""
    while heads := store.list(prefix, after=after, limit=page):
        yield from heads
        after = heads[-1].name
