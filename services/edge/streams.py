"""A call to another worker from a job's thread: what goes up, and what comes back, with no wait that cannot be left."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import grpc

from services.edge.api import edge_pb2 as pb

CHUNK_BYTES = 512 << 10  # the wire asks for 256 KiB to 1 MiB


class Broken(Exception):  # noqa: N818 - it reads as what it is
    """The stream ended before the run did."""

    def __init__(self, status: grpc.StatusCode | None, details: str) -> None:
        super().__init__(details)
        self.status = status


class Upload:
    """The chunks of an archive; nothing follows the header before the worker has admitted it."""

    def __init__(self, header: pb.Header, archive: Path) -> None:
        self.admitted = threading.Event()
        self.through = False
        self.moved_at = time.monotonic()
        self._header = header
        self._archive = archive

    def __iter__(self) -> Iterator[pb.Chunk]:
        yield pb.Chunk(header=self._header)
        self.admitted.wait()
        digest, offset = hashlib.sha256(), 0
        with self._archive.open("rb") as file:
            while data := file.read(CHUNK_BYTES):
                self.moved_at = time.monotonic()
                yield pb.Chunk(data=pb.Data(offset=offset, data=data))
                digest.update(data)
                offset += len(data)
        self.through = True  # before it is sent: from here on the job may have been taken
        yield pb.Chunk(trailer=pb.Trailer(sha256=digest.digest()))


class Stream:
    """Events of a call, read on a thread of their own: whoever waits for them must be able to look up."""

    def __init__(self, call: Any, upload: Upload | None = None) -> None:
        self.alive_at = time.monotonic()
        self._call = call
        self._upload = upload
        self._heard: SimpleQueue[pb.Event | Broken] = SimpleQueue()
        threading.Thread(target=self._read, name="relay", daemon=True).start()

    def next(self, within_s: float) -> pb.Event | None:
        """The next event, or None where there is none yet. Raises Broken behind the last."""
        try:
            heard = self._heard.get(timeout=within_s)
        except Empty:
            return None
        if isinstance(heard, Broken):
            raise heard
        return heard

    @property
    def admitted(self) -> bool:
        """Whether the worker has answered, if it is to answer first."""
        return self._upload is None or self._upload.admitted.is_set()

    def silent_s(self) -> float:
        """Seconds since anything moved either way."""
        moved = self._upload.moved_at if self._upload else 0.0
        return time.monotonic() - max(self.alive_at, moved)

    def close(self) -> None:
        self._call.cancel()
        if self._upload:
            self._upload.admitted.set()  # nobody waits for an admission that will not come

    def _read(self) -> None:
        try:
            if self._upload:
                self._call.initial_metadata()
                self._upload.admitted.set()
            for event in self._call:
                self.alive_at = time.monotonic()
                self._heard.put(event)
            self._heard.put(Broken(None, "the stream ended before the run did"))
        except grpc.RpcError as error:
            self._heard.put(Broken(error.code(), error.details() or error.code().name))
