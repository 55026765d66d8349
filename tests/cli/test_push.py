"""Large captures are pushed to the end, whoever is killed on the way: the gateway, or the command itself."""

from __future__ import annotations

import hashlib
import os
import random
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.cli.errors import BadInput
from services.cli.progress import StageBar
from services.cli.push import upload
from services.cli.up import free_port
from services.storage.archives import pack
from services.storage.local import LocalStore
from services.storage.store import list_all
from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.tus import cloud

_MEGABYTE = 1 << 20
_PUSH = """
import sys, httpx
from pathlib import Path
from services.cli.progress import StageBar
from services.cli.push import upload
with httpx.Client(base_url=sys.argv[1]) as client, StageBar() as bar:
    upload(client, Path(sys.argv[2]), bar)
"""


class Gateway:
    """A gateway process without workers."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.store = LocalStore(folder / "objects")
        self.process = ServiceProcess(
            "services.gateway",
            folder / "gateway.log",
            GATEWAY_PORT=self.port,
            GATEWAY_DATA_DIR=folder / "data",
            GATEWAY_WORKERS="127.0.0.1:9",
            STORAGE_ROOT=folder / "objects",
        )
        self.url = f"http://127.0.0.1:{self.port}"

    def restart(self) -> None:
        """Kill it, and start it again."""
        self.process.kill()
        self.process.start()

    def chunks(self) -> int:
        """How many chunks of uploads are stored."""
        return len(list(list_all(self.store, "uploads/")))

    def wait_until_it_answers(self) -> None:
        """Wait for the start."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            try:
                if httpx.get(f"{self.url}/livez").is_success:
                    return
            except httpx.TransportError:
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
def running(folder: Path) -> Iterator[Gateway]:
    gateway = Gateway(folder)
    with killed_at_the_end(gateway.process):
        gateway.wait_until_it_answers()
        yield gateway


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of 96 MB."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "scan.ply"
    path.write_bytes(cloud(96 * _MEGABYTE))
    return path


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def wait_for(count: int, gateway: Gateway) -> None:
    """Wait until so many chunks are stored."""
    deadline = time.monotonic() + PATIENCE_S
    while gateway.chunks() < count:
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.slow
def test_a_gateway_that_is_killed_again_and_again(tmp_path: Path, capture: Path) -> None:
    with running(tmp_path) as gateway, httpx.Client(base_url=gateway.url) as client, StageBar() as bar:
        receipts: list[Any] = []
        pushing = threading.Thread(target=lambda: receipts.append(upload(client, capture, bar)))
        pushing.start()
        chance = random.Random(0)
        for stored in (1, 3, 6):
            wait_for(stored, gateway)
            time.sleep(chance.uniform(0, 0.05))
            gateway.restart()
        # Twice more wherever it is by then: it may be making the capture.
        for _ in range(2):
            gateway.wait_until_it_answers()
            time.sleep(chance.uniform(0.1, 0.6))
            if pushing.is_alive():
                gateway.restart()
        pushing.join(3 * PATIENCE_S)
        assert receipts
        assert gateway.the_one_file(tmp_path) == sha256(capture)
        assert [each["capture"] for each in gateway.captures()] == [receipts[0]["capture"]]
        assert gateway.chunks() == 0
        assert list((tmp_path / "state" / "capture2vr" / "uploads").iterdir()) == []


@pytest.mark.slow
def test_a_push_that_is_killed_goes_on_when_it_is_started_again(tmp_path: Path, capture: Path) -> None:
    with running(tmp_path) as gateway:
        command = [sys.executable, "-c", _PUSH, gateway.url, str(capture)]
        first = subprocess.Popen(command, cwd=ROOT, env=os.environ, stderr=subprocess.DEVNULL)
        wait_for(4, gateway)
        first.kill()
        first.wait()
        before = gateway.chunks()
        second = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=True)
        assert "goes on at" in second.stderr
        assert before >= 4
        assert gateway.the_one_file(tmp_path) == sha256(capture)


@pytest.mark.slow
def test_what_the_gateway_refuses_is_told_and_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "broken.jpg"
    path.write_bytes(b"\xff\xd8\xff" + bytes(20 * _MEGABYTE))
    pack(path, tmp_path / "broken.zip")
    with running(tmp_path) as gateway, httpx.Client(base_url=gateway.url) as client, StageBar() as bar:
        for source in (path, tmp_path / "broken.zip"):
            with pytest.raises(BadInput, match=r"broken\.jpg"):
                upload(client, source, bar)
            assert gateway.chunks() == 0
        assert gateway.captures() == []
        assert list((tmp_path / "state" / "capture2vr" / "uploads").iterdir()) == []
