"""The queue of several tenants: they take turns, and within a tenant the oldest job is first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.jobs.job import Job, Order
from capture2vr.gateway.jobs.reports import RunFinished, VersionPublished
from capture2vr.gateway.jobs.state_machine import Retry, apply_reports, lease_to_worker, requeue_refused
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.order.job_options import JobOptions

ORDER = Order("cap_1", "dress", JobOptions("draft"))
LATE = 1e12


@pytest.fixture
def store(url: str) -> Iterator[JobStore]:
    engine = open_engine(url)
    yield JobStore(engine)
    engine.dispose()


class Clock:
    """A time that never stands still: turns are told apart by it."""

    now = LATE

    def tick(self) -> float:
        self.now += 1
        return self.now


def claim(store: JobStore, clock: Clock) -> Job | None:
    now = clock.tick()
    return store.claim(now, ("draft",), partial(lease_to_worker, holder="gw", worker="w:1", now=now, lease_s=10))


def finish(store: JobStore, job: Job, clock: Clock) -> None:
    reports = [VersionPublished(1, "dress", 1, "refined", "m"), RunFinished(2, (), {})]
    ended = partial(
        apply_reports, fence=job.lease.fence, reports=reports, now=clock.tick(), retry=Retry(attempts=1, pause_s=1)
    )
    store.change(job.id, ended)


def test_one_job_waits_for_no_more_than_what_runs(store: JobStore) -> None:
    clock = Clock()
    for _ in range(30):
        store.create("big", ORDER)
    running = claim(store, clock)
    assert running is not None
    small = store.create("small", ORDER)
    finish(store, running, clock)
    following = claim(store, clock)
    assert following is not None
    assert following.id == small.id


def test_a_tenant_that_runs_nothing_is_before_one_that_runs_some(store: JobStore) -> None:
    clock = Clock()
    for _ in range(4):
        store.create("big", ORDER)
    assert [claim(store, clock) is not None for _ in range(3)] == [True] * 3
    for tenant in ("b", "a"):
        store.create(tenant, ORDER)
    served = [job.tenant for _ in range(3) if (job := claim(store, clock))]
    assert served == ["a", "b", "big"]


def test_the_oldest_job_that_may_start_is_first_whatever_its_preset(store: JobStore) -> None:
    made = [
        store.create("ada", replace(ORDER, options=JobOptions(preset)))
        for preset in ("scene", "fine", "draft", "fine", "draft")
    ]

    def claimed(now: float, *presets: str) -> int | None:
        lease = partial(lease_to_worker, holder="gw", worker="w:1", now=now, lease_s=10)
        job = store.claim(now, presets, lease)
        return next(number for number, each in enumerate(made) if each.id == job.id) if job else None

    assert claimed(LATE, "draft", "fine") == 1
    store.change(made[1].id, partial(requeue_refused, fence=1, now=LATE, pause_s=100))
    assert store.queue_state(LATE).start == LATE
    assert [claimed(LATE, "draft", "fine") for _ in range(4)] == [2, 3, 4, None], "the first waits for its next attempt"
    assert claimed(LATE, "scene") == 0
    assert store.queue_state(LATE).start == LATE + 100
    assert claimed(LATE + 100, "draft", "fine") == 1
    assert store.queue_state(LATE).start is None


@pytest.mark.slow
@settings(max_examples=15)
@given(
    sizes=st.dictionaries(st.sampled_from(["ada", "bob", "eve", "default"]), st.integers(1, 8), min_size=2),
    slots=st.integers(1, 3),
)
def test_turns_are_even_and_nobody_is_forgotten(sizes: dict[str, int], slots: int) -> None:
    engine = open_engine("sqlite://")  # in memory, of one thread
    store, clock = JobStore(engine), Clock()
    made = {tenant: [store.create(tenant, ORDER).id for _ in range(size)] for tenant, size in sizes.items()}
    running: list[Job] = []
    order: list[Job] = []
    while len(order) < sum(sizes.values()):
        while len(running) < slots and (job := claim(store, clock)):
            running.append(job)
            order.append(job)
        finish(store, running.pop(0), clock)
    engine.dispose()
    for tenant, ids in made.items():
        assert [job.id for job in order if job.tenant == tenant] == sorted(ids), "the oldest first"
    for place in range(len(order)):
        taken = Counter(job.tenant for job in order[:place])
        waiting = [tenant for tenant, size in sizes.items() if taken[tenant] < size]
        # Who still waits has had as many turns as anybody, but for this round and for what ran at the same time.
        assert all(max(taken.values(), default=0) - taken[tenant] <= 1 + slots for tenant in waiting)
