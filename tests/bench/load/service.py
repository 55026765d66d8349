"""Many people on one service: what keys cost, whether tenants are in each other's way, and what kills lose.

`python -m tests.bench service`, or some parts of it: `--parts keys queue`. Two things that are compared are measured in
one run, by turns.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sqlite3
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import psutil

from capture2vr.cli.up import free_port
from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.access.tables import api_keys, tenants
from capture2vr.gateway.database.database import open_engine
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.tenant_store import store_of_tenant, tenant_prefix
from tests.bench.load.attack_files import cloud, zipped
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.tenants import bearer, make_key
from tests.support.workers.inspecting_worker import inspecting_worker

OWNER = ALL_SCOPES - {Scope.OPERATE}
_PATIENCE_S = 120.0
_JOB_WORK = "capture2vr.edge.jobs.job_work"
_REQUESTS = 1_000  # of each of two that are compared
_WARM = 100
_REGULARS = 50  # tenants that ask by turns


def main(arguments: list[str]) -> None:
    """Print the chosen parts."""
    options = _parser().parse_args(arguments)
    for name in options.parts:
        with tempfile.TemporaryDirectory(prefix=f"bench-service-{name}-", dir=options.scratch) as folder:
            for what, figure in PARTS[name](Path(folder), options):
                print(f"{what:<58} {figure}", flush=True)


def keys(folder: Path, _: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """What a key costs: the same requests with it, with a session cookie, and at a gateway that asks for none."""
    with ExitStack() as stack:
        secret = make_key(folder / "closed", "default", OWNER)
        closed, opened = (stack.enter_context(_gateway(folder, name)) for name in ("closed", "open"))
        cookie = httpx.post(f"{closed}/v1/session", json={"key": secret}).cookies["c2v_session"]
        ways = {
            "without keys": _asking(stack, opened, {}),
            "with a key": _asking(stack, closed, bearer(secret)),
            "with a session": _asking(stack, closed, {"Cookie": f"c2v_session={cookie}"}),
        }
        medians = _by_turns({name: partial(ask, "/v1/jobs?limit=1") for name, ask in ways.items()})
    base = medians["without keys"]
    yield "GET /v1/jobs, median", f"{1e3 * base:.2f} ms {next(iter(medians))}"
    for name, seconds in medians.items():
        if name != "without keys":
            yield f"more for a request {name}", f"{1e3 * (seconds - base):+.2f} ms (at most 1 wanted)"


def many_tenants(folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """Whether one tenant of many is served as fast as a lone one."""
    began = time.perf_counter()
    lone, many = _fill(folder / "lone", 1, options.assets), _fill(folder / "many", options.tenants, options.assets)
    yield "made", f"{options.tenants:,} tenants of {options.assets} assets, in {time.perf_counter() - began:.0f} s"
    os.sync()  # what the kernel writes back would be measured otherwise
    chance = random.Random(0)
    regulars = chance.sample(many[1:], min(_REGULARS, len(many) - 1))
    with ExitStack() as stack:
        urls = {name: stack.enter_context(_gateway(folder, name)) for name in ("lone", "many")}
        asks = {
            "a lone tenant": _asking(stack, urls["lone"], bearer(lone[0])),
            "one of many": _asking(stack, urls["many"], bearer(many[0])),
        }
        anybody = stack.enter_context(httpx.Client(base_url=urls["many"], timeout=_PATIENCE_S))

        def somebody(path: str, of: list[str]) -> Callable[[], object]:
            return lambda: anybody.get(path, headers=bearer(chance.choice(of))).raise_for_status()

        for what, path in (
            ("list", f"/v1/assets?limit={min(100, options.assets)}"),
            ("search", "/v1/collections/default/assets?label=boot"),
            ("authenticate", "/v1/session"),
        ):
            ways: dict[str, Callable[[], object]] = {name: partial(ask, path) for name, ask in asks.items()}
            for secret in regulars:
                anybody.get(path, headers=bearer(secret)).raise_for_status()
            medians = _by_turns({**ways, f"any of {len(regulars)}": somebody(path, regulars)}, options.requests)
            base = medians["a lone tenant"]
            ratios = ", ".join(f"{seconds / base:.2f} for {name}" for name, seconds in list(medians.items())[1:])
            yield f"{what}, against {1e3 * base:.1f} ms for a lone tenant", f"x {ratios} (0.70 to 1.30 wanted)"
            rare = _by_turns({"": somebody(path, many)}, options.requests)[""]
            yield (
                f"{what}, of a tenant that nobody asked for before",
                f"{1e3 * rare:.1f} ms (keys and folders are not in memory)",
            )


def queue(folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """How many jobs of a tenant with hundreds start before the one job of another."""
    waits = []
    with _site(folder, slots=1) as site:
        big, small = site.client("big"), site.client("small")
        for number in range(options.jobs):
            site.start(big, "big", f"big{number}")
        for number in range(10):
            time.sleep(random.Random(number).uniform(0.2, 0.6))
            job = site.start(small, "small", f"small{number}")
            site.wait(small, job)
            waits.append(site.started_between(job, "big"))
    yield f"jobs of a tenant with {options.jobs} that start before another's one", f"{max(waits)} at most (2 wanted)"


def revocation(folder: Path, _: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """How long another gateway goes on taking a key that was revoked."""
    database = {"GATEWAY_DATABASE_URL": f"sqlite:///{folder / 'shared.db'}"}
    engine = open_engine(database["GATEWAY_DATABASE_URL"])
    store = AccessStore(engine)
    store.ensure_tenant("ada")
    key, secret = store.create_key("ada", OWNER)
    engine.dispose()
    with ExitStack() as stack:
        one, two = (stack.enter_context(_gateway(folder, name, **database)) for name in ("one", "two"))
        httpx.get(f"{two}/v1/jobs", headers=bearer(secret)).raise_for_status()
        httpx.post(f"{one}/v1/api-keys/{key.id}/revoke", headers=bearer(secret)).raise_for_status()
        began = time.monotonic()
        while httpx.get(f"{two}/v1/jobs", headers=bearer(secret)).status_code != 401:
            time.sleep(0.05)
    yield "a revoked key is refused by another gateway after", f"{time.monotonic() - began:.1f} s (60 wanted)"


def kills(folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """Whether every job of two tenants is done, and none twice, while workers, the processes of jobs and gateways are
    killed by turns. The jobs are drafts of small clouds, really computed.
    """
    chance = random.Random(7)
    began = time.monotonic()
    with _site(folder, slots=1, gateways=2, workers=2, worker="capture2vr.edge") as site:
        clients = {tenant: site.client(tenant) for tenant in ("ada", "bob")}
        archive = zipped({"a.ply": cloud()})
        jobs = {}
        for number in range(options.jobs):
            tenant, key = ("ada", "bob")[number % 2], f"key{number}"
            jobs[site.start(clients[tenant], tenant, key, archive)] = (tenant, key)
        killed = Counter[str]()
        for number in range(options.kills):
            time.sleep(chance.uniform(0.5, 3.0))
            killed[_kill(site, number, chance)] += 1
        for job, (tenant, _) in jobs.items():
            site.wait(clients[tenant], job)
        states = site.states()
        doubled = [key for job, (tenant, key) in jobs.items() if site.versions(tenant, key) != [job]]
    yield f"{options.jobs} jobs of two tenants, {options.kills} kill -9", f"{time.monotonic() - began:.0f} s"
    yield "killed", json.dumps(killed)
    yield "ended as", json.dumps(states)
    yield "published twice, or not by their own job", str(len(doubled))


def _kill(site: _Site, number: int, chance: random.Random) -> str:
    """Kill one of a worker, a job's process and a gateway, by turns; start it again, except the job's process."""
    kind = ("worker", "job", "gateway")[number % 3]
    if kind == "job":
        deadline = time.monotonic() + _PATIENCE_S
        while not (computing := site.computing()):
            assert time.monotonic() < deadline, "no job is computed"
            time.sleep(0.02)
        with suppress(psutil.NoSuchProcess):
            chance.choice(computing).kill()
        return kind
    victim = chance.choice(site.gateways if kind == "gateway" else site.workers)
    victim.kill()
    victim.start()
    return kind


class _Site:
    """Gateways and workers of quick work, on one database and one store, with a client for every tenant."""

    def __init__(self, folder: Path, gateways: list[ServiceProcess], workers: list[ServiceProcess], urls: list[str]):
        self.gateways, self.workers, self._urls = gateways, workers, urls
        self._folder = folder
        self._store = LocalStore(folder / "objects")
        self._database = folder / "gateway.db"
        self._clients: list[httpx.Client] = []

    def client(self, tenant: str) -> httpx.Client:
        """A client with a key of the tenant, which is made."""
        engine = open_engine(f"sqlite:///{self._database}")
        store = AccessStore(engine)
        store.ensure_tenant(tenant)
        store.set_limits(tenant, {"jobs_at_once": 0, "requests_per_minute": 0})
        _, secret = store.create_key(tenant, OWNER)
        engine.dispose()
        made = httpx.Client(headers=bearer(secret), timeout=_PATIENCE_S)
        self._clients.append(made)
        return made

    def start(self, client: httpx.Client, tenant: str, key: str, archive: bytes = b"", **script: Any) -> str:
        """Start a job, as a phone would: again, at the next gateway, until there is an answer.

        archive  of the capture; none: one that holds the script of quick work
        """
        archive = archive or json.dumps({"steps": 1, "pause_s": 0.05, **script}).encode()
        name = f"cap-{key}"
        stored = store_of_tenant(self._store, tenant)
        stored.put(f"captures/{name}.zip", archive, content_type="application/zip")
        body = {"capture": name, "asset_key": key, "preset": "draft"}
        return str(self._ask(client, "POST", "/v1/jobs", json=body, headers={"Idempotency-Key": key})["id"])

    def computing(self) -> list[psutil.Process]:
        """The processes of jobs that are computed now: each is a fork of the server that has loaded what they need."""
        below = (each for worker in self.workers for each in psutil.Process(worker.pid).children(recursive=True))
        found = []
        for process in below:
            with suppress(psutil.NoSuchProcess):
                if all(_JOB_WORK in each.cmdline() for each in (process, process.parent()) if each is not None):
                    found.append(process)
        return found

    def wait(self, client: httpx.Client, job: str) -> None:
        """Wait until a job has ended."""
        while self._ask(client, "GET", f"/v1/jobs/{job}")["state"] not in {"SUCCEEDED", "FAILED", "CANCELLED"}:
            time.sleep(0.05)

    def states(self) -> dict[str, int]:
        """Number of jobs by state."""
        with sqlite3.connect(self._database) as db:
            return dict(db.execute("SELECT state, count(*) FROM jobs GROUP BY state").fetchall())

    def versions(self, tenant: str, key: str) -> list[str]:
        """The jobs that published the versions of an asset."""
        return [each["job"] for each in read_entry(store_of_tenant(self._store, tenant), key).versions]

    def started_between(self, job: str, tenant: str) -> int:
        """How many runs of another tenant began between a job's creation and its own beginning."""
        with sqlite3.connect(self._database) as db:
            created = db.execute("SELECT created FROM jobs WHERE id = ?", (job,)).fetchone()[0]
            running = "SELECT e.at, e.job FROM events e WHERE e.kind = 'state' AND e.data LIKE '%\"RUNNING\"%'"
            began = min(at for at, of in db.execute(running).fetchall() if of == job)
            select = "SELECT count(*) FROM events e JOIN jobs j ON j.id = e.job WHERE j.tenant = ? AND e.kind = 'state'"
            select += " AND e.data LIKE '%\"RUNNING\"%' AND e.at > ? AND e.at < ?"
            return int(db.execute(select, (tenant, created, began)).fetchone()[0])

    def close(self) -> None:
        """Close the clients."""
        for client in self._clients:
            client.close()

    def _ask(self, client: httpx.Client, method: str, path: str, **options: Any) -> Any:
        deadline = time.monotonic() + _PATIENCE_S
        for turn in range(10**9):
            try:
                answer = client.request(method, self._urls[turn % len(self._urls)] + path, **options)
                if answer.status_code not in (429, 503):
                    return answer.raise_for_status().json()
            except httpx.TransportError:
                pass
            if time.monotonic() > deadline:
                break
            time.sleep(0.02)
        raise AssertionError(f"no gateway answered {path} within {_PATIENCE_S:g} s")


