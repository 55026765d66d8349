"""LISTEN/NOTIFY of Postgres: all gateways of one database are told at once what one of them has done."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

_RECONNECT_S = 1.0  # between attempts to connect again

_log = logging.getLogger(__name__)


def can_notify(engine: Engine) -> bool:
    """Return whether this database tells other gateways."""
    return engine.dialect.name == "postgresql"


def notify(db: Connection, channel: str, text: str) -> None:
    """Send a text of less than 8,000 bytes to all who listen, once this transaction is committed."""
    db.execute(sa.select(sa.func.pg_notify(channel, text)))


async def listen(
    engine: Engine, channels: Mapping[str, Callable[[str], None]], *, on_connected: Callable[[], None]
) -> None:
    """Call a channel's function with every text that is sent there, until cancelled.

    A connection that drops is opened again. on_connected: called whenever it listens, as texts before may be missed
    """
    import psycopg  # Here, because it is installed only where the database is Postgres.

    is_lost = False

    def connected() -> None:
        nonlocal is_lost
        is_lost = False
        on_connected()

    while True:
        try:
            await _listen_once(engine, channels, connected)
        except psycopg.Error as error:
            if not is_lost:
                _log.warning("the jobs database no longer tells of changes; connecting again: %s", error)
            is_lost = True
            await asyncio.sleep(_RECONNECT_S)


async def _listen_once(
    engine: Engine, channels: Mapping[str, Callable[[str], None]], on_connected: Callable[[], None]
) -> None:
    """Listen on one connection until it fails. Raises psycopg.Error."""
    import psycopg

    _, options = engine.dialect.create_connect_args(engine.url)
    async with await psycopg.AsyncConnection.connect(**options, autocommit=True) as connection:
        for channel in channels:
            await connection.execute(f"LISTEN {channel}")
        _log.info("the jobs database tells of changes by NOTIFY")
        on_connected()
        async for notification in connection.notifies():
            channels[notification.channel](notification.payload)
