"""Delete what nobody needs of jobs that have ended: first the events of their progress, and some day the jobs.

A few jobs to a transaction, so that others who write wait for moments, however much there is to delete.
"""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.jobs.job import TERMINAL
from capture2vr.gateway.jobs.tables import ended_jobs, events, idempotency, jobs, leases

JOBS_AT_ONCE = 200
"""Jobs of a transaction, of some dozen rows each; SQLite takes at most 999 values in a statement."""

TICKS_PER_MS = 4096
"""Of the time in a job's id: as finely as a float has today's, so that jobs of one millisecond are in order too."""

_ENDED = [state.value for state in TERMINAL]
_PASSING = ("progress", "anchors")  # kinds of events that tell how far a job is; the others tell what became of it


def first_id(at: float) -> str:
    """Return an id above those of all jobs that were created before a time (seconds since the epoch), and of no other.

    Queries with it read a part of an index, where those by `created` would read every job.
    """
    return f"job_{max(0, int(at * 1000 * TICKS_PER_MS)):015x}"


def old_jobs(db: Connection, tenant: str, before: float) -> list[str]:
    """Return the ids of some of a tenant's jobs that ended before a time, the oldest first."""
    ended = sa.and_(jobs.c.state.in_(_ENDED), jobs.c.updated < before)
    # What ended before a time was created before it.
    select = sa.select(jobs.c.id).where(jobs.c.tenant == tenant, jobs.c.id < first_id(before), ended)
    return list(db.execute(select.order_by(jobs.c.id).limit(JOBS_AT_ONCE)).scalars())


def delete_jobs(db: Connection, ids: list[str]) -> list[str]:
    """Delete jobs with all that is known of them, but not those that others are writing now; return which are gone.

    They are locked first, as whoever changes a job does: in another order the two would wait for each other.
    """
    free = sa.select(jobs.c.id).where(jobs.c.id.in_(ids)).order_by(jobs.c.id).with_for_update(skip_locked=True)
    ids = list(db.execute(free).scalars())
    for column in (events.c.job, idempotency.c.job, leases.c.job, ended_jobs.c.job, jobs.c.id):
        db.execute(sa.delete(column.table).where(column.in_(ids)))
    return ids


def delete_progress(db: Connection, before: float) -> int:
    """Delete the events of progress of some jobs that ended before a time; return how many jobs these were.

    Whoever opens such a job's stream of events gets those of its states and of what it published.
    """
    select = sa.select(ended_jobs.c.job).where(ended_jobs.c.ended < before).order_by(ended_jobs.c.ended)
    ids = list(db.execute(select.limit(JOBS_AT_ONCE).with_for_update(skip_locked=True)).scalars())
    if ids:
        db.execute(events.delete().where(events.c.job.in_(ids), events.c.kind.in_(_PASSING)))
        db.execute(ended_jobs.delete().where(ended_jobs.c.job.in_(ids)))
    return len(ids)