@contextmanager
def _site(
    folder: Path,
    *,
    slots: int,
    gateways: int = 1,
    workers: int = 1,
    worker: str = "tests.support.workers.scripted_work_worker",
) -> Iterator[_Site]:
    shared = {"STORAGE_ROOT": folder / "objects", "OMP_NUM_THREADS": 1}
    edge_ports, ports = [free_port() for _ in range(workers)], [free_port() for _ in range(gateways)]
    edges = [
        ServiceProcess(
            worker,
            folder / f"edge{number}.log",
            EDGE_PORT=port,
            EDGE_SLOTS=slots,
            EDGE_SCRATCH=folder / f"scratch{number}",
            **shared,
        )
        for number, port in enumerate(edge_ports)
    ]
    make_key(folder, "default", {Scope.OPERATE})
    doors = [
        ServiceProcess(
            "capture2vr.gateway",
            folder / f"gateway{number}.log",
            GATEWAY_PORT=port,
            GATEWAY_DATA_DIR=folder / f"gateway{number}",
            GATEWAY_DATABASE_URL=f"sqlite:///{folder / 'gateway.db'}",
            GATEWAY_WORKERS=",".join(f"127.0.0.1:{each}" for each in edge_ports),
            GATEWAY_LEASE_S=2,
            GATEWAY_ATTACH_FOR_S=3,
            GATEWAY_RETRY_S=0.1,
            GATEWAY_MAX_ATTEMPTS=50,
            GATEWAY_PRESETS="draft,fine",
            GATEWAY_LOG_LEVEL="WARNING",
            **shared,
        )
        for number, port in enumerate(ports)
    ]
    with killed_at_the_end(*edges, *doors):
        site = _Site(folder, doors, edges, [f"http://127.0.0.1:{port}" for port in ports])
        _wait_until_it_answers(ports[0])
        try:
            yield site
        finally:
            site.close()


