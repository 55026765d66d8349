"""A real Ray cluster on this machine, in a network of its own: a head without cores, and nodes that are killed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from tests.support.repository import ROOT
from tests.support.strangers import strangers_folder

ADDRESS = "ray://127.0.0.1:10001"

_START_S = 300.0  # 15 s on two idle cores
_STORE_BYTES = "80000000"
_SMALL = ("--object-store-memory", _STORE_BYTES, "--block", "--disable-usage-stats")
_HEAD = ("--head", "--node-ip-address=127.0.0.1", "--port=6379", "--ray-client-server-port=10001", "--num-cpus=0")


# As the runbook has it: Ray, too, starts Python in its current folder.
_SAFE = {"PYTHONSAFEPATH": "1", "PYTHONPATH": str(ROOT)}
# Ray gives its own processes 30 s to start, come what may; on a crowded machine, start again.
_TOO_SLOW = "node timed out during startup"


class RayCluster:
    """A head, and the nodes by their names."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.strangers = strangers_folder(folder / "strangers")
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start_head(self) -> None:
        """Start the head, and wait until clients may connect."""
        self._start("head", *_HEAD, "--include-dashboard=false", f"--temp-dir={self._folder}/ray")

    def start_nodes(self, **nodes: str) -> None:
        """Start nodes of one core, each with its own flags."""
        for name, flags in nodes.items():  # one by one: on one machine they would take each other's ports
            self._start(name, "--address=127.0.0.1:6379", "--num-cpus=1", *flags.split())

    def kill(self, name: str) -> None:
        """Kill all processes of a node, as a power cut does."""
        process = self._running.pop(name)
        with suppress(psutil.NoSuchProcess):
            for each in psutil.Process(process.pid).children(recursive=True):
                with suppress(psutil.NoSuchProcess):
                    each.kill()
        process.kill()
        process.wait()

    def stop(self) -> None:
        for name in list(self._running):
            self.kill(name)

    def _start(self, name: str, *flags: str) -> None:
        """Start a node, and wait until it serves."""
        deadline = time.monotonic() + _START_S
        while (said := self._outcome(name, flags, deadline)) is not None:
            if _TOO_SLOW not in said or time.monotonic() > deadline:
                raise RuntimeError(f"Ray's {name} did not start: {said[-2000:]}")

    def _outcome(self, name: str, flags: Sequence[str], deadline: float) -> str | None:
        """Start a node once; what it said where it did not come to serve."""
        code = "import sys; from ray.scripts.scripts import main; sys.argv[0] = 'ray'; main()"
        with self._log(name).open("wb") as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, "-c", code, "start", *flags, *_SMALL],
                cwd=self.strangers,
                env={**os.environ, "HOME": str(self._folder), **_SAFE, "OMP_NUM_THREADS": "1"},
                stdout=log,
                stderr=log,
            )
        while "Ray runtime started" not in (said := self._log(name).read_text(errors="replace")):
            if time.monotonic() > deadline or self._running[name].poll() is not None:
                self.kill(name)
                return said
            time.sleep(0.1)
        return None

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


@contextmanager
def running() -> Iterator[RayCluster]:
    """A cluster with a head alone. Only in a network of its own (own_network.py)."""
    # Not below pytest's own folder: the paths of Ray's sockets must stay under 108 bytes.
    folder = Path(tempfile.mkdtemp(prefix="ray-"))
    cluster = RayCluster(folder)
    try:
        cluster.start_head()
        yield cluster
    finally:
        cluster.stop()
        shutil.rmtree(folder, ignore_errors=True)
