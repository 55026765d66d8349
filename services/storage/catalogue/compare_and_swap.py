"""Compare-and-swap of mutable JSON documents: write only if the etag is unchanged since the read, else retry."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import TypeVar

from capture2vr.storage.bundle import Json
from capture2vr.storage.store import NO_CACHE, ConditionFailed, Store

_T = TypeVar("_T")

_RACE_S = 60.0  # how long to retry against other writers of the same document
_PAUSE_S = 0.02  # first pause after a conflict; doubles with jitter up to a second


def read_mutable(store: Store, name: str) -> tuple[bytes | None, str | None]:
    """Read a document and its etag, to be passed to `put_mutable`; (None, None) where it does not exist.

    The etag is read first: if somebody writes between the two reads, the etag is the older one and the put is refused.
    """
    try:
        etag = store.head(name).etag
        return store.get(name), etag
    except FileNotFoundError:
        return None, None


def etag_of(store: Store, name: str) -> str | None:
    """Return the etag of an object; None where it does not exist."""
    try:
        return store.head(name).etag
    except FileNotFoundError:
        return None


def put_mutable(store: Store, name: str, data: bytes, etag: str | None) -> None:
    """Replace a document if its etag is still `etag`; create it if `etag` is None. Raises ConditionFailed."""
    store.put(
        name,
        data,
        content_type="application/json",
        cache_control=NO_CACHE,
        if_match=etag,
        if_absent=etag is None,
    )


def retry_on_conflict(attempt: Callable[[], _T]) -> _T:
    """Call `attempt` until it raises no ConditionFailed. Raises OSError after a minute of conflicts."""
    pause, deadline = _PAUSE_S, time.monotonic() + _RACE_S
    while True:
        try:
            return attempt()
        except ConditionFailed as conflict:
            if time.monotonic() > deadline:
                raise OSError(f"too many processes write the same document: {conflict}; try again") from None
            time.sleep(pause * random.uniform(0.5, 1.5))
            pause = min(2 * pause, 1.0)


def canonical_json(document: Mapping[str, Json]) -> bytes:
    """Encode as canonical JSON (sorted keys, no spaces): equal documents give equal bytes."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()


def now_iso() -> str:
    """Return the present time in UTC, to the second: 2026-01-31T12:00:00Z."""
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
