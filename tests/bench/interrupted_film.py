"""A film of a gigabyte is sent to two gateways with one database and one store, and cut twenty times on its way.

Every other cut is a connection that breaks off; the others are a `kill -9` of the gateway that receives it, which comes
back while the other one goes on. One more gateway is killed while it makes the capture.
"""

from __future__ import annotations

import hashlib
import os
import random
import socket
import struct
import tempfile
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from capture2vr.cli.up import free_port
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import list_all
from tests.support.photos.private_pictures import box, handler
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.tus import PART, TUS, metadata
from tests.support.workers.inspecting_worker import inspecting_worker

_BLOCK_BYTES = 1 << 20
_PATIENCE_S = 600.0


def write_film(path: Path, size: int) -> str:
    """Write a film of about this size, with pictures of random bytes; its SHA-256."""
    start = box(b"ftyp", b"isom", bytes(4))
    end = box(b"moov", box(b"mvhd", bytes(100)), box(b"trak", box(b"tkhd", bytes(20)), handler(b"vide")))
    digest = hashlib.sha256()
    with path.open("wb") as file:
        blocks = size // _BLOCK_BYTES
        for part in (start, struct.pack(">I4s", 8 + blocks * _BLOCK_BYTES, b"mdat")):
            file.write(part)
            digest.update(part)
        for _ in range(blocks):
            block = os.urandom(_BLOCK_BYTES)
            file.write(block)
            digest.update(block)
        file.write(end)
        digest.update(end)
    return digest.hexdigest()


def film_with_cuts(megabytes: int, cuts: int) -> Iterator[tuple[str, str]]:
    """Send the film, and say what arrived."""
    with tempfile.TemporaryDirectory(prefix="bench-film-") as name:
        folder = Path(name)
        sha256 = write_film(folder / "film.mp4", megabytes << 20)
        with _Gateways(folder) as gateways:
            began = time.monotonic()
            sender = _Sender(gateways, folder / "film.mp4")
            for number in range(1, cuts + 1):
                sender.send_until_cut(int(sender.size * number / (cuts + 1)), kill=number % 2 == 0)
            sender.send_rest()
            sent = time.monotonic() - began
            receipt = sender.finish()
            yield "film", f"{sender.size / 1e6:.0f} MB, {cuts} cuts"
            yield "kill -9 of a gateway", f"{gateways.kills}, the last while it made the capture"
            yield "sent after, and a capture after", f"{sent:.0f} s, {time.monotonic() - began:.0f} s"
            yield "sent more than once", f"{100 * (sender.sent / sender.size - 1):.1f} % of its bytes"
            stored = _stored(gateways.store, receipt["capture"], folder)
            yield "SHA-256 of what is stored", "equal" if stored == sha256 else f"{stored}, and not {sha256}"
            captures = gateways.ask("GET", "/v1/captures").json()["captures"]
            yield "captures", f"{len(captures)} (1 wanted)"
            deadline = time.monotonic() + _PATIENCE_S
            while (left := len(list(list_all(gateways.store, "uploads/")))) and time.monotonic() < deadline:
                time.sleep(0.1)
            yield "chunks left on the store", f"{left} (0 wanted)"


