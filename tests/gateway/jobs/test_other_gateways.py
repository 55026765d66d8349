"""Gateways on one database hear of each other's changes; on Postgres at once, and also after the connection dropped."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.database import postgres_notify
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.dispatch import dispatcher
from capture2vr.gateway.jobs import job_news, other_gateways
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.other_gateways import OtherGateways
from capture2vr.gateway.jobs.state_machine import lease_to_worker, request_cancel, requeue_refused
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.tenant_store import DEFAULT_TENANT as HOME
from tests.support.in_process_gateway import Making, capture, ended, events, gateway, memory, start, worker
from tests.support.patience import PATIENCE_S

ORDER = Order("cap_1", "dress", JobOptions("draft"))
_LISTENERS = "FROM pg_stat_activity WHERE query LIKE 'LISTEN %' AND datname = current_database()"


class Gateway:
    """What one gateway hears of the others."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.jobs = AsyncJobStore(JobStore(engine))
        self.woken = asyncio.Event()
        self.cancelled: asyncio.Queue[str] = asyncio.Queue()
        self.others = OtherGateways(
            self.jobs,
            wake=self.woken.set,
            cancel=self.cancelled.put_nowait,
            channels={},
            on_connected=lambda: None,
        )


@asynccontextmanager
async def listening(url: str) -> AsyncIterator[Gateway]:
    engine = open_engine(url)
    made = Gateway(engine)
    task = asyncio.create_task(made.others.watch())
    try:
        yield made
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        made.jobs.close()
        engine.dispose()


@pytest.fixture
def other(url: str) -> Iterator[JobStore]:
    """The store of another gateway."""
    engine = open_engine(url)
    yield JobStore(engine)
    engine.dispose()


@pytest.fixture
def url(empty_postgres: str) -> str:
    return empty_postgres


async def _heard(news: asyncio.Event) -> None:
    await asyncio.wait_for(news.wait(), PATIENCE_S)
    news.clear()


async def test_what_others_write_is_told_when_it_is_committed(url: str, other: JobStore) -> None:
    async with listening(url) as mine:
        await _heard(mine.woken)  # it listens now
        job = other.create(HOME, ORDER).id
        await _heard(mine.woken)
        with mine.jobs.notifier.listen(job) as news:
            lease = partial(lease_to_worker, holder="other", worker="w:1", now=1e12, lease_s=10)
            assert other.claim(1e12, ("draft",), lease) is not None
            await _heard(news)
            other.change(job, partial(request_cancel, now=1e12))
            await _heard(news)
        assert await asyncio.wait_for(mine.cancelled.get(), PATIENCE_S) == job
        assert not mine.woken.is_set(), "a job that runs is no news of the queue"


async def test_what_is_rolled_back_is_not_told(url: str, other: JobStore) -> None:
    async with listening(url) as mine:
        await _heard(mine.woken)
        first = other.create(HOME, ORDER)
        await _heard(mine.woken)
        with mine.jobs.notifier.listen(first.id) as news:
            with other.engine.connect() as db:
                job_news.announce(db, other.origin, first)
                db.rollback()
            other.create(HOME, ORDER)
            await _heard(mine.woken)  # what came later has been heard
            assert not news.is_set()