@contextmanager
def _gateway(folder: Path, name: str, **variables: object) -> Iterator[str]:
    """A gateway process on a folder of that name, with a worker that only inspects; its URL."""
    port = free_port()
    process = ServiceProcess(
        "capture2vr.gateway",
        folder / f"{name}.log",
        GATEWAY_PORT=port,
        GATEWAY_DATA_DIR=folder / name,
        GATEWAY_WORKERS=inspecting_worker(),
        GATEWAY_LOG_LEVEL="WARNING",
        GATEWAY_LIMIT_REQUESTS_PER_MINUTE=0,
        STORAGE_ROOT=folder / name / "objects",
        **variables,
    )
    with killed_at_the_end(process):
        _wait_until_it_answers(port)
        yield f"http://127.0.0.1:{port}"


def _wait_until_it_answers(port: int) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        try:
            if httpx.get(f"http://127.0.0.1:{port}/v1/keys").is_success:
                return
        except httpx.TransportError:
            time.sleep(0.1)
    raise AssertionError(f"no gateway answered on port {port}")


def _asking(stack: ExitStack, url: str, headers: dict[str, str]) -> Callable[[str], object]:
    client = stack.enter_context(httpx.Client(base_url=url, headers=headers, timeout=_PATIENCE_S))
    return lambda path: client.get(path).raise_for_status()


