"""Object names of stored captures, and reading one as a stream with only a few megabytes in memory."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator

from services.storage.store import Store

_READ_BYTES = 4 << 20  # one request to an S3 server; its latency is then small beside the transfer


def capture_name(capture: str) -> str:
    """Return the object name of a capture's archive."""
    return f"captures/{capture}.zip"


def receipt_name(capture: str) -> str:
    """Return the object name of a capture's receipt: the JSON answer to its upload."""
    return f"captures/{capture}.json"


async def capture_bytes(store: Store, capture: str) -> int:
    """Return the size of a capture's archive in bytes. Raises FileNotFoundError, ValueError (invalid id), OSError."""
    return (await asyncio.to_thread(store.head, capture_name(capture))).size


async def capture_chunks(store: Store, capture: str, size: int, chunk_bytes: int) -> AsyncGenerator[bytes, None]:
    """Yield the archive in chunks of at most `chunk_bytes`. Raises OSError."""
    name = capture_name(capture)
    for start in range(0, size, _READ_BYTES):
        block = await asyncio.to_thread(store.get, name, start=start, length=_READ_BYTES)
        for offset in range(0, len(block), chunk_bytes):
            yield block[offset : offset + chunk_bytes]
