"""The attacks of docs/security.md on a started product: `python -m tests.bench attack`.

`capture2vr up` runs in processes of its own with three keys: mallory's, who attacks; ada's, whose small upload is sent
again and again meanwhile; an operator's. Each row tells what the product answered, processor seconds of all that it
started, the most memory of one process and of the worker itself, and the longest that ada waited. `--product FOLDER`
attacks another checkout. `make test` runs the rows that cost little (tests/test_attacks.py).
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import psutil

from capture2vr.cli.up import free_port
from tests.bench.load.attack_files import cloud
from tests.bench.load.product import PeakMemory, peak_mb, processor_seconds
from tests.support.repository import ROOT

if TYPE_CHECKING:
    from tests.bench.load.attacks import Attack

HANG_S = 900.0  # of one request: what takes longer hangs
_READY_S = 120.0
_PAUSE_S = 0.2  # between two uploads of ada
_KEYS = {"mallory": (), "ada": (), "operator": ("operate", "manage", "read", "capture")}  # with their scopes
_SETTLE_S = 1.0  # behind an attack, for processes that are killed to be gone


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an attack. fault: what should not be, or "", and over: which limits it broke; seconds: of CPUs"""

    answers: str
    fault: str
    over: str
    seconds: float
    mb: float
    worker_mb: float
    waited_s: float


class Product:
    """A running product, and a client of each key."""

    def __init__(
        self, checkout: Path, data: Path, environment: dict[str, str], secrets: dict[str, str] | None = None
    ) -> None:
        """secrets: keys of an earlier product on the folder, by name; None: new ones"""
        self.checkout, self.data = checkout, data
        self.package = "capture2vr" if (checkout / "capture2vr").exists() else "services"
        self.environment = {**environment, "PYTHONPATH": str(checkout)}
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._process = self._start()
        self.secrets = secrets or {name: self.key(name, *scopes) for name, scopes in _KEYS.items()}
        self.mallory, self.ada, self.operator = (self.client(name) for name in _KEYS)
        self._wait("readyz" if secrets is None else "v1/keys")

    def client(self, name: str) -> httpx.Client:
        """A client with a tenant's key."""
        headers = {"Authorization": f"Bearer {self.secrets[name]}"}
        return httpx.Client(base_url=self.url, headers=headers, timeout=HANG_S)

    def command(self, *arguments: str) -> list[str]:
        """A command line of this checkout."""
        return [sys.executable, "-P", "-m", f"{self.package}.cli", *arguments]

    @property
    def services(self) -> list[psutil.Process]:
        """Gateway and worker."""
        return psutil.Process(self._process.pid).children()

    @property
    def worker(self) -> psutil.Process:
        """The worker itself."""
        return next(each for each in self.services if "edge" in each.cmdline()[-2:])

    def close(self) -> None:
        """Stop it."""
        for client in (self.mallory, self.ada, self.operator):
            client.close()
        self._process.terminate()
        try:
            self._process.wait(60)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def _start(self) -> subprocess.Popen[bytes]:
        with (self.data.parent / "up.log").open("ab") as log:
            return subprocess.Popen(
                self.command("up", "--port", str(self.port), "--data", str(self.data)),
                env=self.environment,
                cwd=self.data.parent,
                stdout=log,
                stderr=log,
            )

    def key(self, tenant: str, *scopes: str) -> str:
        """Create a key of a tenant; return its secret."""
        named = [word for scope in scopes for word in ("--scope", scope)]
        made = subprocess.run(
            self.command("keys", "create", "--tenant", tenant, *named, "--data", str(self.data)),
            env=self.environment,
            cwd=self.data.parent,
            capture_output=True,
            text=True,
            check=True,
        )
        return next(word for word in made.stdout.split() if word.startswith(f"c2v_{tenant}_"))

    def _wait(self, until: str) -> None:
        deadline = time.monotonic() + _READY_S
        while time.monotonic() < deadline:
            with suppress(httpx.TransportError):
                if httpx.get(f"{self.url}/{until}").is_success:
                    return
            time.sleep(0.2)
        self.close()
        raise RuntimeError(f"the product was not ready within {_READY_S:.0f} s")


