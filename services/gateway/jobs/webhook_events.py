"""What webhooks tell of a job's events."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from capture2vr.gateway.jobs import job as nouns
from capture2vr.gateway.jobs.job import Job, State
from capture2vr.gateway.webhooks.outbox import WebhookEvent
from capture2vr.sentences.documents import with_codes

_TOLD = {State.RUNNING, State.SUCCEEDED, State.FAILED, State.CANCELLED}


def webhook_events(job: Job, events: Iterable[nouns.Event]) -> list[WebhookEvent]:
    """Convert the events of a job's change to webhook events; progress, for one, is left out."""
    return [told for event in events if (told := _webhook_event(job, event)) is not None]


def _webhook_event(job: Job, event: nouns.Event) -> WebhookEvent | None:
    name = f"{job.id} {event.seq}"
    if event.kind == "published":
        asset = event.data["asset"]
        data = {**with_codes(asset), "job": job.id, "label": job.order.options.names.label}
        return WebhookEvent("asset.held" if asset.get("held") else "asset.published", name, data)
    if event.kind == "state" and job.state in _TOLD:
        return WebhookEvent(f"job.{job.state.lower()}", name, _job_data(job))
    return None


def _job_data(job: Job) -> dict[str, Any]:
    return {
        "job": job.id,
        "state": job.state,
        "asset_key": job.order.asset_key,
        "capture": job.order.capture,
        "preset": job.order.options.preset,
        "asset": with_codes(job.asset or job.preview),
        "error": with_codes(job.error),
    }
