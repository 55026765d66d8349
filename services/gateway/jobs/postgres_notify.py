"""LISTEN/NOTIFY of Postgres: every gateway is told of a job's change at the moment when it is committed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from services.gateway.jobs.job import Job, State

PAUSED = "PAUSED"
"""What is told of a job that is queued again, but waits for its next attempt; of others it is the state."""

_CHANNEL = "capture2vr_jobs"
_RECONNECT_S = 1.0  # between attempts to connect again

_log = logging.getLogger(__name__)


def announce(db: Connection, origin: str, job: Job) -> None:
    """Notify all gateways of a job's change, once this transaction is committed. Does nothing on other databases.

    origin  the store that writes: it need not be told
    """
    if db.dialect.name == "postgresql":
        is_paused = job.state is State.QUEUED and job.lease.not_before > job.updated
        news = PAUSED if is_paused else job.state.value
        db.execute(sa.select(sa.func.pg_notify(_CHANNEL, f"{origin} {job.id} {news}")))


async def listen(
    engine: Engine, origin: str, *, on_change: Callable[[str, str], None], on_connected: Callable[[], None]
) -> None:
    """Call `on_change(job, news)` for every change of a job that another store announced, until cancelled.

    A connection that drops is opened again. on_connected: called whenever it listens, as changes before may be missed
    """
    import psycopg  # Here, because it is installed only where the database is Postgres.

    is_lost = False

    def connected() -> None:
        nonlocal is_lost
        is_lost = False
        on_connected()

    while True:
        try:
            await _listen_once(engine, origin, on_change, connected)
        except psycopg.Error as error:
            if not is_lost:
                _log.warning("the jobs database no longer tells of changes; connecting again: %s", error)
            is_lost = True
            await asyncio.sleep(_RECONNECT_S)


async def _listen_once(
    engine: Engine, origin: str, on_change: Callable[[str, str], None], on_connected: Callable[[], None]
) -> None:
    """Listen on one connection until it fails. Raises psycopg.Error."""
    import psycopg

    _, options = engine.dialect.create_connect_args(engine.url)
    async with await psycopg.AsyncConnection.connect(**options, autocommit=True) as connection:
        await connection.execute(f"LISTEN {_CHANNEL}")
        _log.info("the jobs database tells of changes by NOTIFY")
        on_connected()
        async for notification in connection.notifies():
            writer, job, news = notification.payload.split(" ")
            if writer != origin:
                on_change(job, news)