@contextmanager
def started(checkout: Path = ROOT, **variables: str) -> Iterator[Product]:
    """A product on an empty folder, stopped at the end. variables: of its environment"""
    folder = Path(tempfile.mkdtemp(prefix="attack-"))
    product = Product(checkout, folder / "data", {**os.environ, "EDGE_DEVICE": "cpu", **variables})
    try:
        yield product
    finally:
        product.close()
        shutil.rmtree(folder, ignore_errors=True)


class Neighbour:
    """Ada, who sends a small cloud again and again while a block lasts; `waited_s` is the longest that she waited."""

    def __init__(self, product: Product) -> None:
        self._product = product
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self.waited_s, self.refused = 0.0, ""

    def __enter__(self) -> Neighbour:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()

    def _send(self) -> None:
        while not self._ends.wait(_PAUSE_S):
            began = time.monotonic()
            answer = send(self._product.ada, "a.ply", cloud())
            self.waited_s = max(self.waited_s, time.monotonic() - began)
            if not (answer.is_success and answer.json()["inspected"]):
                self.refused = answer.json().get("code", "not inspected")


def send(client: httpx.Client, name: str, content: bytes) -> httpx.Response:
    """Upload a capture of one file."""
    return client.post("/v1/captures", files=[("files", (name, content))])


def said(answer: httpx.Response) -> str:
    """The answer in a word: its code, or its status."""
    try:
        found: Any = answer.json()
    except ValueError:
        return str(answer.status_code)
    code = found.get("code", "") if isinstance(found, dict) else ""
    if not code and isinstance(found, dict) and found.get("inspected") is False:
        return f"{answer.status_code} not inspected"
    return code or str(answer.status_code)


def measure(product: Product, attack: Attack) -> Outcome:
    """Run an attack, and measure what it costs."""
    send(product.ada, "a.ply", cloud())  # starts what is started at first use
    before, peak, worker = processor_seconds(product.services), PeakMemory(product.services), product.worker
    neighbour = Neighbour(product)
    with peak, nullcontext() if attack.alone else neighbour:
        time.sleep(3 * _PAUSE_S)
        answers, fault = attack.run(product)
    time.sleep(_SETTLE_S)
    seconds = processor_seconds(product.services) - before
    alive = worker.is_running() and worker.pid == product.worker.pid
    faults = (fault, not alive and "the worker died", neighbour.refused and f"ada: {neighbour.refused}")
    over = (
        seconds > attack.most_s and f"more than {attack.most_s:.0f} CPU s",
        neighbour.waited_s > attack.most_waited_s and f"ada waits for more than {attack.most_waited_s:.0f} s",
    )
    told = ["; ".join(filter(None, each)) for each in (faults, over)]
    return Outcome(answers, *told, seconds, peak.mb, peak_mb(product.worker.pid), neighbour.waited_s)


def main(arguments: list[str]) -> None:
    """Run the attacks, and print a row of each as it ends."""
    from tests.bench.load.attacks import ATTACKS

    parser = argparse.ArgumentParser(prog="python -m tests.bench attack", description=__doc__)
    parser.add_argument("--product", type=Path, default=ROOT, help="checkout that is attacked (this one)")
    parser.add_argument("--only", action="append", help="attacks whose name contains this; may be repeated")
    options = parser.parse_args(arguments)
    print("| attack | answers | as it should be | CPU s | MB of one process | MB of the worker | ada waited s |")
    print("|---" * 7 + "|")
    for attack in ATTACKS:
        if options.only and not any(each in attack.name for each in options.only):
            continue
        with started(options.product.resolve(), **attack.variables) as product:
            found = measure(product, attack)
        told = (f"{found.seconds:.1f}", f"{found.mb:.0f}", f"{found.worker_mb:.0f}", f"{found.waited_s:.1f}")
        cells = (attack.name, found.answers, "; ".join(filter(None, (found.fault, found.over))) or "yes", *told)
        print(f"| {' | '.join(cells)} |", flush=True)
