"""State machine of a job as pure functions: each takes a job and what happened, and returns the changed job and events.

    QUEUED ──lease──> RUNNING ──finished──> SUCCEEDED
      ^  │              │ │ └──failed─────> FAILED
      │  │              │ └─request_cancel─> CANCELLING ──> CANCELLED, or SUCCEEDED when the run was faster
      │  └─request_cancel────────────────────────────────> CANCELLED
      └───requeue───────┘

A change that concerns a run needs the fencing token of its lease (`fence`); an older one raises `LeaseLost`.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.job import YIELDED, Event, Job, Lease, Order, State
from capture2vr.gateway.jobs.reports import (
    CANCELLED,
    DRAINING,
    JOB_YIELDED,
    AnchorsFound,
    Report,
    RunFailed,
    RunFinished,
    RunHeartbeat,
    RunProgress,
    VersionPublished,
)
from capture2vr.sentences.sentence import say

NEXT_STATES: dict[State, frozenset[State]] = {
    State.QUEUED: frozenset({State.RUNNING, State.CANCELLED}),
    State.RUNNING: frozenset({State.QUEUED, State.CANCELLING, State.SUCCEEDED, State.FAILED}),
    State.CANCELLING: frozenset({State.CANCELLED, State.SUCCEEDED}),
    State.SUCCEEDED: frozenset(),
    State.FAILED: frozenset(),
    State.CANCELLED: frozenset(),
}
RUNNING_STATES = frozenset({State.RUNNING, State.CANCELLING})
"""States in which a worker may be running the job."""

_TOKEN_BYTES = 16
_YIELD_PAUSE_S = 5.0  # in which a job that waits takes the slot
_LONGEST_PAUSE_S = 60.0  # between attempts: a worker that restarts within a minute gets the job


class LeaseLost(Exception):  # noqa: N818 - it reads as what it is
    """The job was leased to somebody else: this fencing token is outdated and may not change the job any more."""


class IllegalTransition(Exception):  # noqa: N818 - it reads as what it is
    """A transition between two states that is not allowed: a bug of the gateway, never a client's fault."""


@dataclass(frozen=True, slots=True)
class Retry:
    """Retry policy of lost runs: at most `attempts` runs; the pause of `pause_s` seconds doubles with every attempt."""

    attempts: int
    pause_s: float

    def pause_after(self, attempt: int) -> float:
        """Return the seconds to wait after this attempt, 1 being the first."""
        doublings = min(max(attempt, 1) - 1, 32)  # a setting may allow thousands, which would overflow a float
        return min(_LONGEST_PAUSE_S, self.pause_s * 2.0**doublings)


@dataclass(frozen=True, slots=True)
class Change:
    """Result of a transition: the changed job, and its new events, oldest first."""

    job: Job
    events: tuple[Event, ...] = ()


def lease_to_worker(job: Job, *, holder: str, worker: str, now: float, lease_s: float) -> Change:
    """Lease a queued job to a worker."""
    lease = replace(
        job.lease,
        holder=holder,
        worker=worker,
        fence=job.lease.fence + 1,
        attempts=job.lease.attempts + 1,
        until=now + lease_s,
        run_seq=0,
    )
    return _change_state(replace(job, lease=lease), State.RUNNING, now)


def take_over(job: Job, *, holder: str, now: float, lease_s: float) -> Change:
    """Take over the lease of an orphaned run of another gateway, or of this one before its restart; the run goes on."""
    if job.state not in RUNNING_STATES:
        raise IllegalTransition(f"{job.id} is {job.state}: there is no run to take over")
    lease = replace(job.lease, holder=holder, fence=job.lease.fence + 1, until=now + lease_s)
    return Change(replace(job, lease=lease))


def requeue_refused(job: Job, fence: int, *, now: float, pause_s: float) -> Change:
    """Queue the job again because the worker refused it; this does not count as an attempt."""
    _check_running(job, fence)
    lease = _free_lease(job.lease, attempts=max(0, job.lease.attempts - 1), not_before=now + pause_s)
    return _change_state(replace(job, lease=lease), State.CANCELLED if _is_cancelling(job) else State.QUEUED, now)


