"""The jobs on disk. Every method is one short transaction; callers keep them off the event loop (see desk.py)."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine
from sqlalchemy.exc import IntegrityError

from services.gateway.errors import Problem
from services.gateway.jobs.job import Event, Job, Order, State
from services.gateway.jobs.rows import WHOLE_JOB, event_of, event_values, job_of, job_values, lease_values
from services.gateway.jobs.tables import events, for_writing, idempotency, jobs, leases
from services.gateway.jobs.transitions import RUNS, Change, accepted

_EVENTS_AT_ONCE = 500  # a replay of hours in pieces of about 100 kB
_RUNS = [state.value for state in RUNS]


JOB_ID = re.compile(r"job_[0-9a-f]{32}")


def new_job_id(now: float) -> str:
    """Unguessable, and sorted by time: milliseconds, then 80 random bits."""
    return f"job_{int(now * 1000):012x}{os.urandom(10).hex()}"


class JobStore:
    """Jobs, leases, events and idempotency keys in one database.

    Whatever changes a job reads it, applies a pure transition and writes job, lease and events, or nothing at all.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)
        self._locks = engine.dialect.name != "sqlite"  # SQLite's writers are alone anyway

    def create(self, order: Order, *, key: str = "", body_sha256: str = "") -> Job:
        """A new job, or under a known idempotency key the one it made. Raises Problem IDEMPOTENCY_CONFLICT."""
        try:
            with self._writer.begin() as db:
                known = _by_key(db, key, body_sha256)
                return known or _insert(db, order, key, body_sha256)
        except IntegrityError:  # another process used the key between our look and our insert
            with self._engine.begin() as db:
                known = _by_key(db, key, body_sha256)
            if known is None:
                raise
            return known

    def by_key(self, key: str, body_sha256: str) -> Job | None:
        """The job made under an idempotency key. Raises Problem IDEMPOTENCY_CONFLICT when it was for something else."""
        with self._engine.begin() as db:
            return _by_key(db, key, body_sha256)

    def get(self, job: str) -> Job:
        """Raises Problem JOB_UNKNOWN."""
        with self._engine.begin() as db:
            return _get(db, WHOLE_JOB, job)

    def page(self, *, limit: int, after: str = "") -> list[Job]:
        """Newest first, those older than the job `after`."""
        select = WHOLE_JOB.order_by(jobs.c.id.desc()).limit(limit)
        with self._engine.begin() as db:
            return [job_of(row) for row in db.execute(select.where(jobs.c.id < after) if after else select)]

    def counts(self) -> dict[State, int]:
        """How many jobs there are in each state."""
        select = sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)
        with self._engine.begin() as db:
            found = {State(state): count for state, count in db.execute(select)}
        return {state: found.get(state, 0) for state in State}

    def change(self, job: str, transition: Callable[[Job], Change]) -> Job:
        """Apply a transition; what it raises leaves everything as it was. Raises Problem JOB_UNKNOWN."""
        with self._writer.begin() as db:
            select = WHOLE_JOB.with_for_update() if self._locks else WHOLE_JOB
            return _write(db, transition(_get(db, select, job)))

    def waiting(self, now: float) -> bool:
        """Whether a job could begin now."""
        with self._engine.begin() as db:
            return db.execute(_ready(now).limit(1)).first() is not None

    def claim(self, now: float, presets: Collection[str], transition: Callable[[Job], Change]) -> Job | None:
        """Apply a transition to the queue's oldest job of these presets that may begin; None when there is none."""
        return self._first(_ready(now).where(jobs.c.order["preset"].as_string().in_(presets)), transition)

    def claim_orphan(
        self, now: float, holder: str, ours: Iterable[str], transition: Callable[[Job], Change]
    ) -> Job | None:
        """Apply a transition to a run that nobody speaks for: its lease ran out, or `holder` held it in another life.

        ours: the runs that this process speaks for
        """
        forsaken = sa.or_(leases.c.until < now, leases.c.holder == holder)
        select = WHOLE_JOB.where(jobs.c.state.in_(_RUNS), forsaken, jobs.c.id.not_in(list(ours)))
        return self._first(select.order_by(jobs.c.id), transition)

    def renew(self, holder: str, until: float, running: Sequence[tuple[str, int]]) -> tuple[set[str], set[str]]:
        """Prolong the leases of these (job, fence). Those that are lost, and of the others those to be cancelled."""
        held = [sa.and_(leases.c.job == job, leases.c.fence == fence) for job, fence in running]
        with self._writer.begin() as db:
            mine = sa.and_(leases.c.holder == holder, sa.or_(sa.false(), *held))
            rows = db.execute(leases.update().where(mine).values(until=until).returning(leases.c.job, leases.c.cancel))
            kept: dict[str, bool] = {job: cancel for job, cancel in rows}  # noqa: C416 - rows are no pairs to mypy
        return {job for job, _ in running} - kept.keys(), {job for job, cancel in kept.items() if cancel}

    def since(self, job: str, after: int) -> tuple[Job, list[Event]]:
        """A job and its events beyond `after`, as of one moment. Raises Problem JOB_UNKNOWN."""
        with self._engine.begin() as db:
            return _get(db, WHOLE_JOB, job), _events(db, job, after)

    def newest_event(self) -> int:
        """Where the number line of all events stands."""
        with self._engine.begin() as db:
            return db.execute(sa.select(sa.func.max(events.c.id))).scalar_one() or 0

    def touched(self, after: int) -> tuple[int, set[str]]:
        """Where the number line of all events stands, and the jobs with an event beyond `after`."""
        select = sa.select(events.c.id, events.c.job).where(events.c.id > after)
        with self._engine.begin() as db:
            rows = db.execute(select).all()
        return max((number for number, _ in rows), default=after), {job for _, job in rows}

    def _first(self, select: sa.Select[Any], transition: Callable[[Job], Change]) -> Job | None:
        select = select.limit(1)
        if self._locks:
            select = select.with_for_update(skip_locked=True)
        with self._writer.begin() as db:
            row = db.execute(select).first()
            return _write(db, transition(job_of(row))) if row else None


