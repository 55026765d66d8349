"""Share store: links by which somebody without a key reads one asset, one collection or one scene of a tenant.

Each method is one short transaction. They block; async code runs them on threads.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets as random
import time
from dataclasses import dataclass, field
from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.access.readers import Kind, Thing
from capture2vr.gateway.access.tables import shares
from capture2vr.gateway.database.database import for_writing

SHARE_ID = r"shr_[0-9a-f]{24}"
# scrypt as OWASP has it for 16 MB: some 50 ms of a guess.
_SCRYPT = {"n": 2**14, "r": 8, "p": 5, "maxmem": 64 << 20}

Mode = Literal["read", "place"]


@dataclass(frozen=True, slots=True)
class Share:
    """A share link. Times are seconds since the epoch.

    thing     what it opens
    mode      read: look at it; place: move it about in the viewer, too
    password  hash of the password, which `has_password` compares; "": none is asked for
    expires   it opens nothing from then on; None: never
    revoked   when it was revoked, or None
    opened    how often it was opened
    """

    id: str
    thing: Thing
    mode: Mode
    label: str
    password: str = field(repr=False)
    created: float
    expires: float | None
    revoked: float | None
    opened: int
    last_opened: float | None

    def refusal(self, now: float) -> str:
        """Return why the share opens nothing now: "revoked" or "expired"; "" where it does."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if self.expires is not None and self.expires <= now else ""

    def has_password(self, password: str) -> bool:
        """Return whether this is the share's password. Takes some 50 ms."""
        salt, _, expected = self.password.partition("$")
        return hmac.compare_digest(_scrypt(password, salt), expected)


class ShareStore:
    """The shares of all tenants."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def create(self, thing: Thing, *, mode: Mode, label: str, expires: float | None, password: str) -> Share:
        """Create a share. password: in clear; "": none"""
        now = time.time()
        values = {
            # Ids begin with the time of creation, so that lists are in its order.
            "id": f"shr_{int(now * 1000):012x}{random.token_hex(6)}",
            "tenant": thing.tenant,
            "kind": thing.kind,
            "name": thing.name,
            "mode": mode,
            "label": label,
            "password": _hashed(password) if password else "",
            "created": now,
            "expires": expires,
            "revoked": None,
            "opened": 0,
            "last_opened": None,
        }
        with self._writer.begin() as db:
            db.execute(shares.insert().values(values))
        return _share_from(values)

    def get(self, share: str) -> Share | None:
        """Return the share with this id, or None."""
        with self._engine.begin() as db:
            row = db.execute(sa.select(shares).where(shares.c.id == share)).first()
        return _share_from(dict(row._mapping)) if row else None

    def page(
        self, tenant: str, *, limit: int, after: str = "", kind: Kind | None = None, name: str = ""
    ) -> list[Share]:
        """Return at most `limit` shares of a tenant, or of one thing, whose ids sort behind `after`."""
        select = sa.select(shares).where(shares.c.tenant == tenant, shares.c.id > after)
        if kind:
            select = select.where(shares.c.kind == kind, shares.c.name == name)
        with self._engine.begin() as db:
            rows = db.execute(select.order_by(shares.c.id).limit(limit)).all()
        return [_share_from(dict(row._mapping)) for row in rows]

    def revoke(self, share: str, tenant: str) -> Share | None:
        """Revoke a tenant's share; return it, or None where there is no such share. Idempotent."""
        mine = sa.and_(shares.c.id == share, shares.c.tenant == tenant)
        with self._writer.begin() as db:
            db.execute(shares.update().where(mine, shares.c.revoked.is_(None)).values(revoked=time.time()))
            row = db.execute(sa.select(shares).where(mine)).first()
        return _share_from(dict(row._mapping)) if row else None

    def revoke_all(self, tenant: str, thing: Thing | None = None) -> None:
        """Revoke all shares of a tenant, or of one thing that is deleted: its name may come to mean another."""
        which = [shares.c.tenant == tenant, shares.c.revoked.is_(None)]
        if thing:
            which += [shares.c.kind == thing.kind, shares.c.name == thing.name]
        with self._writer.begin() as db:
            db.execute(shares.update().where(*which).values(revoked=time.time()))

    def count(self, share: str) -> None:
        """Count that a share was opened."""
        with self._writer.begin() as db:
            changes = {"opened": shares.c.opened + 1, "last_opened": time.time()}
            db.execute(shares.update().where(shares.c.id == share).values(changes))


def _share_from(row: dict[str, Any]) -> Share:
    rest = {name: value for name, value in row.items() if name not in ("tenant", "kind", "name")}
    return Share(thing=Thing(row["tenant"], row["kind"], row["name"]), **rest)


def _hashed(password: str) -> str:
    salt = random.token_hex(16)
    return f"{salt}${_scrypt(password, salt)}"


def _scrypt(password: str, salt: str) -> str:
    return hashlib.scrypt(password.encode(), salt=salt.encode(), dklen=32, **_SCRYPT).hex()
