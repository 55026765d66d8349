"""Jobs on disk: what was answered is there, queues are first come first served, and a lease has one holder."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs import tables
from capture2vr.gateway.jobs.job import Job, Order, State
from capture2vr.gateway.jobs.reports import Report, RunFinished, RunProgress, VersionPublished
from capture2vr.gateway.jobs.state_machine import (
    Change,
    LeaseLost,
    Retry,
    apply_reports,
    lease_to_worker,
    request_cancel,
    take_over,
)
from capture2vr.gateway.jobs.store import JOB_ID, JobStore, NextJob, Slot, SlotTaken, new_job_id
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.order.photo_box import PhotoBox
from capture2vr.storage.tenant_store import DEFAULT_TENANT

OPTIONS = JobOptions("draft", cut="object", box=PhotoBox(0.25, 0.125, 0.75, 1.0), names=AssetNames("Dress"))
ORDER = Order("cap_1", "dress", OPTIONS)
RETRY = Retry(3, 1.0)
HOME = DEFAULT_TENANT


@pytest.fixture
def store(url: str) -> Iterator[JobStore]:
    engine = open_engine(url)
    yield JobStore(engine)
    engine.dispose()


def lease(now: float = 100.0, holder: str = "gw") -> partial[Change]:
    return partial(lease_to_worker, holder=holder, worker="w:1", now=now, lease_s=10)


@pytest.mark.slow
def test_a_job_survives_a_restart_in_every_field(store: JobStore, url: str) -> None:
    made = store.create(HOME, ORDER)
    claimed = store.claim(made.created + 1, ("draft",), lease(made.created + 1))
    assert claimed is not None
    told = [
        RunProgress(1, "FITTING", 0.5, {"a": 1.0}),
        VersionPublished(2, "dress", 1, "preview", "m"),
        RunFinished(3, ("w",), {"FITTING": 2}),
    ]
    job = store.change(made.id, partial(apply_reports, fence=1, reports=told, now=made.created + 5, retry=RETRY))
    engine = open_engine(url)
    again, events = JobStore(engine).job_and_events(HOME, made.id, 0)
    engine.dispose()
    assert again == job
    assert again.state is State.SUCCEEDED
    assert again.elapsed_s == pytest.approx(5)
    assert [event.seq for event in events] == list(range(1, job.last_event + 1))


@pytest.mark.parametrize(("isolate", "cut"), [(True, "object"), (False, "scene"), (None, "")])
def test_an_order_of_before_the_cut_keeps_its_choice(store: JobStore, url: str, isolate: bool | None, cut: str) -> None:
    made = store.create(HOME, ORDER)
    engine = open_engine(url)
    older = {name: value for name, value in ORDER.as_json.items() if name != "cut"} | {"isolate": isolate}
    with engine.begin() as connection:
        connection.execute(tables.jobs.update().where(tables.jobs.c.id == made.id).values(order=older))
    engine.dispose()
    assert store.get(HOME, made.id).order == replace(ORDER, options=replace(OPTIONS, cut=cut))


@given(st.floats(1.7e9, 2.2e9), st.integers(0, 1 << 20))
def test_ids_sort_by_creation_time_within_a_millisecond_too(now: float, microseconds: int) -> None:
    later = now + (1 + microseconds) / 1e6
    assert JOB_ID.fullmatch(new_job_id(now))
    assert new_job_id(now) < new_job_id(later)
    assert len({new_job_id(now) for _ in range(50)}) == 50


def test_the_queue_is_first_come_first_served(store: JobStore) -> None:
    jobs = [store.create(HOME, ORDER).id for _ in range(5)]
    claimed = [store.claim(1e12, ("draft",), lease()) for _ in range(6)]
    assert [job.id if job else None for job in claimed] == [*sorted(jobs), None]


def test_a_job_is_claimed_by_one_of_many(store: JobStore, url: str) -> None:
    for _ in range(20):
        store.create(HOME, ORDER)
    gate = threading.Barrier(4)

    def claims(_: int) -> list[str]:
        engine = open_engine(url)
        mine = JobStore(engine)
        gate.wait()
        got = [job.id for _ in range(10) if (job := mine.claim(1e12, ("draft",), lease()))]
        engine.dispose()
        return got

    with ThreadPoolExecutor(4) as pool:
        got = [job for each in pool.map(claims, range(4)) for job in each]
    assert len(got) == len(set(got)) == 20


def test_a_free_slot_is_leased_once(store: JobStore, url: str) -> None:
    """Many gateways see the same two free slots at once; each slot gets one job, until that has ended."""
    for _ in range(20):
        store.create(HOME, ORDER)
    gate = threading.Barrier(4)

    def claims(_: int) -> list[str]:
        engine = open_engine(url)
        mine, got = JobStore(engine), []
        gate.wait()
        for _ in range(5):
            with suppress(SlotTaken):
                job = mine.claim(1e12, ("draft",), lease(), Slot("w:1", 2))
                got += [job.id] if job else []
        engine.dispose()
        return got

    with ThreadPoolExecutor(4) as pool:
        got = [job for each in pool.map(claims, range(4)) for job in each]
    assert len(got) <= 2
    while len(got) < 2:  # they may have kept each other off
        job = store.claim(1e12, ("draft",), lease(), Slot("w:1", 2))
        assert job is not None
        got.append(job.id)
    assert store.figures().counts[State.RUNNING] == len(set(got)) == 2
    with pytest.raises(SlotTaken):
        store.claim(1e12, ("draft",), lease(), Slot("w:1", 2))
    done = [VersionPublished(1, "dress", 1, "refined", "m"), RunFinished(2, (), {})]
    store.change(got[0], partial(apply_reports, fence=1, reports=done, now=1e12, retry=RETRY))
    assert store.claim(1e12, ("draft",), lease(), Slot("w:1", 2)) is not None


def published(seq: int = 1) -> list[Report]:
    return [VersionPublished(seq, "dress", 1, "refined", "m"), RunFinished(seq + 1, (), {})]


def ends(fence: int = 1, reports: list[Report] | None = None) -> partial[Change]:
    told = published() if reports is None else reports
    return partial(apply_reports, fence=fence, reports=told, now=1e12, retry=RETRY)


def behind(slots: int = 1, worker: str = "w:1") -> NextJob:
    return NextJob(Slot(worker, slots), frozenset({"draft"}), 1e12, lease())


def test_the_end_of_a_run_leases_its_slot_to_the_next_job(store: JobStore) -> None:
    first, second = store.create(HOME, ORDER), store.create(HOME, ORDER)
    assert store.claim(1e12, ("draft",), lease(), Slot("w:1", 1)) is not None
    ended, following = store.end_run(first.id, ends(), behind())
    assert (ended.id, ended.state) == (first.id, State.SUCCEEDED)
    assert following is not None
    assert (following.id, following.state, following.lease.attempts) == (second.id, State.RUNNING, 1)
    assert [store.get(HOME, job.id) for job in (first, second)] == [ended, following]
    ended, following = store.end_run(second.id, ends(), behind())
    assert (ended.state, following) == (State.SUCCEEDED, None), "nothing waits"


def test_a_run_ends_where_its_slot_is_not_free_for_the_next_job(store: JobStore) -> None:
    jobs = [store.create(HOME, ORDER) for _ in range(4)]
    for _ in range(2):  # one more than the worker has slots, as where it was restarted with fewer
        store.claim(1e12, ("draft",), lease())
    ended, following = store.end_run(jobs[0].id, ends(), behind())
    assert (ended.state, following) == (State.SUCCEEDED, None)
    assert store.get(HOME, jobs[0].id) == ended
    going_on, following = store.end_run(jobs[1].id, ends(reports=[RunProgress(1, "FITTING", 0.5)]), behind(slots=2))
    assert (going_on.state, following) == (State.RUNNING, None), "it goes on, and keeps its slot"
    assert store.figures().counts[State.QUEUED] == 2


def test_the_end_of_a_run_and_the_next_lease_are_stored_together_or_not_at_all(store: JobStore) -> None:
    first, second = store.create(HOME, ORDER), store.create(HOME, ORDER)
    running = store.claim(1e12, ("draft",), lease())
    refuses = replace(behind(), lease=partial(apply_reports, fence=9, reports=[], now=0, retry=RETRY))
    with pytest.raises(LeaseLost):
        store.end_run(first.id, ends(), refuses)
    assert store.get(HOME, first.id) == running
    assert store.get(HOME, second.id) == second
    with pytest.raises(LeaseLost):
        store.end_run(first.id, ends(fence=9), behind())
    assert store.get(HOME, second.id) == second


def test_an_idempotency_key_makes_one_job(store: JobStore) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: store.create(HOME, ORDER, key="k", body_sha256="a").id, range(8)))
    assert len(set(made)) == 1
    with pytest.raises(Problem) as conflict:
        store.create(HOME, ORDER, key="k", body_sha256="b")
    assert (conflict.value.status, conflict.value.code) == (409, "IDEMPOTENCY_CONFLICT")


def test_what_a_transition_refuses_leaves_no_trace(store: JobStore) -> None:
    job = store.create(HOME, ORDER)
    with pytest.raises(LeaseLost):
        store.change(job.id, partial(apply_reports, fence=9, reports=[], now=0, retry=RETRY))
    assert store.get(HOME, job.id) == job


def test_a_lease_is_renewed_by_its_fence_only(store: JobStore) -> None:
    job = store.create(HOME, ORDER)
    store.claim(1e12, ("draft",), lease(holder="a"))
    assert store.renew("a", 500.0, [(job.id, 1)]) == (set(), set())
    assert store.renew("a", 500.0, [(job.id, 2)]) == ({job.id}, set())
    assert store.renew("b", 500.0, [(job.id, 1)]) == ({job.id}, set())
    store.change(job.id, partial(request_cancel, now=5))
    assert store.renew("a", 500.0, [(job.id, 1)]) == (set(), {job.id})
    assert store.get(HOME, job.id).lease.until == 500.0


def test_a_run_is_taken_over_when_its_lease_is_out_or_by_its_former_self(store: JobStore) -> None:
    job = store.create(HOME, ORDER)
    store.claim(1e12, ("draft",), lease(100.0, "a"))

    def orphan(now: float, holder: str, ours: tuple[str, ...] = ()) -> Job | None:
        return store.claim_orphan(now, holder, ours, partial(take_over, holder="b", now=now, lease_s=10))

    assert orphan(105.0, "") is None
    assert orphan(105.0, "a", (job.id,)) is None
    mine = orphan(105.0, "a")
    assert mine is not None
    assert (mine.lease.holder, mine.lease.fence, mine.lease.worker) == ("b", 2, "w:1")
    assert orphan(114.0, "") is None
    assert orphan(116.0, "") is not None


def test_pages_are_newest_first_and_complete(store: JobStore) -> None:
    jobs = [store.create(HOME, ORDER).id for _ in range(7)]
    seen: list[str] = []
    while page := store.page(HOME, limit=3, after=seen[-1] if seen else ""):
        seen += [job.id for job in page]
    assert seen == sorted(jobs, reverse=True)
    assert store.figures().counts[State.QUEUED] == 7


def test_others_news_are_heard(store: JobStore) -> None:
    before = store.newest_event_id()
    job = store.create(HOME, ORDER)
    after, touched = store.jobs_changed_since(before)
    assert touched == {job.id}
    assert store.jobs_changed_since(after) == (after, set())


def test_an_unknown_job_has_a_name(store: JobStore) -> None:
    with pytest.raises(Problem) as unknown:
        store.get(HOME, "job_none")
    assert (unknown.value.status, unknown.value.code) == (404, "JOB_UNKNOWN")