def _ready(now: float) -> sa.Select[Any]:
    return WHOLE_JOB.where(jobs.c.state == State.QUEUED.value, leases.c.not_before <= now).order_by(jobs.c.id)


def _get(db: Connection, select: sa.Select[Any], job: str) -> Job:
    # What cannot be an id is not asked for: it comes from a URL, and Postgres refuses some characters in any text.
    row = db.execute(select.where(jobs.c.id == job)).first() if JOB_ID.fullmatch(job) else None
    if row is None:
        raise Problem(404, "JOB_UNKNOWN", f"there is no job {job}", hints=("GET /v1/jobs lists them",))
    return job_of(row)


def _events(db: Connection, job: str, after: int) -> list[Event]:
    select = sa.select(events).where(events.c.job == job, events.c.seq > after).order_by(events.c.seq)
    return [event_of(row) for row in db.execute(select.limit(_EVENTS_AT_ONCE))]


def _by_key(db: Connection, key: str, body_sha256: str) -> Job | None:
    row = db.execute(sa.select(idempotency).where(idempotency.c.key == key)).first() if key else None
    if row is None:
        return None
    if row.body_sha256 != body_sha256:
        raise Problem(
            409,
            "IDEMPOTENCY_CONFLICT",
            f"this Idempotency-Key was used for another request, which made {row.job}",
            hints=("use a new key for every new job",),
        )
    return _get(db, WHOLE_JOB, row.job)


def _insert(db: Connection, order: Order, key: str, body_sha256: str) -> Job:
    now = time.time()
    change = accepted(new_job_id(now), order, now=now)
    db.execute(jobs.insert().values(job_values(change.job)))
    db.execute(leases.insert().values(lease_values(change.job)))
    db.execute(events.insert(), [event_values(event) for event in change.events])
    if key:
        db.execute(idempotency.insert().values(key=key, body_sha256=body_sha256, job=change.job.id))
    return change.job


def _write(db: Connection, change: Change) -> Job:
    job = change.job
    db.execute(jobs.update().where(jobs.c.id == job.id).values(job_values(job)))
    db.execute(leases.update().where(leases.c.job == job.id).values(lease_values(job)))
    if change.events:
        db.execute(events.insert(), [event_values(event) for event in change.events])
    return job
