"""Millions of jobs that have ended in one database: what the metrics, the queue's figures and a new job cost then.

`python -m tests.bench jobs --jobs 10000000 --database sqlite`. The gateway is a real process, asked over one
connection. Rows are made by the database itself, without their events.
"""

from __future__ import annotations

import argparse
import http.client
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import psutil
import sqlalchemy as sa

from capture2vr.cli.up import free_port
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.job_counts import count_again
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.jobs.tables import jobs
from capture2vr.order.job_options import JobOptions
from tests.bench.data_files import DataMissing
from tests.referees.postgres import programs, running
from tests.support.service_processes import ServiceProcess, killed_at_the_end

_TENANTS = ("default", "ada", "bob", "eve", "kim")
_AT_ONCE = 100_000  # rows of a statement
_PATHS = ("/v1/jobs", "/v1/assets", "/v1/captures", "/v1/collections", "/v1/service", "/readyz", "/v1/usage", "/login")


def main(arguments: list[str]) -> None:
    """Print what each costs, in milliseconds."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench jobs")
    parser.add_argument("--jobs", type=int, default=1_000_000, help="that have ended")
    parser.add_argument("--waiting", type=int, default=1_000, help="that wait, of five tenants")
    parser.add_argument("--database", choices=["sqlite", "postgres"], default="sqlite")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="bench-jobs-") as folder, _database(options.database, Path(folder)) as url:
        for what, figure in _figures(url, Path(folder), options):
            print(f"{what:<58} {figure}", flush=True)


@contextmanager
def _database(kind: str, folder: Path) -> Iterator[str]:
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'gateway.db'}"
        return
    found = programs()
    if found is None:
        raise DataMissing("a Postgres server is needed: apt-get install postgresql")
    with running(found) as url:
        yield url


def _figures(url: str, folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    engine, began = open_engine(url), time.monotonic()
    store = JobStore(engine)
    _fill(engine, options.jobs)
    for number in range(options.waiting):
        store.create(_TENANTS[number % len(_TENANTS)], Order("cap", f"key{number}", JobOptions("draft")))
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as db:
        db.exec_driver_sql("VACUUM ANALYZE" if engine.dialect.name == "postgresql" else "ANALYZE")
    yield f"{options.jobs:,} jobs ended, {options.waiting:,} wait", f"made in {time.monotonic() - began:.0f} s"
    yield "count them by state, as before", _times(lambda: _count(engine), 5)
    yield "oldest that waits, as before", _times(lambda: _oldest(engine), 5)
    yield "both, as they are kept", _times(store.figures, 200)
    order = Order("cap", "new", JobOptions("draft"))
    yield (
        "a new job of a tenant with a limit of jobs at once",
        _times(lambda: store.create("ada", order, at_once=10**9), 100),
    )
    yield "nothing to delete of a tenant, as retention asks", _times(lambda: store.delete_ended("ada", before=1.0), 100)
    engine.dispose()
    yield from _over_http(url, folder)


def _over_http(url: str, folder: Path) -> Iterator[tuple[str, str]]:
    port = free_port()
    gateway = ServiceProcess(
        "capture2vr.gateway",
        folder / "gateway.log",
        GATEWAY_PORT=port,
        GATEWAY_DATA_DIR=folder,
        GATEWAY_DATABASE_URL=url,
        GATEWAY_JOBS_DAYS=0,
        GATEWAY_WORKERS="127.0.0.1:9",
        STORAGE_ROOT=folder / "objects",
    )
    with ExitStack() as stack:
        stack.enter_context(killed_at_the_end(gateway))
        _wait(port)
        connection = http.client.HTTPConnection("127.0.0.1", port)
        stack.callback(connection.close)
        for path in _PATHS:
            _get(connection, path)
        time.sleep(3)
        for path in ("/livez", "/v1/queue", "/metrics"):
            size = len(_get(connection, path))
            yield f"GET {path} ({size:,} bytes)", _times(partial(_get, connection, path), 300, partial(_cpu_s, gateway))


def _fill(engine: sa.Engine, count: int) -> None:
    """Add jobs that have ended, a second apart, of five tenants; one of fifty has failed. Counted once, at the end."""
    is_sqlite = engine.dialect.name == "sqlite"
    columns = [column.name for column in jobs.c if column.computed is None]
    row, names = _row(is_sqlite), ", ".join(f'"{name}"' for name in columns)
    select = ", ".join(row[name] for name in columns)
    numbers = "WITH RECURSIVE s(n) AS (SELECT {0} UNION ALL SELECT n + 1 FROM s WHERE n < {1}) SELECT n FROM s"
    source = f"({numbers})" if is_sqlite else "generate_series({0}, {1}) AS s(n)"
    with engine.connect() as db:
        for statement in ("PRAGMA synchronous=OFF", "PRAGMA cache_size=-400000") if is_sqlite else ():
            db.connection.cursor().execute(statement)
        which = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'jobs'"
        own = db.exec_driver_sql(which).all() if is_sqlite else []
        for name, _ in own:
            db.exec_driver_sql(f"DROP TRIGGER {name}")
        db.commit()
        for first in range(0, count, _AT_ONCE):
            last = min(count, first + _AT_ONCE) - 1
            db.exec_driver_sql(f"INSERT INTO jobs ({names}) SELECT {select} FROM {source.format(first, last)}")
            db.commit()
        for _, sql in own:
            db.exec_driver_sql(sql)
        count_again(db)
        db.commit()


def _row(is_sqlite: bool) -> dict[str, str]:
    """Return what each column of row n is, in SQL."""
    made = f"{time.time() - 86_400 - 60_000_000:.0f} + n"
    tenants = " ".join(f"WHEN {index} THEN '{name}'" for index, name in enumerate(_TENANTS))
    order = """'{"capture": "cap_1", "asset_key": "key", "preset": "draft"}'"""
    hexadecimal = "printf('%0{0}x', {1})" if is_sqlite else "lpad(to_hex({1}), {0}, '0')"
    ticks = hexadecimal.format(15, f"({made}) * 4096000" if is_sqlite else f"({made}::bigint) * 4096000")
    return {
        "id": f"'job_' || {ticks} || {hexadecimal.format(17, 'n')}",
        "order": order,
        "state": "CASE n - n / 50 * 50 WHEN 0 THEN 'FAILED' ELSE 'SUCCEEDED' END",
        "tenant": f"CASE n - n / {len(_TENANTS)} * {len(_TENANTS)} {tenants} END",
        "created": made,
        "updated": made,
        **dict.fromkeys(("fraction", "elapsed_s", "eta_s", "last_event"), "1"),
        **dict.fromkeys(("preview", "asset", "error"), "NULL"),
        **{"warnings": "'[]'", "seconds": "'{}'", "stage": "''", "token": "''"},
    }


def _cpu_s(gateway: ServiceProcess) -> float:
    used = psutil.Process(gateway.pid).cpu_times()
    return float(used.user + used.system)


def _count(engine: sa.Engine) -> None:
    with engine.begin() as db:
        db.execute(sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)).all()


def _oldest(engine: sa.Engine) -> None:
    with engine.begin() as db:
        db.execute(sa.select(sa.func.min(jobs.c.created)).where(jobs.c.state == "QUEUED")).all()


def _wait(port: int) -> None:
    until = time.monotonic() + 120
    while time.monotonic() < until:
        try:
            connection = http.client.HTTPConnection("127.0.0.1", port)
            _get(connection, "/livez")
            return
        except OSError:
            time.sleep(0.2)
    raise TimeoutError("the gateway does not answer")


def _get(connection: http.client.HTTPConnection, path: str) -> bytes:
    connection.request("GET", path)
    return connection.getresponse().read()


def _times(call: Callable[[], object], times: int, cpu_s: Callable[[], float] = time.process_time) -> str:
    """Return the milliseconds of a call: on the clock, and of a processor, which other work does not lengthen.

    cpu_s  processor seconds so far of the process that does the work
    """
    call()
    found, before = [], cpu_s()
    for _ in range(times):
        began = time.perf_counter()
        call()
        found.append((time.perf_counter() - began) * 1000)
    used = (cpu_s() - before) / times * 1000
    found.sort()
    return f"{used:8.2f} ms CPU; p50 {statistics.median(found):.2f}, p95 {found[int(0.95 * times)]:.2f} ms, of {times}"
