"""Job store: jobs, leases and events in a SQL database. Each method is one short transaction.

The methods block; async code calls them through async_store.py.
"""

from __future__ import annotations

import math
import re
import secrets
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine
from sqlalchemy.exc import IntegrityError

from capture2vr.gateway.database.database import brief_wait, for_writing, pipelined, upsert
from capture2vr.gateway.database.postgres_notify import can_notify
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.ended_jobs import delete_jobs, delete_progress, first_id, old_jobs
from capture2vr.gateway.jobs.job import TERMINAL, Event, Job, Order, State
from capture2vr.gateway.jobs.job_counts import QueueFigures, count_by_state
from capture2vr.gateway.jobs.job_news import announce
from capture2vr.gateway.jobs.queue_order import (
    by_oldest_job,
    earliest_start,
    job_waits,
    oldest_queued,
    oldest_ready,
    orphaned_jobs,
    running_jobs,
    turns,
    waiting_queues,
)
from capture2vr.gateway.jobs.row_mapping import (
    WHOLE_JOB,
    event_from_row,
    event_values,
    job_from_row,
    job_values,
    lease_values,
)
from capture2vr.gateway.jobs.state_machine import RUNNING_STATES, Change, create_job
from capture2vr.gateway.jobs.tables import events, idempotency, jobs, leases, queue_turns
from capture2vr.gateway.jobs.webhook_events import webhook_events
from capture2vr.gateway.webhooks.outbox import enqueue, new_messages
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import DEFAULT_TENANT

_EVENTS_AT_ONCE = 500  # events per query, about 100 kB: a replay may have hours of them
_DAY_S = 86_400.0
_SLOTS_LOCK = 0x6332766C  # Postgres: first key of the locks of workers' slots; any number, only ours
_BUSY_RETRY_S = 30  # a job takes about a minute
_UNFINISHED = [state.value for state in State if state not in TERMINAL]
_LOCKED_JOB = WHOLE_JOB.with_for_update(of=jobs)  # SQLite has only one writer at a time, and ignores it
_UPDATE_JOB = jobs.update().where(jobs.c.id == sa.bindparam("changed"))
_UPDATE_LEASE = leases.update().where(leases.c.job == sa.bindparam("changed"))
# Without asking for what the database makes itself, such as the number of an event.
_INSERT_JOB, _INSERT_LEASE = jobs.insert().inline(), leases.insert().inline()
_INSERT_EVENT, _INSERT_KEY = events.insert().inline(), idempotency.insert().inline()

JOB_ID = re.compile(r"job_[0-9a-f]{32}")


def new_job_id(now: float) -> str:
    """Make a job id that cannot be guessed and sorts by creation time: 1/4096 milliseconds, then 68 random bits."""
    return f"{first_id(now)}{secrets.token_hex(9)[1:]}"


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a worker that is said to be free. slots: how many the worker has"""

    worker: str
    slots: int


class SlotTaken(Exception):  # noqa: N818 - it reads as what it is
    """Another gateway has leased a job to the worker's last slot, or is just doing so."""


@dataclass(frozen=True, slots=True)
class NextJob:
    """Which job to lease to a free slot, and how.

    presets  that the worker offers
    now      seconds since the epoch: jobs that wait for their next attempt until later are passed over
    lease    transition that leases the job
    """

    slot: Slot
    presets: frozenset[str]
    now: float
    lease: Callable[[Job], Change]


@dataclass(frozen=True, slots=True)
class QueueState:
    """Whether jobs wait for workers.

    start  when a queued job may start (seconds since the epoch): now, if one may already; None where none is queued
    taken  slots in use, by the address of the worker; counted only where a job may start now
    """

    start: float | None
    taken: Mapping[str, int]


