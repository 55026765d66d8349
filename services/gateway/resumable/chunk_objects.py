"""The bytes of resumable uploads on the store: objects whose names begin with the upload's id, one for each chunk.

Small chunks are joined. Names have no folder of an upload's own, because a local store would keep that for ever.
"""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.resumable.store import Chunk
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store, list_all

CHUNK_BYTES = 8 << 20
"""Bytes of a chunk: what a killed gateway can lose at most of what it received. S3 takes 0.1 s for so many."""
_READ_BYTES = 2 << 20  # at once: 32 uploads that are finished hold 64 MB


def chunk_name(upload: str, chunk: Chunk) -> str:
    """Return the object name of a chunk. Two writers never write the same one."""
    return f"{_prefix(upload)}{chunk.start:015d}.{chunk.writer}"


async def read_chunks(store: Store, upload: str, chunks: Sequence[Chunk]) -> AsyncIterator[bytes]:
    """Yield the bytes of an upload in batches. Raises Problem UPLOAD_DAMAGED, STORE_UNAVAILABLE."""
    for chunk in chunks:
        for start in range(0, chunk.length, _READ_BYTES):
            length = min(_READ_BYTES, chunk.length - start)
            yield await asyncio.to_thread(_read, store, chunk_name(upload, chunk), start, length)


def small_tail(chunks: Sequence[Chunk], added: int, least: int) -> Sequence[Chunk]:
    """Return the last chunks of an upload with which `added` bytes are to be joined, so that its objects stay few.

    least  bytes from which on a chunk is large, and is left as it is

    Joined are small chunks that are less than twice as large as what follows them. So small ones stand at the end
    alone, each at least twice as large as the next: of an upload there are never more than length / least + 23 objects,
    whatever its requests are. A joined byte is then in a chunk half as large again: it is written 38 times at
    most, and, where each request has one byte, 12 times.
    """
    start, size = len(chunks), added
    while start and chunks[start - 1].length < min(least, 2 * size):
        start -= 1
        size += chunks[start].length
    return chunks[start:]


def join_chunks(store: Store, upload: str, chunks: Sequence[Chunk], added: Path, joined: Path) -> None:
    """Write the bytes of chunks, and behind them those of the file `added`, to the file `joined`.

    Raises Problem UPLOAD_DAMAGED, STORE_UNAVAILABLE.
    """
    with joined.open("wb") as file:
        for chunk in chunks:
            for start in range(0, chunk.length, _READ_BYTES):
                length = min(_READ_BYTES, chunk.length - start)
                file.write(_read(store, chunk_name(upload, chunk), start, length))
        with added.open("rb") as rest:
            shutil.copyfileobj(rest, file, _READ_BYTES)


def delete_chunks(store: Store, upload: str) -> None:
    """Delete all objects of an upload, also those that were never acknowledged. Raises OSError."""
    for head in list_all(store, _prefix(upload)):
        store.delete(head.name)


def _read(store: Store, name: str, start: int, length: int) -> bytes:
    try:
        data = store.get(name, start=start, length=length)
    except FileNotFoundError:
        raise _damaged() from None
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", say("store_does_not_answer"), retryable=True) from error
    if len(data) != length:
        raise _damaged()
    return data


def _prefix(upload: str) -> str:
    return f"uploads/{upload}."


def _damaged() -> Problem:
    hints = (say("delete_upload_send_file_again"),)
    return Problem(409, "UPLOAD_DAMAGED", say("store_has_lost_part_upload"), hints=hints)
