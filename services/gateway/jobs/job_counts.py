"""Numbers of jobs by state, which triggers of the database keep: asked for in the same time however many there are."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.jobs.tables import job_counts, jobs


@dataclass(frozen=True, slots=True)
class QueueFigures:
    """How many jobs there are in each state. oldest: when the oldest queued one was created, None where none is"""

    counts: Mapping[State, int]
    oldest: float | None

    @property
    def waiting_s(self) -> float:
        """Seconds that the oldest queued job has waited; 0 where none is queued."""
        return max(0.0, time.time() - self.oldest) if self.oldest is not None else 0.0


_SUMS = sa.select(*(sa.func.coalesce(sa.func.sum(job_counts.c[state.lower()]), 0) for state in State))


def count_by_state(db: Connection) -> dict[State, int]:
    """Return the number of jobs in each state."""
    return {state: int(count) for state, count in zip(State, db.execute(_SUMS).one(), strict=True)}


def count_again(db: Connection) -> None:
    """Count all jobs, in place of what the triggers have counted: for who writes rows past them."""
    counted = sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)
    found: dict[str, int] = {state: count for state, count in db.execute(counted)}  # noqa: C416 - no pairs to mypy
    db.execute(job_counts.delete())
    db.execute(job_counts.insert().values(slot=0, **{state.lower(): found.get(state, 0) for state in State}))
