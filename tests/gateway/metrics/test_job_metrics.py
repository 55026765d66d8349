"""What is counted of jobs: their wait, the first look, their end by whose fault it is, lost runs."""

from __future__ import annotations

from dataclasses import replace

import pytest
from prometheus_client import CollectorRegistry

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.job import Job, Order, State
from capture2vr.gateway.jobs.reports import Report, RunFailed, RunFinished, VersionPublished
from capture2vr.gateway.jobs.state_machine import (
    Retry,
    apply_reports,
    create_job,
    lease_to_worker,
    request_cancel,
    requeue_lost,
)
from capture2vr.gateway.metrics.job_metrics import JobMetrics

_RETRY = Retry(2, 0.0)
_PREVIEW = VersionPublished(1, "dress", 1, "preview", "m")
_REFINED = VersionPublished(2, "dress", 2, "refined", "m")


@pytest.fixture
def registry() -> CollectorRegistry:
    return CollectorRegistry()


def leased(at: float, job: Job | None = None) -> Job:
    """A job that was created at 100 s, and is leased."""
    made = job or create_job("job_1", Order("cap_1", "dress"), tenant="ada", now=100.0).job
    return lease_to_worker(made, holder="gw", worker="w", now=at, lease_s=9).job


def run(metrics: JobMetrics, job: Job, at: float, *reports: Report) -> Job:
    after = apply_reports(job, job.lease.fence, reports, now=at, retry=_RETRY).job
    metrics.changed(job, after)
    return after


def test_the_wait_ends_with_the_first_lease_and_the_look_begins_with_the_first_version(
    registry: CollectorRegistry,
) -> None:
    metrics = JobMetrics(registry)
    job = leased(107.0)
    metrics.leased(job)
    job = run(metrics, job, 130.0, _PREVIEW)
    lost = requeue_lost(job, 1, Problem(503, "WORKER_LOST", "away"), now=140.0, retry=_RETRY).job
    metrics.run_lost(job)
    metrics.changed(job, lost)
    again = leased(150.0, lost)
    metrics.leased(again)
    run(metrics, again, 190.0, _REFINED, RunFinished(3, (), {"FITTING": 30.0}))
    for name, seconds in (("queue_wait", 7.0), ("first_look", 30.0), ("job", 90.0), ("stage", 30.0)):
        labels = {"job": {"state": "SUCCEEDED"}, "stage": {"stage": "FITTING"}}.get(name, {})
        assert registry.get_sample_value(f"capture2vr_{name}_seconds_sum", labels) == seconds
        assert registry.get_sample_value(f"capture2vr_{name}_seconds_count", labels) == 1
    assert registry.get_sample_value("capture2vr_runs_lost_total") == 1


@pytest.mark.parametrize(
    ("reports", "outcome"),
    [
        ((_PREVIEW, RunFinished(2)), "published"),
        ((RunFailed(1, "CAPTURE_DEGENERATE", "flat"),), "capture"),
        ((RunFailed(1, "FIT_DIVERGED", "away"),), "service"),
        ((), "cancelled"),
    ],
)
def test_an_end_is_counted_by_whose_fault_it_is(
    registry: CollectorRegistry, reports: tuple[Report, ...], outcome: str
) -> None:
    metrics = JobMetrics(registry)
    job = leased(101.0)
    if reports:
        run(metrics, job, 110.0, *reports)
    else:
        metrics.changed(job, request_cancel(replace(job, state=State.QUEUED), now=110.0).job)
    counted = {
        name: registry.get_sample_value("capture2vr_jobs_ended_total", {"outcome": name})
        for name in ("published", "cancelled", "capture", "service")
    }
    assert counted == {**dict.fromkeys(counted, 0.0), outcome: 1.0}
