"""Receive a capture archive in contiguous chunks, written straight to a file: only one chunk is in memory."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.job_request import RefusedError, invalid
from capture2vr.edge.worker.scratch import translate_disk_errors
from capture2vr.sentences.sentence import say

IDLE_S = 30.0
"""Seconds without a chunk after which an upload is refused: it takes up a place in the queue."""


async def first_header(chunks: AsyncIterator[pb.Chunk], *, limit_bytes: int) -> pb.Header:
    """Read the header, the stream's first message. Raises RefusedError for another message or a wrong capture size."""
    chunk = await _next(chunks)
    if chunk is None or chunk.WhichOneof("part") != "header":
        raise invalid("UPLOAD_MALFORMED", "the first message must be the header")
    size = chunk.header.capture_bytes
    if size == 0:
        raise invalid("CAPTURE_EMPTY", "capture_bytes is 0")
    if size > limit_bytes:
        raise invalid("CAPTURE_TOO_LARGE", f"the capture has {size:,} bytes, this worker takes at most {limit_bytes:,}")
    return chunk.header


async def receive(chunks: AsyncIterator[pb.Chunk], into: Path, *, expected_bytes: int) -> None:
    """Write the data chunks to `into` up to the trailer, and check them against its sha256.

    Raises RefusedError: DATA_LOSS for a gap, an overlap, a wrong size or sha256, and for a stream that ends early;
    INVALID_ARGUMENT for a second header; RESOURCE_EXHAUSTED for a full disk; DEADLINE_EXCEEDED after IDLE_S without a
    chunk. Returns at the trailer without waiting for the caller to close its side: a caller that dies after the trailer
    has submitted the job.
    """
    digest = hashlib.sha256()
    received = 0
    with translate_disk_errors(), into.open("xb") as file:
        while (chunk := await _next(chunks)) is not None:
            match chunk.WhichOneof("part"):
                case "data":
                    _require_contiguous(chunk.data, received, expected_bytes)
                    await asyncio.to_thread(_write, file, digest, chunk.data.data)
                    received += len(chunk.data.data)
                case "trailer":
                    _require_complete(received, expected_bytes, digest.digest(), chunk.trailer.sha256)
                    return
                case _:
                    raise invalid("UPLOAD_MALFORMED", "after the header only data and one trailer may follow")
    raise _data_loss(f"the stream ended after {received:,} of {expected_bytes:,} bytes, without a trailer")


async def _next(chunks: AsyncIterator[pb.Chunk]) -> pb.Chunk | None:
    """Wait for the next chunk; None at the end of the stream. Raises RefusedError after IDLE_S."""
    try:
        async with asyncio.timeout(IDLE_S):
            return await anext(chunks, None)
    except TimeoutError:
        status = grpc.StatusCode.DEADLINE_EXCEEDED
        raise RefusedError(status, "UPLOAD_STALLED", say("no_chunk_arrived_s", seconds=IDLE_S)) from None


def _write(file: BinaryIO, digest: hashlib._Hash, data: bytes) -> None:
    """Write and hash a chunk, in a thread: a write that blocks on a full page cache must not delay the event loop."""
    file.write(data)
    digest.update(data)


def _require_contiguous(data: pb.Data, received: int, expected_bytes: int) -> None:
    if data.offset != received:
        raise _data_loss(f"a chunk has offset {data.offset:,}, expected {received:,}")
    if received + len(data.data) > expected_bytes:
        raise _data_loss(f"more bytes arrived than the {expected_bytes:,} of the header's capture_bytes")


def _require_complete(received: int, expected_bytes: int, digest: bytes, expected_digest: bytes) -> None:
    if received != expected_bytes:
        raise _data_loss(f"the trailer came after {received:,} of {expected_bytes:,} bytes")
    if digest != expected_digest:
        raise _data_loss(f"sha256 is {digest.hex()}, the trailer has {expected_digest.hex() or 'none'}")


def _data_loss(message: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.DATA_LOSS, "UPLOAD_CORRUPT", message)
