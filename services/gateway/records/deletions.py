"""Receipts of deletions: what was deleted for good, and the URLs that a CDN must purge. They are kept."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.database.database import for_writing
from capture2vr.gateway.records.tables import deletions
from capture2vr.storage.catalogue.deletion import DeletedObject

_PUBLIC = ("assets/", "collections/")  # what a CDN may hold


@dataclass(frozen=True, slots=True)
class Deletion:
    """A deletion: its id, the tenant, when (seconds since the epoch), and the receipt as JSON."""

    id: str
    tenant: str
    at: float
    receipt: dict[str, Any]


class DeletionStore:
    """Receipts in the SQL database. Methods block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def add(self, tenant: str, receipt: dict[str, Any]) -> Deletion:
        """Store a receipt. Ids begin with the time, so that lists are in its order."""
        now = time.time()
        deletion = Deletion(f"del_{int(now * 1000):012x}{os.urandom(8).hex()}", tenant, now, receipt)
        values = {"id": deletion.id, "tenant": tenant, "at": now, "receipt": receipt}
        with self._writer.begin() as db:
            db.execute(deletions.insert().values(values))
        return deletion

    def page(self, tenant: str | None, *, after: str, limit: int) -> list[Deletion]:
        """Return at most `limit` receipts with ids behind `after`, oldest first; of all tenants for None."""
        select = sa.select(deletions).where(deletions.c.id > after).order_by(deletions.c.id).limit(limit)
        if tenant is not None:
            select = select.where(deletions.c.tenant == tenant)
        with self._engine.begin() as db:
            return [Deletion(**row._mapping) for row in db.execute(select)]


def receipt_of(what: str, deleted: Sequence[DeletedObject], **more: Any) -> dict[str, Any]:
    """Return the receipt of a deletion. what: for people and programs, as "asset dress" """
    return {
        "what": what,
        "bytes": sum(each.size for each in deleted),
        "objects": [each.name for each in deleted],
        "purge": [each.url for each in deleted if each.name.startswith(_PUBLIC)],
        **more,
    }