class JobStore:
    """Jobs, leases, events and idempotency keys in one database.

    Every change of a job is one transaction: read the job, apply a pure transition, write job, lease and events.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)
        self.origin = secrets.token_hex(8)  # in the notifications of what is written here

    @property
    def engine(self) -> Engine:
        """The SQLAlchemy engine of the jobs database."""
        return self._engine

    @property
    def announces(self) -> bool:
        """Whether the database notifies other gateways of what is written."""
        return can_notify(self._engine)

    def create(
        self, tenant: str, order: Order, *, key: str = "", body_sha256: str = "", at_once: int = 0, per_day: int = 0
    ) -> Job:
        """Create a job of a tenant; for an idempotency key that it has used, return the job that was created with it.

        at_once, per_day  most jobs of the tenant that have not ended, and that were created within a day; 0: no limit
        Raises Problem IDEMPOTENCY_CONFLICT, JOBS_LIMITED.
        """
        try:
            with self._writer.connect() as db:
                known = _find_by_key(db, tenant, key, body_sha256)
                if known is None:
                    _check_limits(db, tenant, at_once, per_day)
                return known or self._insert(db, tenant, order, key, body_sha256)
        except IntegrityError:  # another process used the key between our query and our insert
            with self._engine.begin() as db:
                known = _find_by_key(db, tenant, key, body_sha256)
            if known is None:
                raise
            return known

    def find_by_key(self, tenant: str, key: str, body_sha256: str) -> Job | None:
        """Return the job that a tenant created with an idempotency key, or None.

        Raises Problem IDEMPOTENCY_CONFLICT when the key was used for a different request.
        """
        with self._engine.begin() as db:
            return _find_by_key(db, tenant, key, body_sha256)

    def get(self, tenant: str, job: str) -> Job:
        """Return a tenant's job. Raises Problem JOB_UNKNOWN."""
        with self._engine.begin() as db:
            return _get(db, _of(tenant), job)

    def page(self, tenant: str, *, limit: int, after: str = "") -> list[Job]:
        """Return at most `limit` jobs of a tenant that are older than the job `after`, newest first."""
        select = _of(tenant).order_by(jobs.c.id.desc()).limit(limit)
        with self._engine.begin() as db:
            return [job_from_row(row) for row in db.execute(select.where(jobs.c.id < after) if after else select)]

    def figures(self) -> QueueFigures:
        """Return the number of jobs in each state, and since when the oldest one waits."""
        with self._engine.begin() as db:
            return QueueFigures(count_by_state(db), oldest_queued(db))

    def failures(self, *, limit: int) -> list[Job]:
        """Return at most `limit` failed jobs of all tenants, the newest first."""
        select = WHOLE_JOB.where(jobs.c.state == State.FAILED.value).order_by(jobs.c.id.desc()).limit(limit)
        with self._engine.begin() as db:
            return [job_from_row(row) for row in db.execute(select)]

    def check_writable(self) -> None:
        """Write nothing, as a writer. Raises sqlalchemy.exc.DBAPIError where it is locked, read-only or away."""
        with self._writer.connect() as db, brief_wait(db), db.begin():
            db.execute(queue_turns.update().where(sa.false()).values(served=0.0))

    def load(self, tenant: str) -> tuple[int, int]:
        """Return how many jobs of a tenant have not ended, and how many it created within a day."""
        mine = sa.select(sa.func.count()).where(jobs.c.tenant == tenant)
        with self._engine.begin() as db:
            active = db.execute(_count_unfinished(tenant)).scalar_one()
            return active, db.execute(mine.where(jobs.c.id > first_id(time.time() - _DAY_S))).scalar_one()

    def unfinished(self, tenant: str, *, capture: str = "", asset_key: str = "") -> list[str]:
        """Return the ids of a tenant's jobs that have not ended; only of those for this capture or asset, if named."""
        select = sa.select(jobs.c.id).where(_unfinished(tenant))
        for name, value in (("capture", capture), ("asset_key", asset_key)):
            if value:
                select = select.where(jobs.c.order[name].as_string() == value)
        with self._engine.begin() as db:
            return [job for (job,) in db.execute(select.order_by(jobs.c.id))]

    def delete_ended(self, tenant: str, *, before: float) -> list[str]:
        """Delete some of a tenant's jobs that ended before this time (seconds since the epoch), the oldest first.

        All that is known of them goes. Returns their ids; none where none is left, or others write all of them now.
        """
        with self._engine.begin() as db:
            ids = old_jobs(db, tenant, before)
        if not ids:
            return []
        with self._writer.begin() as db:
            return delete_jobs(db, ids)

    def delete_progress(self, *, before: float) -> int:
        """Delete the events of progress of some jobs that ended before this time; return how many jobs these were."""
        with self._writer.begin() as db:
            return delete_progress(db, before)

    def change(self, job: str, transition: Callable[[Job], Change]) -> Job:
        """Apply a transition to a job and store the result; nothing if it raises. Raises Problem JOB_UNKNOWN."""
        with self._writer.connect() as db:
            return self._save(db, transition(_get(db, _LOCKED_JOB, job)))

    def end_run(self, job: str, transition: Callable[[Job], Change], following: NextJob) -> tuple[Job, Job | None]:
        """Apply a transition that ends a job's run, and lease the next job to the slot that is free then, all or none.

        Returns both jobs. The second is None where the run has not ended, where no job waits for this worker, and where
        another gateway has taken the slot.
        """
        with self._writer.connect() as db:
            ended = self._save(db, transition(_get(db, _LOCKED_JOB, job)), commit=False)
            found = None
            if ended.state not in RUNNING_STATES:
                with suppress(SlotTaken):
                    found = self._lease_next(db, following.now, following.presets, following.lease, following.slot)
            if found is None:
                db.commit()
        return ended, found

    def queue_state(self, now: float) -> QueueState:
        """Return whether jobs wait, and the slots that are taken."""
        with self._engine.begin() as db:
            start = earliest_start(db, now)
            is_ready = start is not None and start <= now
            return QueueState(start, running_jobs(db).by_worker if is_ready else {})

    def waits(self, now: float, presets: Collection[str], *, has_run: bool) -> bool:
        """Return whether a queued job of these presets may start now; has_run: one, too, that was leased before."""
        with self._engine.begin() as db:
            return job_waits(db, presets, now, has_run=has_run)

    def claim(
        self, now: float, presets: Collection[str], transition: Callable[[Job], Change], slot: Slot | None = None
    ) -> Job | None:
        """Apply a transition to the next queued job of these presets that may start; None when there is none.

        The tenants take turns: next is the oldest job of the tenant with the fewest running ones; of several tenants,
        of the one whose last turn is longest ago. So a tenant with one job waits for what runs already and no more.

        slot  for which the job is: gateways that see the same free slot at the same time would all give it a job, and
              all but one be refused by the worker. Raises SlotTaken.
        """
        with self._writer.connect() as db:
            return self._lease_next(db, now, presets, transition, slot)

    def claim_orphan(
        self, now: float, holder: str, own_runs: Iterable[str], transition: Callable[[Job], Change]
    ) -> Job | None:
        """Apply a transition to a running job without a supervisor; None when there is none.

        Its lease has expired, or belongs to `holder`, this gateway before its restart.
        own_runs: jobs that this process supervises
        """
        with self._writer.connect() as db:
            found = db.execute(orphaned_jobs(now, holder, own_runs).with_for_update(skip_locked=True)).scalar()
            job = _get(db, _LOCKED_JOB, found) if found is not None else None
            if job is None or (job.lease.until >= now and job.lease.holder != holder):  # or it was just renewed
                return None
            return self._save(db, transition(job))

    def renew(self, holder: str, until: float, running: Sequence[tuple[str, int]]) -> tuple[set[str], set[str]]:
        """Renew the leases of these (job, fence). Returns the jobs whose leases are lost, and those to be cancelled."""
        own_leases = [sa.and_(leases.c.job == job, leases.c.fence == fence) for job, fence in running]
        with self._writer.begin() as db:
            owned = sa.and_(leases.c.holder == holder, sa.or_(sa.false(), *own_leases))
            rows = db.execute(leases.update().where(owned).values(until=until).returning(leases.c.job, leases.c.cancel))
            renewed: dict[str, bool] = {job: cancel for job, cancel in rows}  # noqa: C416 - rows are no pairs to mypy
        return {job for job, _ in running} - renewed.keys(), {job for job, cancel in renewed.items() if cancel}

    def job_and_events(self, tenant: str, job: str, after: int) -> tuple[Job, list[Event]]:
        """Return a tenant's job and its events after number `after`, in one transaction. Raises Problem JOB_UNKNOWN."""
        with self._engine.begin() as db:
            return _get(db, _of(tenant), job), _events(db, job, after)

    def newest_event_id(self) -> int:
        """Return the id of the newest event of all jobs, 0 if there is none."""
        with self._engine.begin() as db:
            return db.execute(sa.select(sa.func.max(events.c.id))).scalar_one() or 0

    def jobs_changed_since(self, after: int) -> tuple[int, set[str]]:
        """Return the id of the newest event, and the jobs that have events with an id above `after`."""
        select = sa.select(events.c.id, events.c.job).where(events.c.id > after)
        with self._engine.begin() as db:
            rows = db.execute(select).all()
        return max((number for number, _ in rows), default=after), {job for _, job in rows}

    def _insert(self, db: Connection, tenant: str, order: Order, key: str, body_sha256: str) -> Job:
        """Create a job and commit. Raises sqlalchemy.exc.IntegrityError where the key is used already."""
        now = time.time()
        change = create_job(new_job_id(now), order, tenant=tenant, now=now)
        job = change.job
        with pipelined(db):
            db.execute(_INSERT_JOB, job_values(job))
            db.execute(_INSERT_LEASE, lease_values(job))
            _insert_events(db, change)
            if key:
                used = {"key": _stored_key(tenant, key), "body_sha256": body_sha256, "job": job.id}
                db.execute(_INSERT_KEY, used)
            announce(db, self.origin, job)
            db.commit()
        return job

    def _lease_next(
        self,
        db: Connection,
        now: float,
        presets: Collection[str],
        transition: Callable[[Job], Change],
        slot: Slot | None,
    ) -> Job | None:
        """Lease the next job and commit; None where there is none, and then nothing is committed. Raises SlotTaken."""
        if slot is not None:
            _lock_slot(db, slot)
        running = running_jobs(db)
        if slot is not None and running.by_worker[slot.worker] >= slot.slots:
            raise SlotTaken(slot.worker)
        queues = waiting_queues(db, presets)
        for tenant in turns(queues, running):
            for preset in by_oldest_job(db, tenant, queues[tenant].presets, now):
                job = oldest_ready(db, tenant, preset, now, lock=True)
                if job is not None:  # else all wait for their next attempt, or other gateways are just taking them
                    return self._save(db, transition(_get(db, WHOLE_JOB, job)), served=now)
        return None

    def _save(self, db: Connection, change: Change, *, served: float | None = None, commit: bool = True) -> Job:
        """Write a change, notify other gateways of it, and commit.

        served  when the job's tenant has had its turn
        """
        messages = _new_messages(db, change)
        with pipelined(db):
            if served is not None:
                upsert(db, queue_turns, {"tenant": change.job.tenant}, {"served": served})
            _write_rows(db, change, messages)
            if change.events:
                announce(db, self.origin, change.job)
            if commit:
                db.commit()
        return change.job