def requeue_lost(job: Job, fence: int, why: Problem, *, now: float, retry: Retry) -> Change:
    """Queue the job again because its run was lost; FAILED with `why` when no attempts are left."""
    _check_running(job, fence)
    if _is_cancelling(job):
        return _change_state(replace(job, lease=_free_lease(job.lease)), State.CANCELLED, now)
    if job.lease.attempts >= retry.attempts:
        return _fail(job, why, now)
    lease = _free_lease(job.lease, not_before=now + retry.pause_after(job.lease.attempts))
    return _change_state(replace(job, lease=lease), State.QUEUED, now)


def request_cancel(job: Job, *, now: float) -> Change:
    """Cancel a job: at once while it is queued, else when its worker has stopped. No change if it has ended."""
    if job.ended or job.state is State.CANCELLING:
        return Change(job)
    job = replace(job, lease=replace(job.lease, cancel=True))
    return _change_state(job, State.CANCELLED if job.state is State.QUEUED else State.CANCELLING, now)


def apply_reports(job: Job, fence: int, reports: Iterable[Report], *, now: float, retry: Retry) -> Change:
    """Apply a worker's reports. Ignores those that are already known, and those after the end of the run."""
    _check_fence(job, fence)
    change = Change(job)
    for report in reports:
        if change.job.state not in RUNNING_STATES or report.seq <= change.job.lease.run_seq:
            continue
        after = _apply_report(change.job, report, now, retry)
        # The run_seq of a freed lease stays 0, because the next run counts from 1.
        seq = report.seq if after.job.state in RUNNING_STATES else 0
        change = Change(replace(after.job, lease=replace(after.job.lease, run_seq=seq)), change.events + after.events)
    return change


def _apply_report(job: Job, report: Report, now: float, retry: Retry) -> Change:
    match report:
        case RunHeartbeat():
            return Change(job)
        case RunProgress():
            fraction = max(job.fraction, min(1.0, max(0.0, report.fraction)))
            eta_s = round(max(0.0, report.eta_s), 1)
            job = replace(job, stage=report.stage or job.stage, fraction=fraction, eta_s=eta_s)
            return _add_event(job, "progress", now, losses=dict(report.losses), message=report.message)
        case AnchorsFound():
            anchors = {"xyz_m": list(report.xyz_m), "rgb": list(report.rgb)}
            return _add_event(job, "anchors", now, anchors=anchors)
        case VersionPublished():
            asset = {
                "key": report.key,
                "version": report.version,
                "state": report.state,
                "manifest": report.manifest,
                "collection": report.collection,
                "grade": report.grade and dict(report.grade),
                "held": report.held,
            }
            if asset in (job.preview, job.asset):  # a repeated run reports what the one before it published
                return Change(job)
            job = replace(job, preview=asset) if report.state == "preview" else replace(job, asset=asset)
            return _add_event(job, "published", now, asset=asset)
        case RunFinished():
            return _apply_finished(job, report, now)
        case RunFailed():
            return _apply_failed(job, report, now, retry)


def _apply_finished(job: Job, report: RunFinished, now: float) -> Change:
    asset = job.asset or job.preview
    if asset is None:
        nothing = RunFailed(report.seq, "NOTHING_PUBLISHED", say("worker_finished_without_publishing_asset"))
        return _apply_failed(job, nothing, now, Retry(attempts=0, pause_s=0.0))
    job = replace(job, asset=asset, warnings=report.warnings, seconds=dict(report.seconds), fraction=1.0, eta_s=0.0)
    return _change_state(replace(job, lease=_free_lease(job.lease)), State.SUCCEEDED, now)


