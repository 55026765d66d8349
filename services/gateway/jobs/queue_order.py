"""Order of the queue: whose turn it is, and which of a tenant's jobs is next.

Each query reads one entry of the index (state, preset, tenant, id) for every tenant that waits, not every job: a claim
costs the same whether ten jobs are queued or ten thousand.

What belongs to a job or a lease is asked by a subquery, not by a join: Postgres would read all jobs or all leases for
it, unless its statistics are of just now.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.jobs.state_machine import RUNNING_STATES
from capture2vr.gateway.jobs.tables import jobs, leases, queue_turns

_not_before = sa.select(leases.c.not_before).where(leases.c.job == jobs.c.id).scalar_subquery()
_RUNS = [state.value for state in RUNNING_STATES]


@dataclass(frozen=True, slots=True)
class Queue:
    """What waits of a tenant. presets: of its queued jobs; served: when it had its last turn, 0: never"""

    presets: tuple[str, ...]
    served: float


@dataclass(frozen=True, slots=True)
class Running:
    """How many jobs run, by tenant and by the address of the worker."""

    by_tenant: Counter[str]
    by_worker: Counter[str]


def running_jobs(db: Connection) -> Running:
    """Count the jobs that run."""
    found = Running(Counter(), Counter())
    for tenant, worker, count in db.execute(_RUNNING):
        found.by_tenant[tenant] += count
        found.by_worker[worker] += count
    return found


def waiting_queues(db: Connection, presets: Collection[str]) -> dict[str, Queue]:
    """Return the queue of each tenant that has queued jobs of these presets."""
    found: dict[str, Queue] = {}
    for tenant, preset, served in db.execute(_WAITING):
        if preset in presets:
            before = found.get(tenant, Queue((), served or 0.0))
            found[tenant] = Queue((*before.presets, preset), before.served)
    return found


def turns(queues: Mapping[str, Queue], running: Running) -> list[str]:
    """Return the tenants in turn: first who has the fewest running jobs, then whose last turn is longest ago."""
    return sorted(queues, key=lambda tenant: (running.by_tenant[tenant], queues[tenant].served, tenant))


def by_oldest_job(db: Connection, tenant: str, presets: Sequence[str], now: float) -> list[str]:
    """Return a tenant's presets with jobs that may start now, that of the oldest job first."""
    if len(presets) == 1:
        return list(presets)
    oldest = {preset: oldest_ready(db, tenant, preset, now) for preset in presets}
    ids = {preset: job for preset, job in oldest.items() if job is not None}
    return sorted(ids, key=lambda preset: ids[preset])


def oldest_ready(db: Connection, tenant: str, preset: str, now: float, *, lock: bool = False) -> str | None:
    """Return the id of a tenant's oldest queued job of a preset that may start now; None where there is none.

    lock  whether to lock it, and pass over those that others have locked. SQLite has one writer, and no locks
    """
    which = {"of_tenant": tenant, "of_preset": preset, "now": now}
    found: str | None = db.execute(_OLDEST_READY_LOCKED if lock else _OLDEST_READY, which).scalar()
    return found


def earliest_start(db: Connection, now: float) -> float | None:
    """Return when a queued job may start: `now` if one may already; None where none is queued."""
    # A long queue has a job that is ready, and is not read to its end for it.
    if db.execute(_ANY_READY, {"now": now}).first():
        return now
    first: float | None = db.execute(_FIRST_START).scalar_one()
    return first


def oldest_queued(db: Connection) -> float | None:
    """Return when the job that has waited longest was created (seconds since the epoch); None where none is queued."""
    found: float | None = db.execute(_OLDEST_CREATED).scalar_one()
    return found


def job_waits(db: Connection, presets: Collection[str], now: float, *, has_run: bool) -> bool:
    """Return whether a queued job of these presets may start now.

    has_run  whether one counts, too, that had a lease before: it was lost, refused or made room for another
    """
    fence = sa.select(leases.c.fence).where(leases.c.job == jobs.c.id).scalar_subquery()
    which = sa.and_(jobs.c.state == State.QUEUED.value, jobs.c.preset.in_(presets), _not_before <= now)
    select = sa.select(jobs.c.id).where(which, sa.true() if has_run else fence == 0)
    return db.execute(select.limit(1)).first() is not None


