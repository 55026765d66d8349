"""Where pip on this machine finds packages, for the builds of images: its indexes and folders, served over loopback.

An image that is built with the host's network reaches an index on the network as this machine does, but no folder of
this machine. Those that pip is configured with are served to it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

_SOURCES = ("index-url", "extra-index-url", "find-links")
_PASSED = (*_SOURCES, "default-timeout", "proxy", "trusted-host")
_PORT = 47_653
CA_BUNDLE = Path("/etc/ssl/certs/ca-certificates.crt")
"""Where Debian keeps the certificates that its programs trust, here and in an image."""


class _Folders(SimpleHTTPRequestHandler):
    """Files below several folders: the first part of the path is the folder's number."""

    def __init__(self, *arguments: object, folders: list[Path]) -> None:
        self._folders = folders
        super().__init__(*arguments)  # type: ignore[arg-type]

    def translate_path(self, path: str) -> str:
        number, _, rest = path.lstrip("/").partition("/")
        if not number.isdecimal() or int(number) >= len(self._folders):
            return str(Path("/nonexistent"))
        self.directory = str(self._folders[int(number)])
        return super().translate_path(f"/{rest}")

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def served_sources() -> Iterator[str]:
    """The text of a pip.conf with which a build on this machine's network finds what pip finds here."""
    folders: list[Path] = []
    with _server(folders) as server:
        origin = f"http://127.0.0.1:{server.server_address[1]}"
        settings = {
            name: " ".join(_reachable(source, origin, folders) for source in value.split())
            for name, value in _pip_settings().items()
        }
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield "\n".join(
                ["[global]", f"cert = {CA_BUNDLE}", *(f"{name} = {text}" for name, text in settings.items())]
            )
        finally:
            server.shutdown()
            thread.join()


def _server(folders: list[Path]) -> ThreadingHTTPServer:
    """Listen on the same port each time, if it is free: layers that were built with that pip.conf are used again."""
    handler = partial(_Folders, folders=folders)
    try:
        return ThreadingHTTPServer(("127.0.0.1", _PORT), handler)
    except OSError:
        return ThreadingHTTPServer(("127.0.0.1", 0), handler)


def _pip_settings() -> dict[str, str]:
    """Those of pip's settings that say where packages are; the environment's win over the files'."""
    listed = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    found: dict[str, str] = {}
    for line in sorted(listed.stdout.splitlines(), key=lambda line: line.startswith(":env:")):
        name, _, value = line.partition("=")
        option = name.rpartition(".")[2]
        if option in _PASSED:
            found[option] = str(ast.literal_eval(value))
    return found


def _reachable(source: str, origin: str, folders: list[Path]) -> str:
    """The URL under which a build finds a source. Of an index the folder above is served: its pages link to it."""
    parts = urlsplit(source)
    if parts.scheme not in ("", "file"):
        return source
    folder = Path(parts.path)
    if not folder.is_dir():
        return source
    is_index = parts.scheme == "file" and not any(folder.glob("*.whl"))
    folders.append(folder.parent if is_index else folder)
    return f"{origin}/{len(folders) - 1}/{folder.name if is_index else ''}"
