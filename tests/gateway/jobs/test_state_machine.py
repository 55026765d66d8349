"""The state machine: whatever happens in whatever order, no job does what a job must not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.job import TERMINAL, Job, Order, State
from capture2vr.gateway.jobs.reports import (
    AnchorsFound,
    Report,
    RunFailed,
    RunFinished,
    RunHeartbeat,
    RunProgress,
    VersionPublished,
    coalesce,
)
from capture2vr.gateway.jobs.state_machine import (
    NEXT_STATES,
    RUNNING_STATES,
    Change,
    IllegalTransition,
    LeaseLost,
    Retry,
    apply_reports,
    create_job,
    lease_to_worker,
    problem_of,
    request_cancel,
    requeue_lost,
    requeue_refused,
    take_over,
)
from capture2vr.order.job_options import JobOptions

RETRY = Retry(attempts=3, pause_s=1.0)
LOST = Problem(503, "WORKER_LOST", "lost", retryable=True)
ORDER = Order("cap_1", "dress", JobOptions("draft"))

stages = st.sampled_from(["", "VALIDATING", "POINT_CLOUD", "FITTING", "PUBLISHING"])
fractions = st.floats(-1.0, 2.0)
seqs = st.integers(1, 40)
reports = st.one_of(
    st.builds(RunProgress, seqs, stages, fractions, eta_s=st.floats(-1.0, 1e6)),
    st.builds(RunHeartbeat, seqs),
    st.builds(AnchorsFound, seqs, st.just((0.0, 0.5, 0.0)), st.just((255, 0, 0))),
    st.builds(
        VersionPublished,
        seqs,
        st.just("dress"),
        st.integers(1, 3),
        st.sampled_from(["preview", "refined"]),
        st.just("m"),
    ),
    st.builds(
        RunFailed,
        seqs,
        st.sampled_from(["CAPTURE_EMPTY", "CANCELLED", "INTERNAL", "WORKER_DRAINING"]),
        st.just("m"),
        retryable=st.booleans(),
    ),
    st.builds(RunFinished, seqs, warnings=st.just(("w",))),
)


class JobMachine(RuleBasedStateMachine):
    """One job, its gateways and its workers, with a clock that also jumps back."""

    @initialize()
    def begin(self) -> None:
        self.now = 1000.0
        self.old_fences: set[int] = set()
        self.take(create_job("job_1", ORDER, tenant="default", now=self.now), None)

    def take(self, change: Change, before: Job | None) -> None:
        after = change.job
        assert [event.seq for event in change.events] == list(
            range((before.last_event if before else 0) + 1, after.last_event + 1)
        )
        if before is not None:
            self.check(before, after, change)
        self.job = after

    def check(self, before: Job, after: Job, change: Change) -> None:
        told = [State(event.data["state"]) for event in change.events if event.kind == "state"]
        for old, new in zip([before.state, *told], told, strict=False):
            assert new in NEXT_STATES[old]
        assert after.state is (told[-1] if told else before.state)
        assert after.fraction >= before.fraction
        assert after.elapsed_s >= before.elapsed_s
        assert after.lease.fence >= before.lease.fence
        assert after.order == before.order
        if before.ended:
            assert after == before
        if after.lease.fence > before.lease.fence:
            self.old_fences.add(before.lease.fence)

    def attempt(self, transition: Callable[[Job], Change]) -> None:
        try:
            change = transition(self.job)
        except (IllegalTransition, LeaseLost):
            return
        self.take(change, self.job)

    @rule(seconds=st.floats(-5.0, 50.0))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule()
    def lease(self) -> None:
        if self.job.state is State.QUEUED:
            change = lease_to_worker(self.job, holder="gw", worker="w", now=self.now, lease_s=10)
            assert change.job.lease.attempts == self.job.lease.attempts + 1
            self.take(change, self.job)
        else:
            with pytest.raises(IllegalTransition):
                lease_to_worker(self.job, holder="gw", worker="w", now=self.now, lease_s=10)

    @precondition(lambda self: self.job.state in RUNNING_STATES)
    @rule()
    def take_over(self) -> None:
        self.take(take_over(self.job, holder="other", now=self.now, lease_s=10), self.job)

    @rule(told=st.lists(reports, max_size=5))
    def report(self, told: list[Report]) -> None:
        self.attempt(lambda job: apply_reports(job, job.lease.fence, told, now=self.now, retry=RETRY))

    @rule()
    def turn_away(self) -> None:
        self.attempt(lambda job: requeue_refused(job, job.lease.fence, now=self.now, pause_s=1))

    @rule()
    def lose(self) -> None:
        self.attempt(lambda job: requeue_lost(job, job.lease.fence, LOST, now=self.now, retry=RETRY))

    @rule()
    def cancel(self) -> None:
        self.take(request_cancel(self.job, now=self.now), self.job)
        assert self.job.ended or self.job.state is State.CANCELLING

    @precondition(lambda self: bool(self.old_fences))
    @rule(data=st.data(), told=st.lists(reports, min_size=1, max_size=3))
    def late(self, data: st.DataObject, told: list[Report]) -> None:
        """A gateway that lost its lease changes nothing."""
        fence = data.draw(st.sampled_from(sorted(self.old_fences)))
        for transition in (
            lambda: apply_reports(self.job, fence, told, now=self.now, retry=RETRY),
            lambda: requeue_refused(self.job, fence, now=self.now, pause_s=1),
            lambda: requeue_lost(self.job, fence, LOST, now=self.now, retry=RETRY),
        ):
            with pytest.raises(LeaseLost):
                transition()

    @invariant()
    def sound(self) -> None:
        job = self.job
        assert 0.0 <= job.fraction <= 1.0
        assert 0 <= job.lease.attempts <= RETRY.attempts
        assert (job.error is not None) == (job.state is State.FAILED)
        assert (job.lease.holder != "") == (job.state in RUNNING_STATES)
        if job.state is State.SUCCEEDED:
            assert job.asset is not None
            assert job.fraction == 1.0


TestJobMachine = pytest.mark.slow(pytest.mark.essential(JobMachine.TestCase))
TestJobMachine.settings = settings(max_examples=80, stateful_step_count=30)


def running() -> Job:
    return lease_to_worker(
        create_job("job_1", ORDER, tenant="default", now=0).job, holder="gw", worker="w", now=0, lease_s=10
    ).job


def after(job: Job, *told: Report) -> Job:
    return apply_reports(job, job.lease.fence, told, now=1, retry=RETRY).job


def test_terminal_states_are_those_that_lead_nowhere() -> None:
    assert {state for state, following in NEXT_STATES.items() if not following} == TERMINAL


def test_reports_heard_twice_count_once() -> None:
    told = (
        RunProgress(1, "POINT_CLOUD", 0.5),
        AnchorsFound(2, (0.0, 0.5, 0.0), (255, 0, 0)),
        VersionPublished(3, "dress", 1, "refined", "m"),
        RunFinished(4),
    )
    change = apply_reports(running(), 1, told + told, now=1, retry=RETRY)
    assert [event.kind for event in change.events] == ["progress", "anchors", "published", "state"]
    assert change.events[1].data["anchors"] == {"xyz_m": [0.0, 0.5, 0.0], "rgb": [255, 0, 0]}


def test_a_run_that_begins_anew_is_heard_from_its_first_word() -> None:
    job = after(running(), RunProgress(7, "FITTING", 0.8))
    job = requeue_lost(job, 1, LOST, now=1, retry=RETRY).job
    job = lease_to_worker(job, holder="gw", worker="w", now=9, lease_s=10).job
    job = after(job, RunProgress(1, "VALIDATING", 0.0))
    assert (job.stage, job.fraction, job.lease.run_seq) == ("VALIDATING", 0.8, 1)


def test_a_job_that_makes_room_has_no_fewer_attempts_and_no_more_time() -> None:
    job = running()
    job = replace(job, order=replace(job.order, most_seconds=100))
    for fence in (1, 2):
        assert job.lease.fence == fence
        job = after(job, RunFailed(1, "JOB_YIELDED", "others wait", retryable=True, ran_s=45.0))
        assert (job.state, job.lease.attempts) == (State.QUEUED, 0)
        assert job.lease.not_before > 1, "another job takes the slot"
        job = lease_to_worker(job, holder="gw", worker="w", now=9, lease_s=10).job
    assert job.seconds_left == pytest.approx(10.0)
    job = after(job, RunFailed(1, "JOB_YIELDED", "others wait", retryable=True, ran_s=45.0))
    assert job.seconds_left == 1.0, "no time is left, and 0 would be no limit"


def test_finishing_without_an_asset_is_a_failure() -> None:
    job = after(running(), RunFinished(1))
    assert job.error is not None
    assert (job.state, job.error["code"]) == (State.FAILED, "NOTHING_PUBLISHED")


def test_a_run_faster_than_its_cancellation_has_succeeded() -> None:
    job = after(running(), VersionPublished(1, "dress", 1, "preview", "m"))
    job = request_cancel(job, now=2).job
    assert after(job, RunFinished(2)).state is State.SUCCEEDED
    assert after(job, RunFailed(2, "CAPTURE_EMPTY", "m")).state is State.CANCELLED


@pytest.mark.parametrize(("code", "status"), [("EDITS_NOTHING_LEFT", 422), ("CAPTURE_EMPTY", 422), ("INTERNAL", 500)])
def test_what_the_request_is_at_fault_for_is_no_fault_of_the_server(code: str, status: int) -> None:
    assert problem_of(RunFailed(2, code, "m")).status == status


@given(st.integers(1, 10_000))
def test_pauses_grow_up_to_a_minute(attempt: int) -> None:
    assert RETRY.pause_after(attempt) <= min(60.0, RETRY.pause_after(attempt + 1))


@given(st.lists(reports))
def test_coalescing_keeps_what_matters(told: list[Report]) -> None:
    short = coalesce(told)
    assert [each for each in short if not isinstance(each, RunProgress | RunHeartbeat)] == [
        each for each in told if not isinstance(each, RunProgress | RunHeartbeat)
    ]
    assert short[-1:] == told[-1:]
