"""How documents that move are replaced: under the etag they were read with, again until nobody came between."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import TypeVar

from services.storage.bundle import Json
from services.storage.store import NO_CACHE, ConditionFailed, Store

_T = TypeVar("_T")

_RACE_S = 60.0  # how long to keep trying against other publishers of the same document
_PAUSE_S = 0.02  # first pause after a lost race; doubles with jitter up to a second


def read_mutable(store: Store, name: str) -> tuple[bytes | None, str | None]:
    """A document and the etag to replace it under; None and None where there is none.

    The tag is read first: if a writer comes between, the tag is the older one and a put under it is refused.
    """
    try:
        etag = store.head(name).etag
        return store.get(name), etag
    except FileNotFoundError:
        return None, None


def put_mutable(store: Store, name: str, data: bytes, etag: str | None) -> None:
    """Replace the document read under `etag`, or create it where there was none. Raises ConditionFailed."""
    store.put(
        name,
        data,
        content_type="application/json",
        cache_control=NO_CACHE,
        if_match=etag,
        if_absent=etag is None,
    )


def until_won(attempt: Callable[[], _T]) -> _T:
    """Repeat read-and-replace until nobody came between. Raises OSError after a minute of lost races."""
    pause, deadline = _PAUSE_S, time.monotonic() + _RACE_S
    while True:
        try:
            return attempt()
        except ConditionFailed as lost:
            if time.monotonic() > deadline:
                raise OSError(f"too many publishers at once: {lost}") from None
            time.sleep(pause * random.uniform(0.5, 1.5))
            pause = min(2 * pause, 1.0)


def encoded(document: Mapping[str, Json]) -> bytes:
    """JSON in one way only: what is equal has equal bytes."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()


def now_iso() -> str:
    """The time in UTC, to the second: 2026-01-31T12:00:00Z."""
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
