"""Prometheus metrics of jobs: how long they wait, when there is something to see, how they end, runs that are lost."""

from __future__ import annotations

from math import nan

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from capture2vr.gateway.jobs.job import Job, State
from capture2vr.gateway.jobs.job_counts import QueueFigures

_JOB_S = (1, 2, 5, 10, 20, 40, 60, 120, 300, 600, 1800, 3600, 21600)
_OUTCOMES = ("published", "cancelled", "capture", "service")
_SERVERS_FAULT = 500  # statuses from here on are no fault of the capture or the request


class JobMetrics:
    """The gateway's counters, gauges and histograms of jobs."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._jobs = Gauge("capture2vr_jobs", "Jobs by state", ["state"], registry=registry)
        self._queue = Gauge("capture2vr_queue_depth", "Jobs that wait for a worker", registry=registry)
        self._oldest = Gauge(
            "capture2vr_queue_oldest_seconds",
            "For how long the oldest of the jobs that wait has waited",
            registry=registry,
        )
        self._job_s = Histogram(
            "capture2vr_job_seconds", "Acceptance to end", ["state"], buckets=_JOB_S, registry=registry
        )
        self._stage_s = Histogram(
            "capture2vr_stage_seconds", "By stage of jobs that succeeded", ["stage"], buckets=_JOB_S, registry=registry
        )
        self._wait_s = Histogram(
            "capture2vr_queue_wait_seconds", "Acceptance to the first lease", buckets=_JOB_S, registry=registry
        )
        self._first_look_s = Histogram(
            "capture2vr_first_look_seconds",
            "Acceptance to the first published version",
            buckets=_JOB_S,
            registry=registry,
        )
        self._ended = Counter(
            "capture2vr_jobs_ended",
            "Jobs that ended: published, cancelled, failed by their capture's or request's fault, or by the service's",
            ["outcome"],
            registry=registry,
        )
        self._lost = Counter("capture2vr_runs_lost", "Runs that were lost with their worker", registry=registry)
        for outcome in _OUTCOMES:
            self._ended.labels(outcome)  # from 0, so that the first one counts as an increase

    def leased(self, job: Job) -> None:
        """Record how long a job has waited for its first lease."""
        if job.lease.fence == 1:
            self._wait_s.observe(max(0.0, job.updated - job.created))

    def changed(self, before: Job, after: Job) -> None:
        """Record the first version that a job has published, and its end."""
        if (after.preview or after.asset) and not (before.preview or before.asset):
            self._first_look_s.observe(after.elapsed_s)
        if after.ended and not before.ended:
            self._job_s.labels(after.state.value).observe(after.elapsed_s)
            self._ended.labels(outcome_of(after)).inc()
            for stage, seconds in after.seconds.items():
                self._stage_s.labels(stage).observe(seconds)

    def run_lost(self, job: Job) -> None:
        """Count a run that was lost with its worker."""
        self._lost.inc()

    def show_queue(self, found: QueueFigures | None) -> None:
        """Show the numbers of jobs, and for how long the oldest has waited; None: the database is away."""
        for state in State:
            self._jobs.labels(state.value).set(found.counts[state] if found else nan)
        self._queue.set(found.counts[State.QUEUED] if found else nan)
        self._oldest.set(found.waiting_s if found else nan)


def outcome_of(job: Job) -> str:
    """Return how a job has ended, as its counter has it."""
    if job.state is State.SUCCEEDED:
        return "published"
    if job.state is State.CANCELLED:
        return "cancelled"
    return "service" if (job.error or {}).get("status", _SERVERS_FAULT) >= _SERVERS_FAULT else "capture"