def _lock_slot(db: Connection, slot: Slot) -> None:
    """Lock a worker against other gateways until the transaction ends. Raises SlotTaken. SQLite has one writer."""
    if db.dialect.name == "postgresql":
        lock = sa.func.pg_try_advisory_xact_lock(_SLOTS_LOCK, sa.func.hashtext(slot.worker))
        if not db.execute(sa.select(lock)).scalar_one():
            raise SlotTaken(slot.worker)


def _check_limits(db: Connection, tenant: str, at_once: int, per_day: int) -> None:
    """Raises Problem JOBS_LIMITED where a tenant may create no job now."""
    if at_once and db.execute(_count_unfinished(tenant)).scalar_one() >= at_once:
        raise _jobs_limited(say("jobs_wait_run_already", count=at_once), _BUSY_RETRY_S)
    if per_day:
        now = time.time()
        recent = sa.select(jobs.c.created).where(jobs.c.tenant == tenant, jobs.c.id > first_id(now - _DAY_S))
        times = db.execute(recent.order_by(jobs.c.id.desc()).limit(per_day)).scalars().all()
        if len(times) == per_day:
            wait_s = math.ceil(times[-1] + _DAY_S - now)
            raise _jobs_limited(say("jobs_created_within_day", count=per_day), wait_s)


