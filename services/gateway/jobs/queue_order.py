"""Order of the queue: whose turn it is, and which of a tenant's jobs is next.

Each query reads one entry of the index (state, preset, tenant, id) for every tenant that waits, not every job: a claim
costs the same whether ten jobs are queued or ten thousand.

What a lease says is asked by a subquery, not by a join: Postgres would merge all jobs with all leases, from the oldest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from services.gateway.jobs.job import State
from services.gateway.jobs.state_machine import RUNNING_STATES
from services.gateway.jobs.tables import jobs, leases, queue_turns

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
    select = sa.select(jobs.c.tenant, leases.c.worker, sa.func.count()).join(leases)
    found = Running(Counter(), Counter())
    for tenant, worker, count in db.execute(
        select.where(jobs.c.state.in_(_RUNS)).group_by(jobs.c.tenant, leases.c.worker)
    ):
        found.by_tenant[tenant] += count
        found.by_worker[worker] += count
    return found


def waiting_queues(db: Connection, presets: Collection[str]) -> dict[str, Queue]:
    """Return the queue of each tenant that has queued jobs of these presets."""
    found: dict[str, Queue] = {}
    for tenant, preset, served in db.execute(_waiting(presets)):
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
    oldest = {preset: db.execute(oldest_ready(tenant, preset, now)).scalar() for preset in presets}
    ids = {preset: job for preset, job in oldest.items() if job is not None}
    return sorted(ids, key=lambda preset: ids[preset])


def oldest_ready(tenant: str, preset: str, now: float) -> sa.Select[str]:
    """Select the id of a tenant's oldest queued job of a preset that may start now."""
    queued = (jobs.c.state == State.QUEUED.value, jobs.c.preset == preset, jobs.c.tenant == tenant)
    return sa.select(jobs.c.id).where(*queued, _not_before <= now).order_by(jobs.c.id).limit(1)


def any_ready(now: float) -> sa.Select[str]:
    """Select the id of some queued job that may start now, in the index's order, for which Postgres then takes it."""
    queued = sa.select(jobs.c.id).where(jobs.c.state == State.QUEUED.value, _not_before <= now)
    return queued.order_by(jobs.c.preset, jobs.c.tenant, jobs.c.id).limit(1)


def first_start() -> sa.Select[float | None]:
    """Select when the first queued job may start."""
    return sa.select(sa.func.min(_not_before)).where(jobs.c.state == State.QUEUED.value)


def orphaned_jobs(now: float, holder: str, own_runs: Iterable[str]) -> sa.Select[str]:
    """Select the id of a running job whose lease has expired, or belongs to `holder`; none of `own_runs`."""
    lease = sa.select(sa.or_(leases.c.until < now, leases.c.holder == holder)).where(leases.c.job == jobs.c.id)
    select = sa.select(jobs.c.id).where(
        jobs.c.state.in_(_RUNS), lease.scalar_subquery(), jobs.c.id.not_in(list(own_runs))
    )
    # By id alone, Postgres would look for one among all jobs from the oldest, since few of them run.
    return select.order_by(jobs.c.preset, jobs.c.tenant, jobs.c.id).limit(1)


def _waiting(presets: Collection[str]) -> sa.Select[Any]:
    """Select (tenant, preset, time of its last turn) of what waits, from one to the next in the index.

    That is a "loose index scan", which neither database does by itself. The order by preset and tenant, which only this
    index has, keeps Postgres from another one.
    """
    here, following = jobs.alias(), jobs.alias()
    found = sa.select(_first_queued(jobs).label("job")).cte("waiting", recursive=True)
    behind = sa.tuple_(following.c.preset, following.c.tenant) > sa.tuple_(here.c.preset, here.c.tenant)
    step = sa.select(_first_queued(following, behind).correlate(here))
    found = found.union_all(step.select_from(found.join(here, here.c.id == found.c.job)))
    select = sa.select(jobs.c.tenant, jobs.c.preset, queue_turns.c.served).join(found, found.c.job == jobs.c.id)
    return select.outerjoin(queue_turns, queue_turns.c.tenant == jobs.c.tenant).where(jobs.c.preset.in_(presets))


def _first_queued(table: Any, *which: sa.ColumnElement[bool]) -> sa.ScalarSelect[str]:
    """Select the id of the first of these queued jobs in the index."""
    select = sa.select(table.c.id).where(table.c.state == State.QUEUED.value, *which)
    return select.order_by(table.c.preset, table.c.tenant, table.c.id).limit(1).scalar_subquery()