async def test_a_job_that_waits_for_its_next_attempt_wakes_nobody(
    url: str, other: JobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(other_gateways, "_FIRST_REFUSAL_S", 0.0)
    async with listening(url) as mine:
        await _heard(mine.woken)
        job = other.create(HOME, ORDER).id
        await _heard(mine.woken)
        lease = partial(lease_to_worker, holder="other", worker="w:1", now=1e12, lease_s=10)
        assert other.claim(1e12, ("draft",), lease) is not None
        with mine.jobs.notifier.listen(job) as news:
            other.change(job, partial(requeue_refused, fence=1, now=1e12, pause_s=60))
            await _heard(news)
        last = other.create(HOME, ORDER).id
        with mine.jobs.notifier.listen(last) as news:
            await _heard(mine.woken)
            other.change(last, partial(request_cancel, now=1e12))
            await _heard(news)
        assert not mine.woken.is_set(), "of three changes one was a job for the queue"


async def test_a_job_that_its_gateway_finds_a_worker_for_wakes_no_other(
    url: str, other: JobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(other_gateways, "_FIRST_REFUSAL_S", PATIENCE_S)
    async with listening(url) as mine:
        await _heard(mine.woken)
        job = other.create(HOME, ORDER).id
        with mine.jobs.notifier.listen(job) as news:
            lease = partial(lease_to_worker, holder="other", worker="w:1", now=1e12, lease_s=10)
            assert other.claim(1e12, ("draft",), lease) is not None
            await _heard(news)
        monkeypatch.setattr(other_gateways, "_FIRST_REFUSAL_S", 0.0)
        other.create(HOME, ORDER)
        await _heard(mine.woken)  # what came later has been heard
        assert not mine.others._queued


async def test_own_changes_are_not_heard_twice(url: str, other: JobStore) -> None:
    async with listening(url) as mine:
        await _heard(mine.woken)
        await mine.jobs.write(JobStore.create, HOME, ORDER)
        theirs = other.create(HOME, ORDER).id
        with mine.jobs.notifier.listen(theirs) as news:
            other.change(theirs, partial(request_cancel, now=1e12))
            await _heard(news)
        mine.woken.clear()
        own = (await mine.jobs.write(JobStore.create, HOME, ORDER)).id
        with mine.jobs.notifier.listen(own) as news, mine.jobs.notifier.listen(theirs) as later:
            await mine.jobs.change(own, partial(request_cancel, now=1e12))
            await _heard(news)
            other.create(HOME, ORDER)
            await _heard(mine.woken)
            assert not news.is_set()
            assert not later.is_set()


async def test_nothing_is_missed_while_the_connection_is_down(
    url: str, other: JobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgres_notify, "_RECONNECT_S", 0.05)
    job = other.create(HOME, ORDER).id
    async with listening(url) as mine:
        await _heard(mine.woken)
        with mine.jobs.notifier.listen(job) as news, other.engine.connect() as db:
            db.execute(sa.text("LOCK TABLE pg_authid IN ACCESS EXCLUSIVE MODE"))  # nobody can log in
            assert db.execute(sa.text(f"SELECT pg_terminate_backend(pid) {_LISTENERS}")).all() == [(True,)]
            while db.execute(sa.text(f"SELECT pg_stat_clear_snapshot(), count(*) {_LISTENERS}")).one()[1]:
                await asyncio.sleep(0.01)
            db.execute(sa.text("UPDATE jobs SET stage = 'FITTING'"))
            db.commit()  # only now can it connect: the change is older than what it listens to
            await _heard(news)
            await _heard(mine.woken)
        other.create(HOME, ORDER)
        await _heard(mine.woken)


@pytest.mark.slow
async def test_a_job_runs_at_once_wherever_it_was_asked_for(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody looks at the queue without being told, and a stream hears what another gateway stores."""
    monkeypatch.setattr(dispatcher, "_ANNOUNCED_POLL_S", 1e6)
    store = memory()
    work = Making(store)
    async with (
        worker(work, tmp_path / "edge") as port,
        gateway(tmp_path / "works", store, port, database_url=url),
        gateway(tmp_path / "asks", store, database_url=url) as asks,
    ):
        job = await start(asks, capture(store, wait=True))
        stream = asyncio.create_task(events(asks, job))
        work.release.set()
        done = await ended(asks, job)
        story = await stream
    assert (done["state"], work.runs) == ("SUCCEEDED", [job])
    assert [kind for _, kind, _ in story].count("published") == 2


@pytest.mark.slow
async def test_a_job_that_waits_for_its_next_attempt_starts_by_itself(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatcher, "_ANNOUNCED_POLL_S", 1e6)
    store = memory()
    work = Making(store)
    async with (
        worker(work, tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, database_url=url, max_attempts=3, retry_s=0.3) as client,
    ):
        done = await ended(client, await start(client, capture(store, fail="STORE_UNAVAILABLE", retryable=True)))
    assert (done["state"], done["attempts"]) == ("FAILED", 3)