def _unfinished(tenant: str) -> sa.ColumnElement[bool]:
    """Return the condition for a tenant's jobs that have not ended.

    An expression in place of the tenant's column keeps databases from its index, where all that have ended are too.
    """
    return sa.and_(jobs.c.state.in_(_UNFINISHED), jobs.c.tenant.concat("") == tenant)


def _count_unfinished(tenant: str) -> sa.Select[int]:
    return sa.select(sa.func.count()).select_from(jobs).where(_unfinished(tenant))


def _jobs_limited(detail: str, retry_s: int) -> Problem:
    hints = (say("try_again_in_s", seconds=retry_s), say("ask_operator"))
    return Problem(429, "JOBS_LIMITED", detail, retryable=True, hints=hints, headers={"Retry-After": str(retry_s)})


def _of(tenant: str) -> sa.Select[Any]:
    return WHOLE_JOB.where(jobs.c.tenant == tenant)


def _get(db: Connection, select: sa.Select[Any], job: str) -> Job:
    # An invalid id is not queried: it comes from a URL, and Postgres refuses some characters in any text.
    row = db.execute(select.where(jobs.c.id == job)).first() if JOB_ID.fullmatch(job) else None
    if row is None:
        raise Problem(404, "JOB_UNKNOWN", say("no_job", job=job), hints=("GET /v1/jobs lists them",))
    return job_from_row(row)


