"""Stored captures: their object names, lists of them, deletion, and reading one with a few megabytes in memory."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import time
from collections.abc import AsyncGenerator, Callable
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_FOLDER = "captures/"
_LISTED = 200  # objects per request to the store
_READ_BYTES = 4 << 20  # one request to an S3 server; its latency is then small beside the transfer


def new_capture() -> str:
    """Return the id of a new capture. It begins with the time, so that ids sort by age."""
    return f"cap_{int(time.time() * 1000):012x}{secrets.token_hex(8)}"


def put_private(store: Store, name: str, data: bytes | Path, content_type: str) -> None:
    """Write an object that only this service reads; a file is not to be changed afterwards.

    Raises Problem STORE_UNAVAILABLE, OSError on a full disk.
    """
    try:
        store.put(name, data, content_type=content_type, cache_control="private, no-store", link=True)
    except OSError as error:
        if is_disk_full(error):
            raise
        detail = say("capture_could_not_be_written")
        raise Problem(503, "STORE_UNAVAILABLE", detail, retryable=True) from error


def capture_name(capture: str) -> str:
    """Return the object name of a capture's archive."""
    return f"{_FOLDER}{capture}.zip"


def receipt_name(capture: str) -> str:
    """Return the object name of a capture's receipt: the JSON answer to its upload."""
    return f"{_FOLDER}{capture}.json"


def unknown_capture(capture: str) -> Problem:
    """Return the problem for a capture that is not stored."""
    hints = (say("upload_first_with_post_v1"),)
    return Problem(404, "CAPTURE_UNKNOWN", say("no_capture", capture=capture), hints=hints)


def list_captures(
    store: Store, parse: Callable[[dict[str, Any]], _T], *, after: str, limit: int
) -> tuple[list[_T], list[str]]:
    """Read at most `limit` receipts of captures whose ids sort behind `after`; also the ids of damaged receipts.

    parse  converts a receipt; raises ValueError for one that is none

    Ids begin with the time of the upload, so the oldest comes first. Raises OSError, ValueError (`after` is no id).
    """
    found: list[_T] = []
    damaged: list[str] = []
    name = capture_name(after) if after else ""
    while len(found) < limit and (heads := store.list(_FOLDER, after=name, limit=_LISTED)):
        for head in heads:
            name = head.name
            if not name.endswith(".json"):
                continue
            if len(found) == limit:
                break
            try:
                found.append(parse(_read_receipt(store, PurePosixPath(name).stem)))
            except FileNotFoundError:
                continue  # deleted since it was listed
            except ValueError as fault:
                _log.warning("%s is not listed: %s", name, fault)
                damaged.append(PurePosixPath(name).stem)
    return found, damaged


def read_receipt(store: Store, parse: Callable[[dict[str, Any]], _T], capture: str) -> _T:
    """Read a capture's receipt, converted as in `list_captures`.

    Raises Problem CAPTURE_UNKNOWN, CAPTURE_DAMAGED; OSError.
    """
    try:
        store.head(receipt_name(capture))
    except (FileNotFoundError, ValueError):
        raise unknown_capture(capture) from None
    try:
        return parse(_read_receipt(store, capture))
    except FileNotFoundError:  # deleted meanwhile
        raise unknown_capture(capture) from None
    except ValueError:
        hints = (say("delete_capture_upload_again"),)
        raise Problem(503, "CAPTURE_DAMAGED", say("receipt_damaged", capture=capture), hints=hints) from None


def _read_receipt(store: Store, capture: str) -> dict[str, Any]:
    """Raises ValueError for a receipt that is not the JSON object of this capture."""
    receipt = json.loads(store.get(receipt_name(capture)))
    if not isinstance(receipt, dict) or receipt.get("capture") != capture:
        raise ValueError("it is not the receipt of this capture")
    return receipt


def delete_capture(store: Store, capture: str) -> int:
    """Delete a capture's archive and its receipt for good; return their bytes.

    The archive goes first: after a crash in between, the capture is still listed and can be deleted again.
    Raises Problem CAPTURE_UNKNOWN, OSError.
    """
    freed = 0
    for name in (capture_name(capture), receipt_name(capture)):
        try:
            freed += store.head(name).size
        except (FileNotFoundError, ValueError):
            continue
        store.delete(name)
    if not freed:
        raise unknown_capture(capture)
    return freed


def is_stored(store: Store, capture: str) -> bool:
    """Return whether a capture is stored as a whole. Raises OSError."""
    try:
        store.head(receipt_name(capture))
    except FileNotFoundError:
        return False
    return True


def delete_unfinished(store: Store, capture: str) -> None:
    """Delete the archive of a capture that has no receipt. Raises OSError."""
    if not is_stored(store, capture):
        store.delete(capture_name(capture))


async def capture_bytes(store: Store, capture: str) -> int:
    """Return the size of a capture's archive in bytes. Raises FileNotFoundError, ValueError (invalid id), OSError."""
    return (await asyncio.to_thread(store.head, capture_name(capture))).size


async def object_chunks(store: Store, name: str, start: int, end: int, chunk_bytes: int) -> AsyncGenerator[bytes, None]:
    """Yield an object's bytes from `start` up to `end` in chunks of at most `chunk_bytes`. Raises OSError."""
    for at in range(start, end, _READ_BYTES):
        block = await asyncio.to_thread(store.get, name, start=at, length=min(_READ_BYTES, end - at))
        for offset in range(0, len(block), chunk_bytes):
            yield block[offset : offset + chunk_bytes]
