"""Receive a capture archive: contiguous chunks straight to a file, never more in memory than one chunk."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.requests import RefusedError, invalid
from services.edge.scratch import writing

IDLE_S = 30.0
"""Seconds without a chunk after which an upload is given up: it holds a place in the queue."""


async def first_header(chunks: AsyncIterator[pb.Chunk], *, limit_bytes: int) -> pb.Header:
    """The header that opens the stream. Raises RefusedError when there is none or the capture cannot be taken."""
    chunk = await _next(chunks)
    if chunk is None or chunk.WhichOneof("part") != "header":
        raise invalid("UPLOAD_MALFORMED", "the first message must be the header")
    size = chunk.header.capture_bytes
    if size == 0:
        raise invalid("CAPTURE_EMPTY", "capture_bytes is 0")
    if size > limit_bytes:
        raise invalid("CAPTURE_TOO_LARGE", f"the capture has {size:,} bytes, this worker takes {limit_bytes:,}")
    return chunk.header


async def receive(chunks: AsyncIterator[pb.Chunk], into: Path, *, expected_bytes: int) -> None:
    """Write the data chunks to `into` until the trailer, whose sha256 they must have.

    Raises RefusedError: DATA_LOSS for a gap, an overlap, a wrong size or sha256, and for a stream that ends early;
    INVALID_ARGUMENT for a second header; RESOURCE_EXHAUSTED for a full disk; DEADLINE_EXCEEDED after IDLE_S without a
    chunk. Returns at the trailer without waiting for the caller to close its side: one who dies after it has handed
    the job over.
    """
    digest = hashlib.sha256()
    received = 0
    with writing(), into.open("xb") as file:
        while (chunk := await _next(chunks)) is not None:
            match chunk.WhichOneof("part"):
                case "data":
                    _require_fit(chunk.data, received, expected_bytes)
                    await asyncio.to_thread(_take, file, digest, chunk.data.data)
                    received += len(chunk.data.data)
                case "trailer":
                    _require_whole(received, expected_bytes, digest.digest(), chunk.trailer.sha256)
                    return
                case _:
                    raise invalid("UPLOAD_MALFORMED", "after the header only data and one trailer may follow")
    raise _loss(f"the stream ended after {received:,} of {expected_bytes:,} bytes, without a trailer")


async def _next(chunks: AsyncIterator[pb.Chunk]) -> pb.Chunk | None:
    try:
        async with asyncio.timeout(IDLE_S):
            return await anext(chunks, None)
    except TimeoutError:
        status = grpc.StatusCode.DEADLINE_EXCEEDED
        raise RefusedError(status, "UPLOAD_STALLED", f"no chunk came for {IDLE_S:.0f} s") from None


def _take(file: BinaryIO, digest: hashlib._Hash, data: bytes) -> None:
    """Disk and hash off the event loop: a full page cache must not stop the other jobs' events."""
    file.write(data)
    digest.update(data)


def _require_fit(data: pb.Data, received: int, expected_bytes: int) -> None:
    if data.offset != received:
        raise _loss(f"a chunk says offset {data.offset:,} where {received:,} was due")
    if received + len(data.data) > expected_bytes:
        raise _loss(f"more than the {expected_bytes:,} bytes of the header arrived")


def _require_whole(received: int, expected_bytes: int, digest: bytes, told: bytes) -> None:
    if received != expected_bytes:
        raise _loss(f"the trailer came after {received:,} of {expected_bytes:,} bytes")
    if digest != told:
        raise _loss(f"sha256 is {digest.hex()}, the trailer says {told.hex() or 'nothing'}")


def _loss(message: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.DATA_LOSS, "UPLOAD_CORRUPT", message)
