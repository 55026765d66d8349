"""Order of the queue: whose turn it is, and which of a tenant's jobs is next.

Each query reads one entry of the index (state, preset, tenant, id) for every tenant that waits, not every job: a claim
costs the same whether ten jobs are queued or ten thousand.

What a lease says is asked by a subquery, not by a join: Postgres would merge all jobs with all leases, from the oldest.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from services.gateway.jobs.job import State
from services.gateway.jobs.state_machine import RUNNING_STATES
from services.gateway.jobs.tables import jobs, leases, queue_turns

_not_before = sa.select(leases.c.not_before).where(leases.c.job == jobs.c.id).scalar_subquery()
_RUNS = [state.value for state in RUNNING_STATES]

Queues = Mapping[str, Sequence[str]]
"""Tenant -> presets of which it has queued jobs."""


def waiting_queues(db: Connection, presets: Collection[str]) -> Queues:
    """Return the tenants with queued jobs of these presets, and which."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for preset in sorted(presets):
        for (tenant,) in db.execute(_tenants_waiting(preset)):
            found[tenant].append(preset)
    return found


def turns(db: Connection, queues: Queues) -> list[str]:
    """Return the tenants in turn: first who has the fewest running jobs, then whose last turn is longest ago."""
    tenants = list(queues)
    if len(tenants) < 2:
        return tenants
    running = sa.select(jobs.c.tenant, sa.func.count()).where(jobs.c.state.in_(_RUNS)).group_by(jobs.c.tenant)
    counts: dict[str, int] = {row[0]: row[1] for row in db.execute(running)}
    last = sa.select(queue_turns.c.tenant, queue_turns.c.served).where(queue_turns.c.tenant.in_(tenants))
    served: dict[str, float] = {row.tenant: row.served for row in db.execute(last)}
    return sorted(tenants, key=lambda tenant: (counts.get(tenant, 0), served.get(tenant, 0.0), tenant))


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


def _tenants_waiting(preset: str) -> sa.Select[Any]:
    """Select the tenants with queued jobs of a preset, from one to the next in the index ("loose index scan")."""
    following = jobs.alias()

    def first(table: Any) -> sa.Select[Any]:
        queued = (table.c.state == State.QUEUED.value, table.c.preset == preset)
        return sa.select(sa.func.min(table.c.tenant)).where(*queued)

    found = sa.select(first(jobs).scalar_subquery().label("tenant")).cte("waiting", recursive=True)
    after = first(following).where(following.c.tenant > found.c.tenant).correlate(found).scalar_subquery()
    found = found.union_all(sa.select(after).where(found.c.tenant.is_not(None)))
    return sa.select(found.c.tenant).where(found.c.tenant.is_not(None))
