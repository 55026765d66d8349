"""Thousands of queued jobs, several gateways, many workers, one Postgres: no job twice, how fast, at what cost.

`python -m tests.bench dispatch`. Postgres and the gateways are real processes; the workers are gRPC servers in one
process, whose runs are pauses (`dispatch_workers.py`). Captures are a few bytes on a store that is a folder.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import httpx
import psutil
import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.cli.up import free_port
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.row_mapping import event_values, job_values, lease_values
from capture2vr.gateway.jobs.state_machine import create_job
from capture2vr.gateway.jobs.store import new_job_id
from capture2vr.gateway.jobs.tables import events, jobs, leases
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.local import LocalStore
from capture2vr.storage.tenant_store import DEFAULT_TENANT, store_of_tenant
from tests.bench.data_files import DataMissing
from tests.bench.load.dispatch_workers import PRESET, SHORT
from tests.referees.postgres import programs, running
from tests.support.in_process_gateway import capture
from tests.support.repository import ROOT
from tests.support.service_processes import ServiceProcess, killed_at_the_end

_PATIENCE_S = 120.0
_TENANTS = (DEFAULT_TENANT, "ada", "bob", "eve", "kim")
_GOAL_S = 0.05  # from a free slot, or from a new job, to its dispatch: p99

Run = dict[str, object]


def main(arguments: list[str]) -> None:
    """Print what each phase found."""
    options = _parser().parse_args(arguments)
    found = programs()
    if found is None:
        raise DataMissing("a Postgres server is needed: apt-get install postgresql")
    with (
        tempfile.TemporaryDirectory(prefix="bench-dispatch-") as folder,
        running(found) as url,
        _site(Path(folder), url, options) as site,
    ):
        for what, figure in _phases(site, options):
            print(f"{what:<66} {figure}", flush=True)


def _phases(site: Site, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    yield "made of", f"{options.gateways} gateways, {options.workers} workers of one slot, {len(_TENANTS)} tenants"
    began = site.cpu()
    single = [site.post(number) for number in range(options.single)]
    site.wait_until(lambda: site.unfinished() == 0)
    starts = {str(run["job"]): float(str(run["began"])) for run in site.runs()}
    waits = [starts[job] - created for job, created in site.created().items() if job in single]
    yield f"{options.single} single jobs, nothing queued: from the row to the worker", _percentiles(waits)
    yield "CPU seconds meanwhile", site.cpu_since(began)
    _queue(site.engine, options.jobs)
    yield f"{options.jobs:,} jobs queued; runs of {options.run_s:g} s", f"for {options.seconds:g} s"
    began, from_ = site.cpu(), time.time()
    site.post(options.single)  # the rows above were not announced
    time.sleep(options.seconds)
    gaps = _gaps(site.runs(), from_)
    yield "from a free slot to the next job on it", f"{_percentiles(gaps)} (p99 <= {1e3 * _GOAL_S:.0f} ms wanted)"
    yield "jobs dispatched each second", f"{len(gaps) / options.seconds:.1f}"
    yield "CPU seconds meanwhile", site.cpu_since(began)
    began, from_, left = site.cpu(), time.time(), site.unfinished()
    site.skip_pauses()
    site.wait_until(lambda: site.unfinished() == 0, within_s=options.patience)
    yield f"the other {left:,} jobs, runs of 0 s", f"{left / (time.time() - from_):.0f} a second"
    yield "CPU seconds meanwhile", site.cpu_since(began)
    yield from _told(site, options.jobs + options.single + 1)


def _told(site: Site, wanted: int) -> Iterator[tuple[str, str]]:
    """Whether each job ran once, by the rows and by what the workers saw."""
    seen = Counter(str(run["job"]) for run in site.runs())
    with site.engine.connect() as db:
        states = db.execute(sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)).all()
        attempts = db.execute(sa.select(leases.c.attempts, sa.func.count()).group_by(leases.c.attempts)).all()
        fences = db.execute(sa.select(sa.func.max(leases.c.fence))).scalar_one()
    yield "ended as", ", ".join(f"{count:,} {state}" for state, count in states) + f" of {wanted:,}"
    yield "attempts by the rows", ", ".join(f"{count:,} jobs with {number}" for number, count in attempts)
    yield "highest fence", str(fences)
    yield "jobs that workers saw", f"{len(seen):,}; more than once: {sum(count > 1 for count in seen.values())}"


@dataclass
class Site:
    """What runs: the database, the gateways' URLs, the workers' process and its log."""

    engine: Engine
    urls: Sequence[str]
    client: httpx.Client
    gateways: Sequence[ServiceProcess]
    workers: subprocess.Popen[str]
    log: Path
    server: psutil.Process

    def post(self, number: int) -> str:
        """Have a gateway make a job; its id."""
        url = self.urls[number % len(self.urls)]
        body = {"capture": "cap_1", "asset_key": f"{SHORT}{number}", "preset": PRESET}
        answer = self.client.post(f"{url}/v1/jobs", json=body).raise_for_status()
        time.sleep(random.Random(number).uniform(0.05, 0.15))
        return str(answer.json()["id"])

    def runs(self) -> list[Run]:
        """The runs that have ended, as the workers saw them."""
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    def created(self) -> dict[str, float]:
        """When each job was created."""
        with self.engine.connect() as db:
            return {row.id: row.created for row in db.execute(sa.select(jobs.c.id, jobs.c.created))}

    def unfinished(self) -> int:
        """How many jobs have not ended."""
        with self.engine.connect() as db:
            select = sa.select(sa.func.count()).where(jobs.c.state.in_(("QUEUED", "RUNNING")))
            return int(db.execute(select).scalar_one())

    def wait_until(self, holds: Callable[[], bool], within_s: float = _PATIENCE_S) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + within_s
        while not holds():
            if time.monotonic() > deadline:
                raise SystemExit(f"not within {within_s:g} s")
            time.sleep(0.2)

    def skip_pauses(self) -> None:
        """End the runs at once from here on."""
        self.workers.send_signal(signal.SIGUSR1)

    def cpu(self) -> dict[str, float]:
        """CPU seconds so far, by kind of process."""
        gateways = [psutil.Process(gateway.pid) for gateway in self.gateways]
        return {
            "Postgres": _cpu_s(self.server),
            "gateways": sum(_cpu_s(gateway) for gateway in gateways),
            "workers": _cpu_s(psutil.Process(self.workers.pid)),
        }

    def cpu_since(self, before: dict[str, float]) -> str:
        """CPU seconds since then."""
        return ", ".join(f"{seconds - before[name]:.1f} {name}" for name, seconds in self.cpu().items())


def _cpu_s(process: psutil.Process) -> float:
    """CPU seconds of a process, its children, and those of its children that have ended."""
    own = process.cpu_times()
    total = own.user + own.system + own.children_user + own.children_system
    for child in process.children():
        times = child.cpu_times()
        total += times.user + times.system
    return total


@contextmanager
def _site(folder: Path, url: str, options: argparse.Namespace) -> Iterator[Site]:
    engine = open_engine(url)
    store = LocalStore(folder / "objects")
    for tenant in _TENANTS:
        capture(store_of_tenant(store, tenant))
        AccessStore(engine).ensure_tenant(tenant)
    command = [sys.executable, "-m", "tests.bench.load.dispatch_workers"]
    arguments = [str(options.workers), str(options.run_s), str(folder / "runs")]
    with ExitStack() as stack:
        stack.callback(engine.dispose)
        workers = subprocess.Popen([*command, *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        stack.enter_context(workers)
        stack.callback(workers.terminate)
        assert workers.stdout is not None
        addresses = ",".join(f"127.0.0.1:{port}" for port in json.loads(workers.stdout.readline()))
        ports = [free_port() for _ in range(options.gateways)]
        gateways = [
            ServiceProcess(
                "capture2vr.gateway",
                folder / f"gateway{number}.log",
                GATEWAY_PORT=port,
                GATEWAY_DATA_DIR=folder / f"gateway{number}",
                GATEWAY_DATABASE_URL=url,
                GATEWAY_WORKERS=addresses,
                GATEWAY_LOG_LEVEL="WARNING",
                GATEWAY_LIMIT_JOBS_AT_ONCE=0,
                STORAGE_ROOT=store.root,
            )
            for number, port in enumerate(ports)
        ]
        stack.enter_context(killed_at_the_end(*gateways))
        client = stack.enter_context(httpx.Client(timeout=_PATIENCE_S))
        urls = [f"http://127.0.0.1:{port}" for port in ports]
        site = Site(engine, urls, client, gateways, workers, folder / "runs", _server_of(engine))
        for each in urls:
            site.wait_until(lambda each=each: _answers(client, each))  # type: ignore[misc]
        yield site


def _answers(client: httpx.Client, url: str) -> bool:
    try:
        return client.get(f"{url}/readyz").is_success
    except httpx.TransportError:
        return False


def _server_of(engine: Engine) -> psutil.Process:
    """The first process of the server, whose children are all others."""
    with engine.connect() as db:
        backend = psutil.Process(db.execute(sa.text("SELECT pg_backend_pid()")).scalar_one())
        parent = backend.parent()
    assert parent is not None
    return parent


def _queue(engine: Engine, count: int) -> None:
    """Add queued jobs by turns of the tenants, in one transaction."""
    began = time.time()
    made = [
        create_job(
            new_job_id(began + number / 1e3),
            Order("cap_1", f"thing{number}", JobOptions(PRESET)),
            tenant=_TENANTS[number % len(_TENANTS)],
            now=began,
        )
        for number in range(count)
    ]
    with engine.begin() as db:
        db.execute(jobs.insert(), [job_values(change.job) for change in made])
        db.execute(leases.insert(), [lease_values(change.job) for change in made])
        db.execute(events.insert(), [event_values(event) for change in made for event in change.events])


def _gaps(runs: Sequence[Run], since: float) -> list[float]:
    """Seconds from the end of a run to the beginning of the next one on the same worker."""
    by_worker: defaultdict[object, list[tuple[float, float]]] = defaultdict(list)
    for run in runs:
        if float(str(run["began"])) >= since:
            by_worker[run["worker"]].append((float(str(run["began"])), float(str(run["ended"]))))
    return [
        following[0] - before[1] for each in map(sorted, by_worker.values()) for before, following in pairwise(each)
    ]


def _percentiles(seconds: Sequence[float]) -> str:
    if len(seconds) < 2:
        return "too few to tell"
    cuts = statistics.quantiles(seconds, n=100)
    return f"p50 {1e3 * cuts[49]:.0f} ms, p99 {1e3 * cuts[98]:.0f} ms, of {len(seconds):,}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench dispatch", description=__doc__)
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--single", type=int, default=200, help="jobs that come one by one while nothing is queued")
    parser.add_argument("--gateways", type=int, default=4)
    parser.add_argument("--workers", type=int, default=50)
    parser.add_argument("--run-s", type=float, default=10.0, help="mean seconds of a run")
    parser.add_argument("--seconds", type=float, default=120.0, help="for which the queue is watched")
    parser.add_argument("--patience", type=float, default=3_600.0, help="most seconds for the rest of the queue")
    return parser
