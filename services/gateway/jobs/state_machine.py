"""The state machine of a job as pure functions: a job and what happened in, the job after it and its events out.

    QUEUED ──lease──> RUNNING ──finished──> SUCCEEDED
      ^  │              │ │ └──failed─────> FAILED
      │  │              │ └─request_cancel─> CANCELLING ──> CANCELLED, or SUCCEEDED when the run was faster
      │  └─request_cancel────────────────────────────────> CANCELLED
      └───set_back──────┘

Whoever writes about a run shows the fence of the lease under which it knows the run; an older one is `StaleFence`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from services.gateway.errors import Problem
from services.gateway.jobs.job import Event, Job, Lease, Order, State
from services.gateway.jobs.reports import CANCELLED, DRAINING, Beat, Failed, Finished, Progressed, Published, Report

NEXT: dict[State, frozenset[State]] = {
    State.QUEUED: frozenset({State.RUNNING, State.CANCELLED}),
    State.RUNNING: frozenset({State.QUEUED, State.CANCELLING, State.SUCCEEDED, State.FAILED}),
    State.CANCELLING: frozenset({State.CANCELLED, State.SUCCEEDED}),
    State.SUCCEEDED: frozenset(),
    State.FAILED: frozenset(),
    State.CANCELLED: frozenset(),
}
RUNS = frozenset({State.RUNNING, State.CANCELLING})
"""States in which a worker may be at work."""

_LONGEST_PAUSE_S = 60.0  # between attempts: a worker that is replaced within a minute gets the job


class StaleFence(Exception):  # noqa: N818 - it reads as what it is
    """Somebody else holds the job now; the bearer of this fence has nothing more to say about it."""


class IllegalTransition(Exception):  # noqa: N818 - it reads as what it is
    """A state that cannot follow; a fault of ours, never of a client."""


@dataclass(frozen=True, slots=True)
class Retry:
    """How often and how fast a job runs again: pauses of `pause_s` seconds, doubled with each of at most `attempts`."""

    attempts: int
    pause_s: float

    def after(self, attempt: int) -> float:
        """Seconds to wait after that attempt, 1 being the first."""
        doublings = min(max(attempt, 1) - 1, 32)  # a setting may allow thousands; a float does not
        return min(_LONGEST_PAUSE_S, self.pause_s * 2.0**doublings)


@dataclass(frozen=True, slots=True)
class Change:
    """A job after something happened, and the events that tell of it, oldest first."""

    job: Job
    events: tuple[Event, ...] = ()


def leased(job: Job, *, holder: str, worker: str, now: float, lease_s: float) -> Change:
    """Give a queued job to a worker."""
    lease = replace(
        job.lease,
        holder=holder,
        worker=worker,
        fence=job.lease.fence + 1,
        attempts=job.lease.attempts + 1,
        until=now + lease_s,
        run_seq=0,
    )
    return _enter(replace(job, lease=lease), State.RUNNING, now)


def taken_over(job: Job, *, holder: str, now: float, lease_s: float) -> Change:
    """Speak for a run that another gateway, or this one before its restart, has left alone. The run itself goes on."""
    if job.state not in RUNS:
        raise IllegalTransition(f"{job.id} is {job.state}: there is no run to take over")
    lease = replace(job.lease, holder=holder, fence=job.lease.fence + 1, until=now + lease_s)
    return Change(replace(job, lease=lease))


def turned_away(job: Job, fence: int, *, now: float, pause_s: float) -> Change:
    """The worker would not begin: back to the queue, and it was no attempt."""
    _check_run(job, fence)
    lease = _freed(job.lease, attempts=max(0, job.lease.attempts - 1), not_before=now + pause_s)
    return _enter(replace(job, lease=lease), State.CANCELLED if _unwanted(job) else State.QUEUED, now)


def set_back(job: Job, fence: int, why: Problem, *, now: float, retry: Retry) -> Change:
    """The run is lost: again later, or FAILED with `why` when the attempts are spent."""
    _check_run(job, fence)
    if _unwanted(job):
        return _enter(replace(job, lease=_freed(job.lease)), State.CANCELLED, now)
    if job.lease.attempts >= retry.attempts:
        return _given_up(job, why, now)
    lease = _freed(job.lease, not_before=now + retry.after(job.lease.attempts))
    return _enter(replace(job, lease=lease), State.QUEUED, now)


def cancel_requested(job: Job, *, now: float) -> Change:
    """Somebody wants it stopped: at once while it waits, else once its worker has let go. Nothing when it has ended."""
    if job.ended or job.state is State.CANCELLING:
        return Change(job)
    job = replace(job, lease=replace(job.lease, cancel=True))
    return _enter(job, State.CANCELLED if job.state is State.QUEUED else State.CANCELLING, now)


def reported(job: Job, fence: int, reports: Iterable[Report], *, now: float, retry: Retry) -> Change:
    """Take in what the worker reported. Reports that are already known, or that come after the end, change nothing."""
    _check(job, fence)
    change = Change(job)
    for report in reports:
        if change.job.state not in RUNS or report.seq <= change.job.lease.run_seq:
            continue
        after = _taken_in(change.job, report, now, retry)
        # A lease that was let go keeps its run_seq at 0: the next run counts anew.
        seq = report.seq if after.job.state in RUNS else 0
        change = Change(replace(after.job, lease=replace(after.job.lease, run_seq=seq)), change.events + after.events)
    return change


def _taken_in(job: Job, report: Report, now: float, retry: Retry) -> Change:
    match report:
        case Beat():
            return Change(job)
        case Progressed():
            fraction = max(job.fraction, min(1.0, max(0.0, report.fraction)))
            eta_s = round(max(0.0, report.eta_s), 1)
            job = replace(job, stage=report.stage or job.stage, fraction=fraction, eta_s=eta_s)
            return _tell(job, "progress", now, losses=dict(report.losses), message=report.message)
        case Published():
            asset = {
                "key": report.key,
                "version": report.version,
                "state": report.state,
                "manifest": report.manifest,
                "collection": report.collection,
            }
            if asset in (job.preview, job.asset):  # a run that began anew finds what the one before it published
                return Change(job)
            job = replace(job, preview=asset) if report.state == "preview" else replace(job, asset=asset)
            return _tell(job, "published", now, asset=asset)
        case Finished():
            return _finished(job, report, now)
        case Failed():
            return _failed(job, report, now, retry)


def _finished(job: Job, report: Finished, now: float) -> Change:
    asset = job.asset or job.preview
    if asset is None:
        nothing = Failed(report.seq, "NOTHING_PUBLISHED", "the worker finished without publishing anything")
        return _failed(job, nothing, now, Retry(attempts=0, pause_s=0.0))
    job = replace(job, asset=asset, warnings=report.warnings, seconds=dict(report.seconds), fraction=1.0, eta_s=0.0)
    return _enter(replace(job, lease=_freed(job.lease)), State.SUCCEEDED, now)


def _failed(job: Job, report: Failed, now: float, retry: Retry) -> Change:
    if report.code == DRAINING:  # a worker that is replaced must not cost the job an attempt
        return turned_away(job, job.lease.fence, now=now, pause_s=retry.pause_s)
    why = problem_of(report)
    # A run that was stopped although nobody here asked for it is a lost run.
    if _unwanted(job) or report.retryable or report.code == CANCELLED:
        return set_back(job, job.lease.fence, why, now=now, retry=retry)
    return _given_up(job, why, now)


def _given_up(job: Job, why: Problem, now: float) -> Change:
    """FAILED for good. What was published stays published, and whoever reads of the failure is told so."""
    error = why.document()
    if job.preview is not None:
        error["hints"] = [*error["hints"], f"the preview stays published, as version {job.preview['version']}"]
    return _enter(replace(job, lease=_freed(job.lease), error=error), State.FAILED, now)


def problem_of(failure: Failed) -> Problem:
    """The problem document of a failed run: a capture at fault is the client's to mend, the rest is ours."""
    status = 422 if failure.code.startswith(("CAPTURE_", "ARCHIVE_", "IMAGE_", "PRESET_", "BUDGET_", "KEY_")) else 500
    return Problem(
        status,
        failure.code,
        failure.message,
        retryable=failure.retryable,
        stage=failure.stage,
        file=failure.file,
        hints=failure.hints,
    )