class _Gateways:
    """Two gateway processes on one database and one store."""

    def __init__(self, folder: Path) -> None:
        self.store = LocalStore(folder / "objects")
        self.ports = [free_port(), free_port()]
        self.kills = 0
        self._processes = [
            ServiceProcess(
                "capture2vr.gateway",
                folder / f"gateway{number}.log",
                GATEWAY_PORT=port,
                GATEWAY_DATA_DIR=folder / f"gateway{number}",
                GATEWAY_DATABASE_URL=f"sqlite:///{folder / 'gateway.db'}",
                GATEWAY_WORKERS=inspecting_worker(),
                GATEWAY_LOG_LEVEL="WARNING",
                STORAGE_ROOT=folder / "objects",
            )
            for number, port in enumerate(self.ports)
        ]
        self._client = httpx.Client(timeout=_PATIENCE_S)

    def __enter__(self) -> _Gateways:
        self._end = killed_at_the_end(*self._processes)
        self._end.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._client.close()
        self._end.__exit__(*error)

    def kill(self, number: int) -> None:
        """Kill a gateway, and start it again."""
        self._processes[number].kill()
        self._processes[number].start()
        self.kills += 1

    def connect(self, number: int) -> socket.socket:
        """Open a connection to a gateway, which may just be starting."""
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return socket.create_connection(("127.0.0.1", self.ports[number]), timeout=_PATIENCE_S)
            except ConnectionRefusedError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)

    def ask(self, method: str, path: str, **options: Any) -> httpx.Response:
        """The answer of the first gateway that gives one."""
        deadline = time.monotonic() + _PATIENCE_S
        for turn in range(10**9):
            with suppress(httpx.TransportError):
                answer = self._client.request(method, f"http://127.0.0.1:{self.ports[turn % 2]}{path}", **options)
                if answer.status_code not in (423, 503):
                    return answer
            if time.monotonic() > deadline:
                break
            time.sleep(0.1)
        raise AssertionError(f"no gateway answered {path}")


class _Sender:
    """Sends a file by tus, with cuts. sent: bytes that went out, again or not"""

    def __init__(self, gateways: _Gateways, path: Path) -> None:
        self.size, self.sent = path.stat().st_size, 0
        self._gateways, self._path = gateways, path
        self._chance = random.Random(0)
        headers = {**TUS, "Upload-Length": str(self.size), "Upload-Metadata": metadata({"filename": path.name})}
        self._upload = gateways.ask("POST", "/v1/uploads", headers=headers).headers["Location"]

    def send_until_cut(self, end: int, *, kill: bool) -> None:
        """Send up to about this byte; there the connection breaks off, or the gateway is killed."""
        number = self._chance.randrange(2)
        offset = self._offset()
        end = max(offset, end + self._chance.randrange(-_BLOCK_BYTES, _BLOCK_BYTES))
        with suppress(OSError), self._connection(number, offset) as connection:
            self._send_bytes(connection, offset, end)
            if kill:
                self._gateways.kill(number)

    def send_rest(self) -> None:
        """Send until all has arrived."""
        while (offset := self._offset()) < self.size:
            with suppress(OSError), self._connection(self._chance.randrange(2), offset) as connection:
                self._send_bytes(connection, offset, self.size)
                connection.recv(1000)

    def finish(self) -> Any:
        """Ask for the capture, kill the gateway that makes it, and ask again."""
        client = threading.Thread(target=self._ask_in_vain)
        client.start()
        time.sleep(1.0)
        self._gateways.kill(0)
        client.join()
        return self._gateways.ask("POST", f"{self._upload}/capture").raise_for_status().json()

    def _ask_in_vain(self) -> None:
        with suppress(httpx.TransportError):
            httpx.post(f"http://127.0.0.1:{self._gateways.ports[0]}{self._upload}/capture", timeout=_PATIENCE_S)

    def _offset(self) -> int:
        answer = self._gateways.ask("HEAD", self._upload, headers=TUS)
        return int(answer.headers["Upload-Offset"])

    def _connection(self, number: int, offset: int) -> socket.socket:
        connection = self._gateways.connect(number)
        told = {**TUS, "Host": "127.0.0.1", "Content-Type": PART, "Upload-Offset": str(offset)}
        told["Content-Length"] = str(self.size - offset)
        head = "".join(f"{name}: {value}\r\n" for name, value in told.items())
        connection.sendall(f"PATCH {self._upload} HTTP/1.1\r\n{head}\r\n".encode())
        return connection

    def _send_bytes(self, connection: socket.socket, start: int, end: int) -> None:
        with self._path.open("rb") as file:
            file.seek(start)
            while start < end:
                block = file.read(min(_BLOCK_BYTES, end - start))
                connection.sendall(block)
                start += len(block)
                self.sent += len(block)


def _stored(store: LocalStore, capture: str, folder: Path) -> str:
    """SHA-256 of the one file of a capture."""
    store.fetch(f"captures/{capture}.zip", folder / "stored.zip")
    with zipfile.ZipFile(folder / "stored.zip") as archive:
        (name,) = archive.namelist()
        with archive.open(name) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
