"""A web server for clients under test: it serves folders, and misbehaves on request."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.support.patience import HANG_S

_DELAY_S = 0.25  # of a slow answer: enough for other loads to begin meanwhile
_DRIP_S = 0.5  # between pieces: six of them take longer than a client waits for any one of them


class Site:
    """The first part of a path says how the rest below `root` is served.

    www      as it is
    slow     after a while
    flip     with one bit changed
    cut      only half, with the length of the whole
    drip     in pieces, with a while between them
    stall    only half, and then nothing until the client leaves
    endless  twice, without a length
    busy     not at all: 503
    live     as it is, below the folder that `turn/<folder>` named last; `turn/off` is 503
    keyed    as `live`, to whom shows the key "Bearer good"; others get 401
    away     by a redirection to `bare` at another host's name, as to a private bucket
    bare     as `live`, to whom shows no key; others get 400, as from presigned URLs
    count    how often the rest was asked for, with the way in front

    What is refused is answered with a page that is longer than the files.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.counts: Counter[str] = Counter()
        self.live = "off"

    def content(self, path: str) -> bytes | None:
        """What is below the root; the folders `healed` and `once` are other names of `v2`, to count by."""
        folder, _, name = path.partition("/")
        file = self.root / {"healed": "v2", "once": "v2"}.get(folder, folder) / name
        return file.read_bytes() if file.is_file() else None

    def answer(self, way: str, rest: str, key: str) -> tuple[int, bytes, int | None]:
        """Status, body, and the length to announce."""
        if way == "count":
            return _whole(str(self.counts[rest]).encode())
        if way == "turn":
            self.live = rest
            return _whole(b"")
        self.counts[f"{way}/{rest}"] += 1
        if way == "keyed" and key != "Bearer good":
            return _page(401)
        if way == "away":
            return 307, b"", 0
        if way == "bare" and key:
            return _page(400)
        is_live = way in ("live", "keyed", "bare")
        data = self.content(f"{self.live}/{rest}" if is_live else rest)
        if way == "busy" or (is_live and self.live == "off"):
            return _page(503)
        return _page(404) if data is None else _spoilt(way, data)


def _page(status: int) -> tuple[int, bytes, int | None]:
    page = b"<p>No</p>" * 20_000
    return status, page, len(page)


def _whole(data: bytes) -> tuple[int, bytes, int | None]:
    return 200, data, len(data)


def _spoilt(way: str, data: bytes) -> tuple[int, bytes, int | None]:
    if way == "slow":
        time.sleep(_DELAY_S)
    if way == "flip":
        middle = len(data) // 2
        data = data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :]
    if way in ("cut", "stall"):
        return 200, data[: len(data) // 2], len(data)
    return (200, data * 2, None) if way == "endless" else _whole(data)


def _pieces(body: bytes) -> Iterator[bytes]:
    step = len(body) // 6
    for start in range(0, len(body), step):
        yield body[start : start + step]
        time.sleep(_DRIP_S)


@contextmanager
def serving(root: Path, site: Site | None = None) -> Iterator[str]:
    """The address of a running site."""
    site = site or Site(root)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            _, way, rest = self.path.split("/", 2)
            key = self.headers.get("Authorization", "") + self.headers.get("X-Key", "")
            status, body, length = site.answer(way, rest, key)
            self.send_response(status)
            if status == 307:
                self.send_header("Location", f"http://localhost:{server.server_address[1]}/bare/{rest}")
            if length is not None:
                self.send_header("Content-Length", str(length))
            self.end_headers()
            for piece in _pieces(body) if way == "drip" else [body]:
                self.wfile.write(piece)
            if way == "stall":
                self.connection.settimeout(HANG_S)
                self.rfile.read(1)

        def log_message(self, *_: object) -> None:
            """Silent: the tests tell what matters."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
