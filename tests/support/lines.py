"""A TCP line between a browser and a gateway that can be cut, fall silent, or stop in the middle of an answer."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from tests.support.patience import PATIENCE_S

Change = Callable[[str], str]


@dataclass
class Line:
    """A line to a gateway under an address of its own, because a browser's caches and workers belong to an address.

    `requests` has the paths that were asked for. Faults hold for paths in which their pattern is found.
    """

    to: tuple[str, int]
    requests: list[str] = field(default_factory=list)
    _silent: str | None = field(default=None, init=False)
    _stops: tuple[str, float] | None = field(default=None, init=False)
    _changes: list[tuple[str, Change]] = field(default_factory=list, init=False)
    _mended: threading.Event = field(default_factory=threading.Event, init=False)
    _met: threading.Event = field(default_factory=threading.Event, init=False)
    _listener: socket.socket = field(init=False)

    def __post_init__(self) -> None:
        self._listen(0)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    def cut(self) -> None:
        """Refuse all connections from now on."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def silence(self, pattern: str = "") -> None:
        """Accept requests and never answer them."""
        self._silent = pattern

    def stop_midway(self, pattern: str, after: float = 0.5) -> None:
        """Send this share of an answer's body, and then nothing more."""
        self._stops = (pattern, after)

    def await_fault(self) -> None:
        """Wait until a request has met the silence, or has got its share of an answer."""
        assert self._met.wait(PATIENCE_S), f"nothing met the fault; asked for were {self.requests}"

    def change(self, pattern: str, change: Change) -> None:
        """Change the text of answers."""
        self._changes.append((pattern, change))

    def mend(self) -> None:
        """End all faults and changes, time limits included; connections that hang are closed."""
        self._silent = self._stops = None
        self._changes.clear()
        self._mended.set()
        self._mended, self._met = threading.Event(), threading.Event()
        if self._listener.fileno() < 0:
            self._listen(self._port)

    def set_time_limits(self, **limits_ms: int) -> None:
        """Serve shared/time-limits.js with other values."""

        def replace(text: str) -> str:
            for name, value in limits_ms.items():
                text, count = re.subn(rf"(export const {name} =) [\d_]+;", rf"\1 {value};", text)
                assert count == 1, f"there is no time limit {name}"
            return text

        self.change("/shared/time-limits.js", replace)

    def asset_files(self) -> list[str]:
        """The levels of detail that were asked for since the last call."""
        requests, self.requests = self.requests, []
        return [path for path in requests if path.endswith(".glb")]

    def _listen(self, port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self._port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, args=(self._listener,), daemon=True).start()

    def _serve(self, listener: socket.socket) -> None:
        while True:
            try:
                client, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=self._answer, args=(client,), daemon=True).start()

    def _answer(self, client: socket.socket) -> None:
        """Answer one request: the connection is closed behind its answer, so that requests can be counted by heads."""
        with client:
            head = b""
            while b"\r\n\r\n" not in head:
                part = client.recv(65536)
                if not part:
                    return
                head += part
            path = head.split(b" ", 2)[1].decode()
            self.requests.append(path)
            mended, met, silent, stops = self._mended, self._met, self._silent, self._stops
            if silent is not None and re.search(silent, path):
                met.set()
                mended.wait()
                return
            with socket.create_connection(self.to) as server:
                changed = any(re.search(pattern, path) for pattern, _ in self._changes)
                stopped = bool(stops and re.search(stops[0], path))
                server.sendall(_plain(head, anew=changed or stopped))
                if stops and stopped:
                    answer = self._changed(path, _all(server))
                    body = answer.index(b"\r\n\r\n") + 4
                    client.sendall(answer[: body + int(stops[1] * (len(answer) - body))])
                    met.set()
                    mended.wait()
                elif changed:
                    client.sendall(self._changed(path, _all(server)))
                else:
                    _pump(client, server)

    def _changed(self, path: str, answer: bytes) -> bytes:
        head, _, body = answer.partition(b"\r\n\r\n")
        changes = [change for pattern, change in self._changes if re.search(pattern, path)]
        if not changes or not body:
            return answer
        text = body.decode()
        for change in changes:
            text = change(text)
        head = re.sub(rb"(?i)\r\n(etag|last-modified):[^\r]*", b"", head)  # the text as it was has other ones
        head = re.sub(rb"(?i)(content-length:) *\d+", rb"\1 %d" % len(text.encode()), head)
        return head + b"\r\n\r\n" + text.encode()


def line_to(url: str) -> Line:
    """A line to the gateway at this address."""
    parts = urlsplit(url)
    return Line((parts.hostname or "", parts.port or 0))


def _plain(request: bytes, *, anew: bool) -> bytes:
    """A request whose answer is not compressed, and ends with the connection; anew: never "not modified"."""
    head, _, body = request.partition(b"\r\n\r\n")
    dropped = (b"connection:", b"accept-encoding:", *((b"if-none-match:", b"if-modified-since:") if anew else ()))
    first, *lines = [line for line in head.split(b"\r\n") if not line.lower().startswith(dropped)]
    return b"\r\n".join([first, b"Connection: close", *lines]) + b"\r\n\r\n" + body


def _all(server: socket.socket) -> bytes:
    parts = []
    while part := server.recv(65536):
        parts.append(part)
    return b"".join(parts)


def _pump(client: socket.socket, server: socket.socket) -> None:
    """Pass on the rest of a request while its answer is passed back."""

    def forward() -> None:
        try:
            while part := client.recv(65536):
                server.sendall(part)
        except OSError:
            return

    threading.Thread(target=forward, daemon=True).start()
    try:
        while part := server.recv(65536):
            client.sendall(part)
    except OSError:
        return
