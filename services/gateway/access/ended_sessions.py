"""Sessions that were ended before they expired: a browser logged out, but its cookie may have been copied."""

from __future__ import annotations

import time

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.access.tables import ended_sessions
from capture2vr.gateway.database.database import for_writing, upsert


class EndedSessions:
    """Hashes of the cookies of ended sessions, in the database, until the cookies would have expired."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def end(self, sha256: str, until: float) -> None:
        """End a session. until: seconds since the epoch when its cookie expires"""
        with self._writer.begin() as db:
            db.execute(ended_sessions.delete().where(ended_sessions.c.until < time.time()))
            upsert(db, ended_sessions, {"sha256": sha256}, {"until": until})

    def has_ended(self, sha256: str) -> bool:
        """Return whether a session was ended."""
        with self._engine.begin() as db:
            wanted = sa.select(ended_sessions.c.sha256).where(ended_sessions.c.sha256 == sha256)
            return db.execute(wanted).first() is not None
