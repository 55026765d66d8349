"""Numbers of jobs by state: whatever is done to jobs, and by whomever, they are those that counting would give."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

import pytest
import sqlalchemy as sa

from capture2vr.gateway.database.database import create_engine, open_engine
from capture2vr.gateway.database.schema import upgrade
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.job import Job, Order, State
from capture2vr.gateway.jobs.job_counts import count_again
from capture2vr.gateway.jobs.reports import RunFailed
from capture2vr.gateway.jobs.state_machine import (
    Change,
    LeaseLost,
    Retry,
    apply_reports,
    lease_to_worker,
    request_cancel,
)
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.jobs.tables import job_counts, jobs
from capture2vr.order.job_options import JobOptions

_PRESETS = ("draft", "fine")
_FAILED = [RunFailed(1, "CAPTURE_DEGENERATE", "flat")]
_RETRY = Retry(3, 1.0)


@pytest.fixture
def engine(url: str) -> Iterator[sa.Engine]:
    opened = open_engine(url)
    yield opened
    opened.dispose()


def counted(engine: sa.Engine) -> dict[State, int]:
    with engine.connect() as db:
        rows = db.execute(sa.select(jobs.c.state, sa.func.count().label("number")).group_by(jobs.c.state)).all()
    found = {row.state: row.number for row in rows}
    return {state: found.get(state.value, 0) for state in State}


def oldest(engine: sa.Engine) -> float | None:
    with engine.connect() as db:
        found: float | None = db.execute(
            sa.select(sa.func.min(jobs.c.created)).where(jobs.c.state == "QUEUED")
        ).scalar()
    return found


def live(store: JobStore, chance: random.Random, steps: int) -> None:
    """Create, lease, end, cancel and delete jobs by chance."""
    running: list[tuple[str, int]] = []
    for _ in range(steps):
        tenant, order = chance.choice(["ada", "bob"]), Order("cap", "key", JobOptions(chance.choice(_PRESETS)))
        match chance.randrange(6):
            case 0 | 1:
                store.create(tenant, order)
            case 2:
                lease = partial(lease_to_worker, holder="gw", worker="w", now=time.time(), lease_s=9)
                if leased := store.claim(1e12, _PRESETS, lease):
                    running.append((leased.id, leased.lease.fence))
            case 3 if running:
                job, fence = running.pop()
                ended = partial(apply_reports, fence=fence, reports=_FAILED, now=time.time(), retry=_RETRY)
                with suppress(Problem, LeaseLost):  # another one has deleted it, or ended it
                    store.change(job, ended)
            case 4:
                for found in store.page(tenant, limit=1):
                    with suppress(Problem):
                        store.change(found.id, partial(request_cancel, now=time.time()))
            case _ if chance.random() < 0.3:
                store.delete_ended(tenant, before=time.time() + 1)


@pytest.mark.parametrize("seed", range(3))
def test_they_are_those_that_counting_gives(engine: sa.Engine, seed: int) -> None:
    store, chance = JobStore(engine), random.Random(seed)
    seen: set[State] = set()
    for _ in range(10):
        live(store, chance, 10)
        figures = store.figures()
        assert (figures.counts, figures.oldest) == (counted(engine), oldest(engine))
        seen |= {state for state, count in figures.counts.items() if count}
    assert len(seen) >= 4, "the test has seen most states"


def test_gateways_count_at_once(engine: sa.Engine, url: str) -> None:
    gate = threading.Barrier(4)

    def run(seed: int) -> None:
        own = open_engine(url)
        gate.wait()
        live(JobStore(own), random.Random(seed), 40)
        own.dispose()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(run, range(4)))
    found = JobStore(engine).figures().counts
    assert found == counted(engine)
    assert sum(found.values()) > 0


def test_a_job_that_somebody_writes_is_deleted_later(engine: sa.Engine, url: str) -> None:
    """Whoever changes a job locks it first; to delete its lease before would be a deadlock."""
    if engine.dialect.name == "sqlite":
        pytest.skip("SQLite has one writer at a time")
    store, other = JobStore(engine), JobStore(open_engine(url))
    job = store.create("ada", Order("cap", "key", JobOptions("draft"))).id
    store.change(job, partial(request_cancel, now=time.time()))
    deleted = []

    def cancel_again(found: Job) -> Change:
        deleted.append(other.delete_ended("ada", before=time.time() + 1))
        return request_cancel(found, now=time.time())

    store.change(job, cancel_again)
    assert deleted == [[]]
    assert other.delete_ended("ada", before=time.time() + 1) == [job]
    other.engine.dispose()


def test_jobs_of_before_are_counted_once(url: str) -> None:
    engine = create_engine(url)
    with engine.begin() as db:
        upgrade(db, "0010_longer_codes")
        row = {"id": "j1", "order": {"preset": "draft"}, "state": "FAILED", "stage": "", "warnings": [], "seconds": {}}
        numbers = dict.fromkeys(("fraction", "elapsed_s", "eta_s", "last_event", "created", "updated"), 0)
        db.execute(jobs.insert(), [{**row, **numbers, "id": f"j{number}"} for number in range(3)])
    engine.dispose()
    engine = open_engine(url)
    assert JobStore(engine).figures().counts == {**dict.fromkeys(State, 0), State.FAILED: 3}
    engine.dispose()


def test_they_can_be_counted_again(engine: sa.Engine) -> None:
    store = JobStore(engine)
    live(store, random.Random(7), 30)
    with engine.begin() as db:
        db.execute(job_counts.update().values(failed=99))
        count_again(db)
    live(store, random.Random(8), 10)
    assert store.figures().counts == counted(engine)
