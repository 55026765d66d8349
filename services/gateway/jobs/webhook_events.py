"""What webhooks tell of a job's events."""

from __future__ import annotations

from typing import Any

from services.gateway.jobs import job as nouns
from services.gateway.jobs.job import Job, State
from services.gateway.webhooks.outbox import Event

_TOLD = {State.RUNNING, State.SUCCEEDED, State.FAILED, State.CANCELLED}


def webhook_event(job: Job, event: nouns.Event) -> Event | None:
    """Return what webhooks are told of an event of a job; None for what they are not told, such as progress."""
    name = f"{job.id} {event.seq}"
    if event.kind == "published":
        return Event("asset.published", name, {**event.data["asset"], "job": job.id, "label": job.order.label})
    if event.kind == "state" and job.state in _TOLD:
        return Event(f"job.{job.state.lower()}", name, _job_data(job))
    return None


def _job_data(job: Job) -> dict[str, Any]:
    return {
        "job": job.id,
        "state": job.state,
        "asset_key": job.order.asset_key,
        "capture": job.order.capture,
        "preset": job.order.preset,
        "asset": job.asset or job.preview,
        "error": job.error,
    }
