"""Ask a server that makes a mesh from a picture, by trellis-server's two routes: GET /health and POST /generate.

Its operator names it; nothing that a request says does. What it answers is hostile until it has been read: it is taken
to a file up to a limit of bytes and of time, without redirects, and without proxies from the environment.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import closing, suppress
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from pathlib import Path
from secrets import token_hex
from socket import SHUT_RDWR, socket
from typing import TypeVar
from urllib.parse import urlsplit

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.errors import EdgeError
from capture2vr.sentences.sentence import say

_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?|[0-9a-f:.]+", re.ASCII)
_CONNECT_S = 10.0
_POLL_S = 0.1  # between two ticks: the longest time that a cancelled job still waits
_HALF_WAY_S = 60.0  # after which the progress, which nobody reports, is shown as one half
_BLOCK = 1 << 16
_MAGIC, _HEADER = b"glTF", 12  # of a GLB: magic, version, length of the whole file
_QUOTED = 200  # characters of an error that are told

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class _Question:
    """A request: its method, route, body and header fields."""

    method: str
    route: str
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class GeneratorServer:
    """A generator at the origin `url`, such as http://127.0.0.1:8080.

    most_s      seconds that it may take to make a mesh, with those that other pictures make it wait
    health_s    seconds that it may take to say that it is there
    most_bytes  of a mesh's file
    """

    url: str
    most_s: float = 1800.0
    health_s: float = 10.0
    most_bytes: int = 1 << 28

    @classmethod
    def at(cls, url: str) -> GeneratorServer | None:
        """Return the generator at an address; None for "". Raises ValueError for what is none of a server alone."""
        if not url:
            return None
        place = urlsplit(url)  # whose port raises it too
        fits = place.scheme in ("http", "https") and _HOST.fullmatch(place.hostname or "") and place.port != 0
        if not fits or "@" in place.netloc or place.path not in ("", "/") or place.query or place.fragment:
            raise ValueError("must be http://host:port or https://host:port, as in http://127.0.0.1:8080")
        return cls(f"{place.scheme}://{place.netloc}")

    def generate(self, png: bytes, target: Path, tick: Tick = no_tick) -> None:
        """Have a mesh made from a picture, and write the answer to `target`: it has the head of a GLB, and its length.

        Raises EdgeError GENERATOR_UNAVAILABLE where nobody answers or who does is not ready, GENERATOR_FAILED where it
        refuses, takes too long, or answers with something else; and within a fraction of a second what `tick` raises.
        """
        self._ask(self.health_s, no_tick, _Question("GET", "/health"), _require_health)
        boundary = token_hex(16)
        head = f'--{boundary}\r\nContent-Disposition: form-data; name="image"; filename="image.png"\r\n'
        body = f"{head}Content-Type: image/png\r\n\r\n".encode() + png + f"\r\n--{boundary}--\r\n".encode()
        kind = {"Content-Type": f"multipart/form-data; boundary={boundary}", "Accept": "model/gltf-binary"}
        question = _Question("POST", "/generate", body, kind)
        self._ask(self.most_s, tick, question, lambda answer: self._save(answer, target))

    def _save(self, answer: HTTPResponse, target: Path) -> None:
        """Write a GLB to a file. Raises GENERATOR_FAILED for what is none, is too large, or is cut off."""
        if answer.status != 200:
            raise failed(say("generator_refused", status=answer.status, why=_quoted(answer.read(_QUOTED * 4))))
        if (answer.length or 0) > self.most_bytes:
            raise self._too_large()
        size, announced = 0, _HEADER
        with target.open("wb") as file:
            while block := answer.read(_BLOCK):
                if not size:
                    announced = _announced(block)
                size += len(block)
                if size > self.most_bytes:
                    raise self._too_large()
                file.write(block)
        if not size:
            raise failed(say("generator_no_glb"))
        if size < announced:
            raise failed(say("generator_cut_off", count=size, size=announced))

    def _too_large(self) -> EdgeError:
        return failed(say("generator_too_large", size=max(1, self.most_bytes >> 20)))

    def _ask(self, most_s: float, tick: Tick, question: _Question, read: Callable[[HTTPResponse], Answer]) -> Answer:
        """Send a request in a thread, whose connection is shut when time is up or `tick` raises."""
        asked, found = _Asked(self._connection()), Future[Answer]()
        threading.Thread(target=asked.run, args=(found, question, read), daemon=True).start()
        began = time.monotonic()
        try:
            while (elapsed := time.monotonic() - began) < most_s:
                tick(elapsed / (elapsed + _HALF_WAY_S))
                wait([found], min(_POLL_S, most_s - elapsed))
                if found.done():
                    return found.result()
        except (OSError, HTTPException) as error:
            raise unavailable(say("generator_not_reached", why=_quoted(str(error).encode()))) from None
        finally:
            asked.stop()
        raise failed(say("generator_too_slow", seconds=most_s), retryable=True)

    def _connection(self) -> HTTPConnection:
        place = urlsplit(self.url)
        kind = HTTPSConnection if place.scheme == "https" else HTTPConnection
        return kind(place.hostname or "", place.port, timeout=_CONNECT_S)


class _Asked:
    """A request on its way, which another thread may stop."""

    def __init__(self, connection: HTTPConnection) -> None:
        self._connection = connection
        self._socket: socket | None = None  # the connection forgets it once the answer has begun
        self._stopped = False

    def run(self, found: Future[Answer], question: _Question, read: Callable[[HTTPResponse], Answer]) -> None:
        """Send the request, read the answer, and tell what came of it."""
        try:
            self._connection.connect()
            self._socket = self._connection.sock
            self._connection.sock.settimeout(None)
            if self._stopped:
                return
            self._connection.request(question.method, question.route, question.body or None, question.headers)
            with closing(self._connection.getresponse()) as answer:
                found.set_result(read(answer))
        except BaseException as error:  # noqa: BLE001 - whatever it is, the thread that waits must be told
            found.set_exception(error)
        finally:
            self._connection.close()

    def stop(self) -> None:
        """Wake whatever waits for the other side."""
        self._stopped = True
        if self._socket is not None:
            with suppress(OSError):
                self._socket.shutdown(SHUT_RDWR)


def _require_health(answer: HTTPResponse) -> None:
    if answer.status != 200:
        raise unavailable(say("generator_not_ready", status=answer.status))


def _announced(block: bytes) -> int:
    """The length that the head of a GLB announces. Raises GENERATOR_FAILED for another file's."""
    if not block.startswith(_MAGIC):
        raise failed(say("generator_no_glb"))
    return max(_HEADER, int.from_bytes(block[8:_HEADER], "little"))


def _quoted(text: bytes) -> str:
    """What another server says, on one line."""
    shown = "".join(each if each.isprintable() else " " for each in text.decode("utf-8", "replace"))
    return " ".join(shown.split())[:_QUOTED] or "-"


def unavailable(what: str) -> EdgeError:
    """Return the error that a generator cannot be asked now."""
    return EdgeError("GENERATOR_UNAVAILABLE", what, hints=(say("start_generator"),), retryable=True)


def failed(what: str, *, retryable: bool = False) -> EdgeError:
    """Return the error that a generator was asked, and gave no mesh."""
    return EdgeError("GENERATOR_FAILED", what, hints=(say("see_generator_log"),), retryable=retryable)