def _events(db: Connection, job: str, after: int) -> list[Event]:
    select = sa.select(events).where(events.c.job == job, events.c.seq > after).order_by(events.c.seq)
    return [event_from_row(row) for row in db.execute(select.limit(_EVENTS_AT_ONCE))]


def _find_by_key(db: Connection, tenant: str, key: str, body_sha256: str) -> Job | None:
    which = idempotency.c.key == _stored_key(tenant, key)
    row = db.execute(sa.select(idempotency).where(which)).first() if key else None
    if row is None:
        return None
    if row.body_sha256 != body_sha256:
        raise Problem(
            409,
            "IDEMPOTENCY_CONFLICT",
            f"this Idempotency-Key was used for a different request, which created {row.job}",
            hints=("use a new Idempotency-Key for every new job",),
        )
    return _get(db, _of(tenant), row.job)


def _stored_key(tenant: str, key: str) -> str:
    """Return an idempotency key as it is stored. No key has a space, so no two tenants can have one."""
    return key if tenant == DEFAULT_TENANT else f"{tenant} {key}"


def update_rows(db: Connection, change: Change) -> None:
    """Write a changed job, its lease, its events and the webhook messages about them."""
    _write_rows(db, change, _new_messages(db, change))


def _new_messages(db: Connection, change: Change) -> list[dict[str, Any]]:
    """Return what webhooks are told of a change, as rows of the outbox."""
    return new_messages(db, change.job.tenant, webhook_events(change.job, change.events))


def _write_rows(db: Connection, change: Change, messages: Iterable[Mapping[str, Any]]) -> None:
    job = change.job
    db.execute(_UPDATE_JOB, {"changed": job.id, **job_values(job)})
    db.execute(_UPDATE_LEASE, {"changed": job.id, **lease_values(job)})
    _insert_events(db, change)
    enqueue(db, messages)


def _insert_events(db: Connection, change: Change) -> None:
    for event in change.events:
        db.execute(_INSERT_EVENT, event_values(event))
