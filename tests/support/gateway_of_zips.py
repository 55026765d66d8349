"""A gateway with a worker in threads of this process, for clients that upload: the work is quick, the rest is real."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anyio.from_thread import start_blocking_portal

from capture2vr.storage.local import LocalStore
from tests.support.in_process_gateway import gateway, worker
from tests.support.workers.scripted_work import ZipMaking


@dataclass(frozen=True, slots=True)
class Served:
    """The gateway's URL, its store, and the script of `Making`, which a test may change."""

    url: str
    store: LocalStore
    script: dict[str, Any] = field(default_factory=dict)


@contextmanager
def gateway_of_zips(folder: Path) -> Iterator[Served]:
    """A gateway that listens; it stops on leaving."""
    store, script = LocalStore(folder / "objects"), dict[str, Any]()
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(worker(ZipMaking(store, script), folder / "scratch")) as port,
        portal.wrap_async_context_manager(gateway(folder / "gateway", store, port)) as http,
    ):
        yield Served(str(http.base_url), store, script)