def _check(job: Job, fence: int) -> None:
    if fence != job.lease.fence:
        raise StaleFence(f"{job.id} is under fence {job.lease.fence}, not {fence}")


def _check_run(job: Job, fence: int) -> None:
    """The fence stays when a lease is let go, so a second farewell under it must find no run."""
    _check(job, fence)
    if job.state not in RUNS:
        raise StaleFence(f"{job.id} is {job.state}: the run under fence {fence} is over")


def _unwanted(job: Job) -> bool:
    return job.state is State.CANCELLING


def _freed(lease: Lease, **changes: Any) -> Lease:
    """Nobody's lease. The fence stays: it must keep growing."""
    return replace(lease, **{"holder": "", "worker": "", "until": 0.0, "run_seq": 0, **changes})


def _enter(job: Job, state: State, now: float) -> Change:
    if state not in NEXT[job.state]:
        raise IllegalTransition(f"{job.id} cannot go from {job.state} to {state}")
    return _tell(replace(job, state=state), "state", now, error=job.error)


def _tell(job: Job, kind: str, now: float, **data: Any) -> Change:
    """The job with one more event about it; every event says where the job stands."""
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


def accepted(job_id: str, order: Order, *, now: float) -> Change:
    """A new job in the queue."""
    return _tell(Job(job_id, order, created=now, updated=now), "state", now, error=None)
