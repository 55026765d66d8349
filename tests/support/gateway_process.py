"""A gateway process, which is killed and comes back, and what it has stored."""

from __future__ import annotations

import hashlib
import time
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from capture2vr.cli.up import free_port
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import list_all
from tests.support.patience import PATIENCE_S
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.workers.inspecting_worker import inspecting_worker


class GatewayProcess:
    """A gateway process; with a worker that only inspects where none are named."""

    def __init__(self, folder: Path, *, workers: str = "", within: Sequence[str] = (), **variables: object) -> None:
        """within: as of ServiceProcess; variables: further ones of its environment"""
        self.port = free_port()
        self.store = LocalStore(folder / "objects")
        self.process = ServiceProcess(
            "capture2vr.gateway",
            folder / "gateway.log",
            GATEWAY_PORT=self.port,
            GATEWAY_DATA_DIR=folder / "data",
            within=within,
            GATEWAY_WORKERS=workers or inspecting_worker(),
            STORAGE_ROOT=folder / "objects",
            **variables,
        )
        self.url = f"http://127.0.0.1:{self.port}"

    def restart(self) -> None:
        """Kill it, and start it again."""
        self.process.kill()
        self.process.start()

    def chunks(self) -> int:
        """How many chunks of uploads are stored."""
        return len(list(list_all(self.store, "uploads/")))

    def wait_for_chunks(self, count: int) -> None:
        """Wait until so many chunks are stored."""
        deadline = time.monotonic() + PATIENCE_S
        while self.chunks() < count:
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def wait_until_it_answers(self) -> None:
        """Wait for the start: while it brings its database up to date, it lives and refuses everything else."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            try:
                if httpx.get(f"{self.url}/v1/keys").is_success:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.05)
        raise AssertionError("the gateway did not start")

    def captures(self) -> list[dict[str, Any]]:
        """All that are stored."""
        found: list[dict[str, Any]] = httpx.get(f"{self.url}/v1/captures").json()["captures"]
        return found

    def the_one_file(self, folder: Path) -> str:
        """SHA-256 of the file of the one capture that is stored."""
        (capture,) = self.captures()
        self.store.fetch(f"captures/{capture['capture']}.zip", folder / "stored.zip")
        with zipfile.ZipFile(folder / "stored.zip") as archive:
            (name,) = archive.namelist()
            with archive.open(name) as file:
                return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


@contextmanager
def running(folder: Path, **options: Any) -> Iterator[GatewayProcess]:
    """A gateway that answers, until the end. options: as of GatewayProcess"""
    gateway = GatewayProcess(folder, **options)
    with killed_at_the_end(gateway.process):
        gateway.wait_until_it_answers()
        yield gateway
