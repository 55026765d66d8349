"""When backups were made and proven, as a table of the database: metrics of every gateway show it."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.database.database import for_writing, insert_if_absent, metadata

backups = sa.Table(
    "backups",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("made", sa.Double, nullable=False),
    sa.Column("proven", sa.Double),
)

_MOST = 100  # rows that are kept


@dataclass(frozen=True, slots=True)
class BackupTimes:
    """When the newest backup was made, and when one was last proven by a drill, in seconds since the epoch.

    None where there was none.
    """

    made: float | None
    proven: float | None


class BackupRecords:
    """Records of backups in the SQL database. Methods block, and raise SQLAlchemyError."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def add(self, name: str, made: float) -> None:
        """Record a backup, and forget the oldest."""
        newest = sa.select(backups.c.name).order_by(backups.c.made.desc()).limit(_MOST)
        with self._writer.begin() as db:
            insert_if_absent(db, backups, {"name": name, "made": made})
            db.execute(backups.delete().where(backups.c.name.not_in(newest)))

    def prove(self, name: str, made: float, now: float) -> None:
        """Record that a drill has restored a backup."""
        self.add(name, made)
        with self._writer.begin() as db:
            db.execute(backups.update().where(backups.c.name == name).values(proven=now))

    def times(self) -> BackupTimes:
        """Return the newest times."""
        with self._engine.begin() as db:
            row = db.execute(sa.select(sa.func.max(backups.c.made), sa.func.max(backups.c.proven))).one()
        return BackupTimes(*row)
