"""What gateways tell each other of a job's change, at the moment when it is committed."""

from __future__ import annotations

from sqlalchemy.engine import Connection

from capture2vr.gateway.database.postgres_notify import can_notify, notify
from capture2vr.gateway.jobs.job import Job, State

PAUSED = "PAUSED"
"""What is told of a job that is queued again, but waits for its next attempt; of others it is the state."""
CHANNEL = "capture2vr_jobs"
"""Where it is told."""


def announce(db: Connection, origin: str, job: Job) -> None:
    """Notify all gateways of a job's change, once this transaction is committed. Does nothing on other databases.

    origin  the store that writes: it need not be told
    """
    if can_notify(db.engine):
        is_paused = job.state is State.QUEUED and job.lease.not_before > job.updated
        notify(db, CHANNEL, f"{origin} {job.id} {PAUSED if is_paused else job.state.value}")