def _apply_failed(job: Job, report: RunFailed, now: float, retry: Retry) -> Change:
    if report.code == DRAINING:  # a worker's restart must not cost the job an attempt
        return requeue_refused(job, job.lease.fence, now=now, pause_s=retry.pause_s)
    if report.code == JOB_YIELDED:
        ran_s = job.seconds.get(YIELDED, 0.0) + report.ran_s
        job = replace(job, seconds={**job.seconds, YIELDED: ran_s})
        return requeue_refused(job, job.lease.fence, now=now, pause_s=_YIELD_PAUSE_S)
    why = problem_of(report)
    # A run that was cancelled although nobody requested it counts as lost.
    if _is_cancelling(job) or report.retryable or report.code == CANCELLED:
        return requeue_lost(job, job.lease.fence, why, now=now, retry=retry)
    return _fail(job, why, now)


def _fail(job: Job, why: Problem, now: float) -> Change:
    """Mark the job as FAILED. If a preview was published it stays, and a hint in the error says so."""
    error = why.document()
    if job.preview is not None:
        error["hints"] = [*error["hints"], say("preview_stays_available_as_version", version=job.preview["version"])]
    return _change_state(replace(job, lease=_free_lease(job.lease), error=error), State.FAILED, now)


# Codes of what the capture or the request is at fault for begin so.
_CALLERS_FAULT = ("CAPTURE_", "ARCHIVE_", "IMAGE_", "PRESET_", "BUDGET_", "KEY_", "DOWNLOAD_", "EDITS_")


def problem_of(failure: RunFailed) -> Problem:
    """Return the problem of a failed run: status 422 where the capture or the request is at fault, else 500."""
    status = 422 if failure.code.startswith(_CALLERS_FAULT) else 500
    return Problem(
        status,
        failure.code,
        failure.message,
        retryable=failure.retryable,
        stage=failure.stage,
        file=failure.file,
        hints=failure.hints,
    )


def _check_fence(job: Job, fence: int) -> None:
    if fence != job.lease.fence:
        raise LeaseLost(f"{job.id} was leased again: its fence is {job.lease.fence}, not {fence}")


def _check_running(job: Job, fence: int) -> None:
    """Raises LeaseLost for an outdated fence, or when the run is over.

    A freed lease keeps its fence, so the fence alone cannot tell that the run has ended already.
    """
    _check_fence(job, fence)
    if job.state not in RUNNING_STATES:
        raise LeaseLost(f"{job.id} is {job.state}: the run with fence {fence} is over")


def _is_cancelling(job: Job) -> bool:
    return job.state is State.CANCELLING


def _free_lease(lease: Lease, **changes: Any) -> Lease:
    """Return the lease without an owner. The fence stays, because it must keep growing."""
    return replace(lease, **{"holder": "", "worker": "", "until": 0.0, "run_seq": 0, **changes})


def _change_state(job: Job, state: State, now: float) -> Change:
    if state not in NEXT_STATES[job.state]:
        raise IllegalTransition(f"{job.id} cannot go from {job.state} to {state}")
    return _add_event(replace(job, state=state), "state", now, error=job.error)


def _add_event(job: Job, kind: str, now: float, **data: Any) -> Change:
    """Add an event to the job. Every event repeats the job's state, stage, progress and times."""
    seq = job.last_event + 1
    elapsed_s = max(job.elapsed_s, now - job.created)
    job = replace(job, last_event=seq, updated=now, elapsed_s=elapsed_s)
    standing = {
        "state": job.state,
        "stage": job.stage,
        "fraction": job.fraction,
        "elapsed_s": round(elapsed_s, 3),
        "eta_s": job.eta_s,
    }
    return Change(job, (Event(job.id, seq, kind, now, {**standing, **data}),))


def create_job(job_id: str, order: Order, *, tenant: str, now: float) -> Change:
    """Create a tenant's job in the state QUEUED."""
    job = Job(job_id, order, created=now, updated=now, tenant=tenant, token=secrets.token_hex(_TOKEN_BYTES))
    return _add_event(job, "state", now, error=None)
