"""Upload store: what each resumable upload is, how many bytes of it are acknowledged, and who writes it. Methods block.

Several gateways share it. A PATCH takes the upload over: it becomes the upload's writer, and whoever wrote before is
refused at his next chunk. So a client whose connection has died need not wait until the server notices. Making the
capture is leased instead, because two that do it at once would do all the work twice.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.database.database import for_writing
from capture2vr.gateway.resumable.tables import chunks, uploads

LEASE_S = 30.0
"""Seconds for which a capture's making is leased; renewed while it goes on."""


@dataclass(frozen=True, slots=True)
class Upload:
    """A resumable upload. Times are seconds since the epoch.

    received  bytes that are acknowledged: they are on the store
    metadata  of its creation: filename, filetype, name, collection, …
    capture   id of the capture that it became or is to become; "": not asked for yet
    finished  whether that capture is stored
    """

    id: str
    tenant: str
    length: int
    received: int
    metadata: Mapping[str, str]
    expires: float
    capture: str
    finished: bool


@dataclass(frozen=True, slots=True)
class Chunk:
    """A part of an upload, which is an object on the store. writer: of the PATCH that sent it"""

    start: int
    length: int
    writer: str


class UploadStore:
    """Resumable uploads in the database. A tenant sees its own alone."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def create(self, tenant: str, length: int, metadata: Mapping[str, str], expires: float, most: int) -> Upload | None:
        """Create an upload without bytes; None where the tenant has `most` unfinished ones."""
        upload = Upload(f"upl_{secrets.token_hex(16)}", tenant, length, 0, dict(metadata), expires, "", False)
        with self._writer.begin() as db:
            count = sa.select(sa.func.count()).where(uploads.c.tenant == tenant, uploads.c.ended.is_(None))
            if db.execute(count).scalar_one() >= most:
                return None
            values = {"length": length, "received": 0, "metadata": dict(metadata), "expires": expires, "swept": False}
            names = {"writer": "", "finisher": "", "finisher_until": 0.0, "capture": ""}
            db.execute(uploads.insert().values(id=upload.id, tenant=tenant, **values, **names))
        return upload

    def get(self, tenant: str, upload: str, now: float) -> Upload | None:
        """Return an upload; None where there is none: removed or expired ones are not there either."""
        mine = (uploads.c.id == upload, uploads.c.tenant == tenant)
        with self._engine.begin() as db:
            row = db.execute(sa.select(uploads).where(*mine, _is_there(now))).first()
        return _upload(row) if row else None

    def take_over(self, upload: Upload, writer: str) -> bool:
        """Make somebody the writer of an upload that has received so many bytes; False where it has changed."""
        same = (uploads.c.id == upload.id, uploads.c.received == upload.received, uploads.c.ended.is_(None))
        with self._writer.begin() as db:
            return db.execute(uploads.update().where(*same).values(writer=writer)).rowcount == 1

    def append(self, upload: str, received: int, added: Sequence[Chunk], expires: float) -> bool:
        """Acknowledge chunks of one writer that go on behind the `received` bytes; False where he is no longer it.

        The first may begin earlier, and then takes the place of the chunks that it was joined with: their objects may
        be deleted once this has returned.
        """
        first, end = added[0], added[-1].start + added[-1].length
        same = (uploads.c.id == upload, uploads.c.writer == first.writer, uploads.c.received == received)
        with self._writer.begin() as db:
            update = uploads.update().where(*same, uploads.c.ended.is_(None))
            if db.execute(update.values(received=end, expires=expires)).rowcount != 1:
                return False
            db.execute(chunks.delete().where(chunks.c.upload == upload, chunks.c.start >= first.start))
            rows = [{"upload": upload, "start": c.start, "length": c.length, "writer": c.writer} for c in added]
            db.execute(chunks.insert(), rows)
        return True

    def chunks(self, upload: str) -> list[Chunk]:
        """Return the acknowledged chunks of an upload, in their order."""
        select = sa.select(chunks).where(chunks.c.upload == upload).order_by(chunks.c.start)
        with self._engine.begin() as db:
            return [Chunk(row.start, row.length, row.writer) for row in db.execute(select)]

    def lease(self, upload: Upload, finisher: str, capture: str, now: float) -> Upload | None:
        """Lease the making of a complete upload's capture; None where somebody else has the lease.

        capture  its id, where it has none yet. It stays: who goes on after a crash makes no second capture
        """
        free = (uploads.c.id == upload.id, uploads.c.received == uploads.c.length, uploads.c.finisher_until <= now)
        kept = sa.case((uploads.c.capture == "", capture), else_=uploads.c.capture)
        values = {"finisher": finisher, "finisher_until": now + LEASE_S, "capture": kept}
        with self._writer.begin() as db:
            update = uploads.update().where(*free, uploads.c.ended.is_(None)).values(values)
            if db.execute(update).rowcount != 1:
                return None
            return _upload(db.execute(sa.select(uploads).where(uploads.c.id == upload.id)).one())

    def renew(self, upload: str, finisher: str, until: float) -> None:
        """Renew a lease; it ends at once where `until` is past."""
        mine = (uploads.c.id == upload, uploads.c.finisher == finisher)
        with self._writer.begin() as db:
            db.execute(uploads.update().where(*mine).values(finisher_until=until))

    def finish(self, upload: str, now: float) -> bool:
        """Record that an upload's capture is stored; False where that was recorded before."""
        with self._writer.begin() as db:
            update = uploads.update().where(uploads.c.id == upload, uploads.c.ended.is_(None))
            return db.execute(update.values(ended=now)).rowcount == 1

    def remove(self, upload: Upload, now: float) -> bool:
        """Remove an upload, of which nothing is there afterwards; False while its capture is being made."""
        idle = (uploads.c.id == upload.id, uploads.c.finisher_until <= now)
        with self._writer.begin() as db:
            ended = sa.func.coalesce(uploads.c.ended, now)
            return db.execute(uploads.update().where(*idle).values(ended=ended, capture="")).rowcount == 1

    def remove_all(self, tenant: str, now: float) -> None:
        """Remove all uploads of a tenant; their chunks are to be swept then."""
        with self._writer.begin() as db:
            ended = sa.func.coalesce(uploads.c.ended, now)
            db.execute(uploads.update().where(uploads.c.tenant == tenant).values(ended=ended, capture=""))

    def remove_expired(self, now: float) -> list[Upload]:
        """Remove the uploads that have expired, and return them."""
        late = (uploads.c.expires <= now, uploads.c.ended.is_(None), uploads.c.finisher_until <= now)
        with self._writer.begin() as db:
            found = [_upload(row) for row in db.execute(sa.select(uploads).where(*late).with_for_update())]
            ids = [upload.id for upload in found]
            db.execute(uploads.update().where(uploads.c.id.in_(ids)).values(ended=now, capture=""))
        return found

    def to_sweep(self, kept_since: float) -> list[Upload]:
        """Return the ended uploads whose chunks may still be on the store, or that ended before `kept_since`."""
        due = sa.or_(uploads.c.swept.is_(False), uploads.c.ended < kept_since)
        with self._engine.begin() as db:
            return [_upload(row) for row in db.execute(sa.select(uploads).where(uploads.c.ended.is_not(None), due))]

    def swept(self, upload: str, kept_since: float) -> None:
        """Record that an ended upload's chunks are off the store; forget one that ended before `kept_since`."""
        with self._writer.begin() as db:
            db.execute(chunks.delete().where(chunks.c.upload == upload))
            db.execute(uploads.update().where(uploads.c.id == upload).values(swept=True))
            db.execute(uploads.delete().where(uploads.c.id == upload, uploads.c.ended < kept_since))


def _is_there(now: float) -> sa.ColumnElement[bool]:
    """Whether an upload can be asked for: finished, or neither removed nor expired."""
    unfinished = sa.and_(uploads.c.ended.is_(None), uploads.c.expires > now)
    return sa.or_(unfinished, sa.and_(uploads.c.ended.is_not(None), uploads.c.capture != ""))


def _upload(row: Any) -> Upload:
    names = ("id", "tenant", "length", "received", "metadata", "expires", "capture")
    finished = row.ended is not None and row.capture != ""
    return Upload(**{name: getattr(row, name) for name in names}, finished=finished)
