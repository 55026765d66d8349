"""Jobs that have ended: their progress goes soon, they go some day, and nothing else does."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.jobs import ended_jobs as ended_jobs_module
from capture2vr.gateway.jobs import tables
from capture2vr.gateway.jobs.ended_jobs import first_id
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.reports import AnchorsFound, Report, RunFinished, RunProgress, VersionPublished
from capture2vr.gateway.jobs.state_machine import Retry, apply_reports, lease_to_worker
from capture2vr.gateway.jobs.store import JobStore, new_job_id
from capture2vr.order.job_options import JobOptions

_ORDER = Order("cap_1", "dress", JobOptions("draft"))
_REPORTS: list[Report] = [
    RunProgress(1, "FITTING", 0.5, {"a": 1.0}),
    AnchorsFound(2, (0.0, 0.0, 0.0), (1, 2, 3)),
    VersionPublished(3, "dress", 1, "preview", "m"),
    RunProgress(4, "EXTRACTING", 0.7),
]


@pytest.fixture
def store(url: str) -> Iterator[JobStore]:
    engine = open_engine(url)
    yield JobStore(engine)
    engine.dispose()


def run(store: JobStore, reports: list[Report], now: float) -> str:
    """Create a job, and have a run of it report."""
    made = store.create("ada", _ORDER).id
    lease = partial(lease_to_worker, holder="gw", worker="w", now=now, lease_s=9)
    assert store.claim(1e12, ("draft",), lease) is not None
    store.change(made, partial(apply_reports, fence=1, reports=reports, now=now, retry=Retry(3, 1.0)))
    return made


def kinds(store: JobStore, job: str) -> list[str]:
    return [event.kind for event in store.job_and_events("ada", job, 0)[1]]


def test_only_the_progress_of_what_has_ended_goes(store: JobStore) -> None:
    now = time.time()
    ended, runs = run(store, [*_REPORTS, RunFinished(5)], now), run(store, _REPORTS, now)
    before = kinds(store, ended)
    assert before == ["state", "state", "progress", "anchors", "published", "progress", "state"]
    assert store.delete_progress(before=now - 1) == 0
    assert kinds(store, ended) == before
    assert store.delete_progress(before=now + 1) == 1
    assert store.delete_progress(before=now + 1) == 0
    assert kinds(store, ended) == ["state", "state", "published", "state"]
    assert kinds(store, runs) == before[:-1]
    job, rest = store.job_and_events("ada", ended, 3)
    assert rest[-1].seq == job.last_event, "whoever follows the job comes to its end"


def test_a_few_at_a_time_until_none_is_left(store: JobStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ended_jobs_module, "JOBS_AT_ONCE", 2)
    made = [run(store, [*_REPORTS, RunFinished(5)], time.time()) for _ in range(5)]
    runs = run(store, _REPORTS, time.time())
    later = time.time() + 1
    assert [store.delete_progress(before=later) for _ in range(4)] == [2, 2, 1, 0]
    assert store.delete_ended("bob", before=later) == []
    assert [store.delete_ended("ada", before=later) for _ in range(4)] == [made[:2], made[2:4], made[4:], []]
    assert [job.id for job in store.page("ada", limit=9)] == [runs]
    with store.engine.connect() as db:
        for table in (tables.leases, tables.events, tables.ended_jobs):
            assert set(db.execute(sa.select(table.c.job)).scalars()) <= {runs}


@given(st.floats(1.7e9, 2.2e9), st.integers(1, 1 << 20))
def test_an_id_tells_before_from_after(now: float, microseconds: int) -> None:
    later = now + microseconds / 1e6
    assert new_job_id(now) < first_id(later + 1e-3) < new_job_id(later + 2e-3)
