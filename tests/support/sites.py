"""A gateway in this process, with a worker that only inspects: all that a viewer needs are pages and catalogues."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store
from tests.support.workers.inspecting_worker import inspecting_worker


@dataclass(frozen=True, slots=True)
class Site:
    """A gateway that listens, its store, and the keys it signs with."""

    url: str
    store: LocalStore
    keys: Keys = NO_KEYS


@contextmanager
def site_at(folder: Path, keys: Keys = NO_KEYS, *workers: str) -> Iterator[Site]:
    """A gateway on a free port; it stops on leaving. workers: addresses, in place of one that only inspects"""
    store = LocalStore(folder / "store")
    with gateway_at(folder, store, keys, *workers) as url:
        yield Site(url, store, keys)


@contextmanager
def gateway_at(folder: Path, store: Store, keys: Keys = NO_KEYS, *workers: str) -> Iterator[str]:
    """A gateway of any store; its URL."""
    app = create_app(GatewaySettings(data_dir=folder / "data", workers=workers or (inspecting_worker(),)), store, keys)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(app, log_config=None, ws="none", timeout_graceful_shutdown=1))
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()
