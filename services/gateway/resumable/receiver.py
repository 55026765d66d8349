"""Receive one request's body as chunks of a resumable upload."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from starlette.requests import ClientDisconnect

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.capture_objects import put_private
from capture2vr.gateway.resumable.chunk_objects import chunk_name, join_chunks, small_tail
from capture2vr.gateway.resumable.protocol import MEDIA_TYPE, Checksum
from capture2vr.gateway.resumable.store import Chunk, Upload, UploadStore
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Part:
    """A request's body that goes on with an upload.

    before_chunk  called before each chunk is stored, with the bytes that it has; raises Problem to refuse it
    on_stored     called after each chunk with its bytes
    """

    batches: AsyncIterator[bytes]
    checksum: Checksum | None
    before_chunk: Callable[[int], Awaitable[None]]
    on_stored: Callable[[int], Awaitable[None]]


class Threads(Protocol):
    """What a receiver needs of `ResumableUploads`: its database, its threads, and where temporary files lie."""

    database: UploadStore
    chunk_bytes: int

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run a call of the upload store on a thread."""
        ...

    async def on_thread(self, work: Callable[[], _T]) -> _T:
        """Run a call of the object store or a write to the disk on a thread."""
        ...

    def new_spool(self) -> Path:
        """Return the path of a new temporary file for a chunk."""
        ...

    def expiry(self) -> float:
        """Return when an upload expires that has received bytes now."""
        ...


class Receiver:
    """Writes one request's body to chunks of an upload; what is small is joined with the small chunks before it.

    A joined chunk is an object of its own. The database puts it in the place of the others in one step, and only then
    their objects are deleted: whoever is killed in between leaves an object too many, which goes with the upload.
    """

    def __init__(self, uploads: Threads, upload: Upload, writer: str, part: Part, store: Store) -> None:
        self._uploads = uploads
        self._upload = upload
        self._writer = writer
        self._part = part
        self._store = store
        self._end = upload.received  # of what is in chunks on the store
        self._spool = uploads.new_spool()
        self._spooled = 0  # bytes
        self._held: list[Chunk] = []  # on the store, but not acknowledged yet
        self._acknowledged = upload.received
        self._replaced: Sequence[Chunk] = ()  # which the first held one is joined with
        self._hasher = part.checksum.hasher() if part.checksum else None

    async def receive(self) -> None:
        checksum = self._part.checksum
        failure = await self._fill()
        if failure is not None and checksum is not None:
            raise failure
        await self._store_chunk()
        if failure is not None:
            raise failure
        if checksum is not None and self._hasher is not None:
            checksum.check(self._hasher.digest())
            await self._acknowledge()

    async def _fill(self) -> Exception | None:
        """Receive the body; return what ended it early. What came before is good then."""
        batches = aiter(self._part.batches)
        while True:
            try:
                batch = await anext(batches)
            except StopAsyncIteration:
                return None
            except (Problem, ClientDisconnect) as failure:
                return failure
            if self._end + self._spooled + len(batch) > self._upload.length:
                return too_long(self._upload.length)
            await self._uploads.on_thread(partial(self._write, batch))
            if self._spooled >= self._uploads.chunk_bytes:
                await self._store_chunk()

    async def close(self) -> None:
        """Remove the temporary file, and chunks that were not acknowledged."""
        self._spool.unlink(missing_ok=True)
        await self._delete(self._held)

    async def _delete(self, chunks: Sequence[Chunk]) -> None:
        """Delete the objects of chunks that count no more.

        One that the store does not delete now goes with the upload's others, once it is finished or expires.
        """
        for chunk in chunks:
            name = chunk_name(self._upload.id, chunk)
            try:
                await self._uploads.on_thread(partial(self._store.delete, name))
            except OSError as error:
                _log.warning("%s is left on the store for now: %s", name, error)

    def _write(self, batch: bytes) -> None:
        with self._spool.open("ab") as file:
            file.write(batch)
        self._spooled += len(batch)
        if self._hasher is not None:
            self._hasher.update(batch)

    async def _store_chunk(self) -> None:
        """Store the spooled bytes as a chunk, and acknowledge it unless the checksum is still to be checked."""
        if not self._spooled:
            return
        await self._part.before_chunk(self._spooled)
        joined = await self._join_tail()
        chunk = Chunk(joined[0].start if joined else self._end, self._spooled + _size(joined), self._writer)
        self._held.append(chunk)  # before it is stored: on a failure it is deleted
        await self._uploads.on_thread(lambda: self._put(chunk))
        self._end, self._spooled = self._end + self._spooled, 0
        if self._part.checksum is None:
            await self._acknowledge()

    async def _join_tail(self) -> Sequence[Chunk]:
        """Put the bytes of the small chunks at the upload's end before those that are spooled; return these chunks.

        Only for a request's first bytes: what comes behind a chunk of the same request is behind a large one.
        """
        if self._end > self._upload.received:
            return ()
        database = self._uploads.database
        chunks = await self._uploads.run(lambda: database.chunks(self._upload.id))
        tail = small_tail(chunks, self._spooled, self._uploads.chunk_bytes // 2)
        if not tail:
            return ()
        joined = self._uploads.new_spool()
        try:
            await self._uploads.on_thread(partial(join_chunks, self._store, self._upload.id, tail, self._spool, joined))
            joined.replace(self._spool)
        except Problem as problem:
            if problem.code != "UPLOAD_DAMAGED":
                raise
            return ()  # somebody else goes on with the upload, and has joined them: then this chunk is refused
        finally:
            joined.unlink(missing_ok=True)
        self._replaced = tail
        return tail

    def _put(self, chunk: Chunk) -> None:
        put_private(self._store, chunk_name(self._upload.id, chunk), self._spool, MEDIA_TYPE)
        self._spool.unlink()  # the store may have a link to it: the next chunk is another file

    async def _acknowledge(self) -> None:
        """Acknowledge the chunks that are held. Raises Problem UPLOAD_LOCKED."""
        if not self._held:
            return
        # Not held while the database decides: were this cancelled just then, `close` would delete what is acknowledged.
        chunks, self._held = self._held, []
        database, expires, before = self._uploads.database, self._uploads.expiry(), self._acknowledged
        if not await self._uploads.run(lambda: database.append(self._upload.id, before, chunks, expires)):
            self._held = chunks
            raise locked(say("continued_by_another_request_meanwhile"))
        self._acknowledged = self._end
        replaced, self._replaced = self._replaced, ()
        await self._delete(replaced)
        await self._part.on_stored(self._end - before)


def _size(chunks: Sequence[Chunk]) -> int:
    return sum(chunk.length for chunk in chunks)


def too_long(length: int) -> Problem:
    """Return the problem for more bytes than an upload was created for, which is `length`."""
    detail = say("upload_has_bytes", length=length)
    return Problem(413, "UPLOAD_TOO_LONG", detail, hints=("ask with HEAD how far it is, and send the rest alone",))


def locked(why: str) -> Problem:
    """Return the problem for an upload that somebody else changes."""
    hints = (say("ask_with_head_how_far"),)
    detail = say("upload_cannot_be_changed_now", why=why)
    return Problem(423, "UPLOAD_LOCKED", detail, retryable=True, hints=hints, headers={"Retry-After": "2"})