def _by_turns(ways: dict[str, Callable[[], object]], requests: int = _REQUESTS) -> dict[str, float]:
    """Median seconds of each way, all asked by turns."""
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for number in range(requests + _WARM):
        for name, ask in ways.items():
            began = time.perf_counter()
            ask()
            if number >= _WARM:
                seconds[name].append(time.perf_counter() - began)
    return {name: statistics.median(each) for name, each in seconds.items()}


def _fill(folder: Path, count: int, assets: int) -> list[str]:
    """Make tenants with the same assets each; the secrets of their keys.

    One tenant's assets are published; the others' objects are hard links to them, under their own names.
    """
    store = LocalStore(folder / "objects")
    first = store_of_tenant(store, "t0")
    for number in range(assets):
        files = {"preview.png": b"picture %d" % number}
        label = f"{('boot', 'coat')[number % 2]} {number}"
        bundle = Bundle("refined", files, {"lods": [], "label": label, "labels": []})
        publish(bundle, first, key=f"thing{number:03}", job=f"job_{number}")
    template = [path for root in _roots(store, "t0") for path in root.rglob("*") if path.is_file()]
    for number in range(1, count):
        _link(store, template, f"t{number}")
    engine = open_engine(f"sqlite:///{folder / 'gateway.db'}")
    secrets = _make_keys(engine, count)
    engine.dispose()
    return secrets


def _roots(store: LocalStore, tenant: str) -> tuple[Path, Path]:
    """The folders of a tenant's objects, and of what the store knows of them."""
    return store.root / tenant_prefix(tenant), store.root / ".meta" / tenant_prefix(tenant)


def _link(store: LocalStore, template: list[Path], tenant: str) -> None:
    for path in template:
        relative = path.relative_to(store.root).as_posix().replace("tenants/t0/", tenant_prefix(tenant))
        if not relative.removeprefix(".meta/").startswith(f"{tenant_prefix(tenant)}assets/"):  # which nobody lists
            target = store.root / relative
            try:
                os.link(path, target)
            except FileNotFoundError:
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(path, target)


def _make_keys(engine: Any, count: int) -> list[str]:
    """A key for every tenant, in one transaction."""
    from capture2vr.gateway.access.api_key import hash_of, new_secret

    now, made = time.time(), [new_secret(f"t{number}") for number in range(count)]
    with engine.begin() as db:
        db.execute(tenants.insert(), [{"name": f"t{number}", "label": "", "created": now} for number in range(count)])
        db.execute(
            api_keys.insert(),
            [
                {
                    "id": f"key_{number:028x}",
                    "tenant": f"t{number}",
                    "label": "",
                    "sha256": hash_of(secret),
                    "scopes": "capture read manage",
                    "created": now,
                }
                for number, secret in enumerate(made)
            ],
        )
    return made


PARTS: dict[str, Callable[[Path, argparse.Namespace], Iterator[tuple[str, str]]]] = {
    "keys": keys,
    "tenants": many_tenants,
    "queue": queue,
    "revocation": revocation,
    "kills": kills,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench service", description=__doc__)
    parser.add_argument("--parts", nargs="*", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--tenants", type=int, default=10_000)
    parser.add_argument("--assets", type=int, default=100, help="of each tenant")
    parser.add_argument("--requests", type=int, default=300, help="of each kind, to many tenants")
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--kills", type=int, default=24)
    parser.add_argument("--scratch", type=Path, help="folder for what is made; default: the system's")
    return parser