def orphaned_jobs(now: float, holder: str, own_runs: Iterable[str]) -> sa.Select[str]:
    """Select the id of a running job whose lease has expired, or belongs to `holder`; none of `own_runs`."""
    lease = sa.select(sa.or_(leases.c.until < now, leases.c.holder == holder)).where(leases.c.job == jobs.c.id)
    select = sa.select(jobs.c.id).where(
        jobs.c.state.in_(_RUNS), lease.scalar_subquery(), jobs.c.id.not_in(list(own_runs))
    )
    # By id alone, Postgres would look for one among all jobs from the oldest, since few of them run.
    return select.order_by(jobs.c.preset, jobs.c.tenant, jobs.c.id).limit(1)


def _first_of_queues() -> sa.CTE:
    """Select the first job of each queue, of a preset and a tenant, from one to the next in the index; NULL at the end.

    That is a "loose index scan", which neither database does by itself. The order by preset and tenant, which only this
    index has, keeps Postgres from another one.
    """
    here, following = jobs.alias(), jobs.alias()
    found = sa.select(_first_queued(jobs).label("job")).cte("waiting", recursive=True)
    behind = sa.tuple_(following.c.preset, following.c.tenant) > sa.tuple_(here.c.preset, here.c.tenant)
    step = sa.select(_first_queued(following, behind).correlate(here))
    return found.union_all(step.select_from(found.join(here, here.c.id == found.c.job)))


def _waiting() -> sa.Select[Any]:
    """Select (tenant, preset, time of its last turn) of what waits."""
    found = _first_of_queues()
    tenant, preset = (_of_job(column, found) for column in (jobs.c.tenant, jobs.c.preset))
    waiting = sa.select(tenant.label("tenant"), preset.label("preset")).where(found.c.job.is_not(None)).subquery()
    select = sa.select(waiting.c.tenant, waiting.c.preset, queue_turns.c.served)
    return select.outerjoin(queue_turns, queue_turns.c.tenant == waiting.c.tenant)


def _oldest_created() -> sa.Select[Any]:
    """Select when the oldest of the first jobs of all queues was created."""
    found = _first_of_queues()
    created = sa.select(_of_job(jobs.c.created, found).label("created")).where(found.c.job.is_not(None)).subquery()
    return sa.select(sa.func.min(created.c.created))


def _of_job(column: sa.Column[Any], found: sa.CTE) -> sa.ScalarSelect[Any]:
    return sa.select(column).where(jobs.c.id == found.c.job).scalar_subquery()


def _first_queued(table: Any, *which: sa.ColumnElement[bool]) -> sa.ScalarSelect[str]:
    """Select the id of the first of these queued jobs in the index."""
    select = sa.select(table.c.id).where(table.c.state == State.QUEUED.value, *which)
    return select.order_by(table.c.preset, table.c.tenant, table.c.id).limit(1).scalar_subquery()


# Built once: SQLAlchemy takes a millisecond to build and look up the longest of them.
_worker = sa.select(leases.c.worker).where(leases.c.job == jobs.c.id).scalar_subquery().label("worker")
_RUNNING = (
    sa.select(jobs.c.tenant, _worker, sa.func.count()).where(jobs.c.state.in_(_RUNS)).group_by(jobs.c.tenant, _worker)
)
_WAITING = _waiting()
_OLDEST_CREATED = _oldest_created()
_OLDEST_READY = (
    sa.select(jobs.c.id)
    .where(
        jobs.c.state == State.QUEUED.value,
        jobs.c.preset == sa.bindparam("of_preset"),
        jobs.c.tenant == sa.bindparam("of_tenant"),
        _not_before <= sa.bindparam("now"),
    )
    .order_by(jobs.c.id)
    .limit(1)
)
_ANY_READY = (  # in the index's order, for which Postgres then takes it
    sa.select(jobs.c.id)
    .where(jobs.c.state == State.QUEUED.value, _not_before <= sa.bindparam("now"))
    .order_by(jobs.c.preset, jobs.c.tenant, jobs.c.id)
    .limit(1)
)
_FIRST_START = sa.select(sa.func.min(_not_before)).where(jobs.c.state == State.QUEUED.value)
_OLDEST_READY_LOCKED = _OLDEST_READY.with_for_update(skip_locked=True)
