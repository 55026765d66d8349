"""Audit log: who changed what, from which address and when. Rows are only ever added.

Every request that changes something, or takes a capture or everything out, is one row, written before it is answered.
Requests that were refused for want of a key are in the request log only, so that strangers cannot fill the database.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.api_key import mask_keys
from capture2vr.gateway.access.caller import Caller
from capture2vr.gateway.database.database import for_writing
from capture2vr.gateway.records.tables import audit_log
from capture2vr.storage.tenant_store import DEFAULT_TENANT

_LOGINS = ("/v1/session", "/v1/pairings/claim")  # recorded without a key too: who tried to get in
_EXPORTS = ("/archive", "/export")  # ends of paths that take data out
_READS = ("GET", "HEAD", "OPTIONS")
_UPLOADS = "/v1/uploads/"  # where PATCH is a part of a film, which has hundreds; the request that begins it is recorded
PASSING = re.compile(r"/v1/scenes/[^/]+/moving")
"""Paths of what changes nothing: where a thing is while it is dragged, ten times a second."""
_PATH_CHARACTERS = 500

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """A request that changed something, or tried to.

    at       seconds since the epoch
    via, key as of `Caller`
    address  of the client, or of the proxy where the gateway does not trust it
    request  the X-Request-ID, under which the logs have the rest
    status   HTTP status of the answer
    """

    id: int
    at: float
    tenant: str
    via: str
    key: str
    address: str
    request: str
    method: str
    path: str
    status: int


class AuditStore:
    """The audit log in the SQL database. Methods block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row."""
        with self._writer.begin() as db:
            db.execute(audit_log.insert().values(dict(row)))

    def page(self, *, tenant: str | None, before: int, limit: int) -> list[AuditRecord]:
        """Return at most `limit` rows older than the row `before` (0: the newest), newest first; of all for None."""
        select = sa.select(audit_log).order_by(audit_log.c.id.desc()).limit(limit)
        if tenant is not None:
            select = select.where(audit_log.c.tenant == tenant)
        if before:
            select = select.where(audit_log.c.id < before)
        with self._engine.begin() as db:
            return [AuditRecord(**row._mapping) for row in db.execute(select)]


class AuditLog:
    """Records requests. Event loop only. store: the rows"""

    def __init__(self, store: AuditStore) -> None:
        self.store = store
        self._is_closed = False
        self._thread = ThreadPoolExecutor(1, "audit")

    def close(self) -> None:
        """Wait for rows in progress, then end the thread. From here on nothing is recorded."""
        self._is_closed = True
        self._thread.shutdown()

    async def record(self, scope: Mapping[str, Any], request: str, status: int) -> None:
        """Write the row of a request that is about to be answered, if it belongs into the log.

        A database that fails costs the row, not the answer: what was done is done.
        """
        caller: Caller | None = scope.get("state", {}).get("caller")
        if self._is_closed or not _belongs(scope["method"], scope["path"], caller):
            return
        client, append = scope.get("client"), self.store.append
        row = {
            "at": time.time(),
            "tenant": caller.tenant if caller else DEFAULT_TENANT,
            "via": caller.via if caller else "anonymous",
            "key": caller.key if caller else "",
            "address": client[0] if client else "",
            "request": request,
            "method": scope["method"],
            "path": mask_keys(scope["path"])[:_PATH_CHARACTERS],
            "status": status,
        }
        try:
            await asyncio.get_running_loop().run_in_executor(self._thread, append, row)
        except SQLAlchemyError as error:
            _log.error("the audit log has no row of %s %s: %s", row["method"], row["path"], error, extra=row)


def _belongs(method: str, path: str, caller: Caller | None) -> bool:
    if caller is None or caller.via == "anonymous":
        return path in _LOGINS and method not in _READS
    if method in _READS:
        return method == "GET" and path.endswith(_EXPORTS)
    is_part = method == "PATCH" and path.startswith(_UPLOADS)
    return not is_part and not PASSING.fullmatch(path)
