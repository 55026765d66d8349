"""Access store: tenants, access keys, pairings and the gateways' secrets in the SQL database.

Each method is one short transaction. They block; async code runs them on threads.
"""

from __future__ import annotations

import secrets as random
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine
from sqlalchemy.exc import IntegrityError

from capture2vr.gateway.access.api_key import KEY_PATTERN, ApiKey, hash_of, new_secret
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.ended_sessions import EndedSessions
from capture2vr.gateway.access.key_rows import ID_BYTES, insert_key, is_good, join_scopes, key_from
from capture2vr.gateway.access.pairing import Pairing, find_pairing, free_code, pairing_from
from capture2vr.gateway.access.tables import api_keys, pairings, secrets, tenants, usage
from capture2vr.gateway.database.database import for_writing, upsert
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import check_tenant

PAIRING_S = 300.0
"""Seconds in which a pairing can be claimed: a minute to fetch the headset, and some to type."""


@dataclass(frozen=True, slots=True)
class Tenant:
    """A tenant. created: seconds since the epoch; label: a name for people, or "" """

    name: str
    label: str
    created: float


class AccessStore:
    """Tenants, keys, pairings and secrets in one database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)
        self.sessions = EndedSessions(engine)

    def has_keys(self) -> bool:
        """Return whether a key was ever created: from then on the gateway asks for keys, even if all were revoked."""
        with self._engine.begin() as db:
            return db.execute(sa.select(api_keys.c.id).limit(1)).first() is not None

    def ensure_tenant(self, name: str, label: str = "") -> bool:
        """Create a tenant unless it exists; return whether it was created. Raises ValueError for an invalid name."""
        check_tenant(name)
        try:
            with self._writer.begin() as db:
                if _tenant(db, name):
                    return False
                db.execute(tenants.insert().values(name=name, label=label, created=time.time()))
                return True
        except IntegrityError:  # another process was faster
            return False

    def tenant(self, name: str) -> Tenant | None:
        """Return a tenant, or None."""
        with self._engine.begin() as db:
            return _tenant(db, name)

    def list_tenants(self, *, limit: int, after: str = "") -> list[Tenant]:
        """Return at most `limit` tenants whose names sort behind `after`."""
        select = sa.select(tenants).where(tenants.c.name > after).order_by(tenants.c.name).limit(limit)
        with self._engine.begin() as db:
            return [Tenant(row.name, row.label, row.created) for row in db.execute(select)]

    def own_limits(self, tenant: str) -> dict[str, Any] | None:
        """Return the limits that were set for a tenant alone; None where there are none."""
        with self._engine.begin() as db:
            found = db.execute(sa.select(tenants.c.limits).where(tenants.c.name == tenant)).scalar()
        return dict(found) if found else None

    def set_limits(self, tenant: str, limits: Mapping[str, Any]) -> None:
        """Set a tenant's own limits, in place of those it had; none: those of the settings hold."""
        with self._writer.begin() as db:
            values = dict(limits) if limits else sa.null()
            db.execute(tenants.update().where(tenants.c.name == tenant).values(limits=values))

    def retention(self, tenant: str) -> dict[str, int]:
        """Return after how many days what of a tenant is deleted, as it was set; {}: nothing was."""
        with self._engine.begin() as db:
            return dict(db.execute(sa.select(tenants.c.retention).where(tenants.c.name == tenant)).scalar() or {})

    def retentions(self) -> dict[str, dict[str, int]]:
        """Return what `retention` returns, of every tenant."""
        with self._engine.begin() as db:
            rows = db.execute(sa.select(tenants.c.name, tenants.c.retention))
            return {row.name: dict(row.retention or {}) for row in rows}

    def set_retention(self, tenant: str, days: Mapping[str, int]) -> None:
        """Set after how many days what of a tenant is deleted, in place of what held before."""
        with self._writer.begin() as db:
            values = dict(days) if days else sa.null()
            db.execute(tenants.update().where(tenants.c.name == tenant).values(retention=values))

    def usage(self, tenant: str) -> tuple[int, float] | None:
        """Return the bytes that a tenant stores, and when they were counted; None before the first count."""
        with self._engine.begin() as db:
            row = db.execute(sa.select(usage).where(usage.c.tenant == tenant)).first()
        return (row.stored_bytes, row.measured) if row else None

    def set_usage(self, tenant: str, stored_bytes: int, measured: float) -> None:
        """Store a count of the bytes that a tenant stores."""
        with self._writer.begin() as db:
            upsert(db, usage, {"tenant": tenant}, {"stored_bytes": stored_bytes, "measured": measured})

    def add_usage(self, tenant: str, stored_bytes: int) -> None:
        """Add bytes to a tenant's count, or subtract them; nothing before the first count.

        It never falls below 0: what is deleted may have been published since the last count.
        """
        with self._writer.begin() as db:
            total = usage.c.stored_bytes + stored_bytes
            positive = sa.case((total > 0, total), else_=0)
            db.execute(usage.update().where(usage.c.tenant == tenant).values(stored_bytes=positive))

    def ensure_key(self, secret: str, label: str) -> ApiKey:
        """Store this key with every scope, unless it is stored; return what is stored, which may be revoked.

        Raises ValueError for what is no key.
        """
        found = KEY_PATTERN.fullmatch(secret)
        if found is None:
            raise ValueError(say("no_access_key_one_c2v"))
        self.ensure_tenant(found["tenant"])
        if known := self.key_by_hash(hash_of(secret)):
            return known
        try:
            with self._writer.begin() as db:
                return insert_key(db, found["tenant"], frozenset(Scope), label, None, secret)
        except IntegrityError:  # another gateway was faster
            known = self.key_by_hash(hash_of(secret))
            if known is None:
                raise
            return known

    def create_key(
        self,
        tenant: str,
        scopes: Iterable[Scope],
        *,
        label: str = "",
        expires: float | None = None,
        replaces: ApiKey | None = None,
    ) -> tuple[ApiKey, str]:
        """Create a key of an existing tenant; return it and its secret, which is shown once and stored nowhere.

        replaces  a key whose place it takes: what was paired with that one ends with this one
        """
        secret = new_secret(tenant)
        with self._writer.begin() as db:
            if replaces is None:
                return insert_key(db, tenant, scopes, label, expires, secret), secret
            key = insert_key(db, tenant, scopes, label, expires, secret, replaces.parent)
            for table in (api_keys, pairings):
                db.execute(table.update().where(table.c.parent == replaces.id).values(parent=key.id))
            return key, secret

    def key_by_hash(self, sha256: str) -> ApiKey | None:
        """Return the key with this hash, or None."""
        with self._engine.begin() as db:
            return key_from(db.execute(sa.select(api_keys).where(api_keys.c.sha256 == sha256)).first())

    def key(self, key_id: str) -> ApiKey | None:
        """Return the key with this id, or None."""
        with self._engine.begin() as db:
            return key_from(db.execute(sa.select(api_keys).where(api_keys.c.id == key_id)).first())

    def list_keys(self, tenant: str | None, *, limit: int, after: str = "") -> list[ApiKey]:
        """Return at most `limit` keys of a tenant, or of all for None, whose ids sort behind `after`."""
        select = sa.select(api_keys).where(api_keys.c.id > after)
        if tenant is not None:
            select = select.where(api_keys.c.tenant == tenant)
        with self._engine.begin() as db:
            rows = db.execute(select.order_by(api_keys.c.id).limit(limit)).all()
        return [key for row in rows if (key := key_from(row))]

    def revoke_key(self, key_id: str, tenant: str | None) -> ApiKey | None:
        """Revoke a key of a tenant, or of any for None, and all that were paired with it, or with these; return it, or
        None where there is no such key. Idempotent."""
        mine = api_keys.c.id == key_id
        if tenant is not None:
            mine = sa.and_(mine, api_keys.c.tenant == tenant)
        with self._writer.begin() as db:
            below = sa.select(api_keys.c.id).where(mine).cte(recursive=True)
            below = below.union(sa.select(api_keys.c.id).where(api_keys.c.parent == below.c.id))
            ended = api_keys.c.id.in_(sa.select(below.c.id))
            db.execute(api_keys.update().where(ended, api_keys.c.revoked.is_(None)).values(revoked=time.time()))
            return key_from(db.execute(sa.select(api_keys).where(mine)).first())

    def expire_key(self, key_id: str, tenant: str | None, at: float) -> None:
        """Let a key expire at this time, unless it expires earlier."""
        mine = [api_keys.c.id == key_id, sa.or_(api_keys.c.expires.is_(None), api_keys.c.expires > at)]
        if tenant is not None:
            mine.append(api_keys.c.tenant == tenant)
        with self._writer.begin() as db:
            db.execute(api_keys.update().where(*mine).values(expires=at))

    def note_use(self, last_used: Mapping[str, float]) -> None:
        """Store when keys were used last, by their ids."""
        with self._writer.begin() as db:
            for key_id, at in last_used.items():
                earlier = sa.or_(api_keys.c.last_used.is_(None), api_keys.c.last_used < at)
                db.execute(api_keys.update().where(api_keys.c.id == key_id, earlier).values(last_used=at))

    def create_pairing(
        self, tenant: str, scopes: Iterable[Scope], *, label: str, key_expires: float | None, parent: str = ""
    ) -> tuple[Pairing, str]:
        """Create a pairing; return it, with its code of ten digits, and its token. No two at a time have one code.

        parent  id of the key that begins it
        """
        token, now = random.token_urlsafe(32), time.time()
        with self._writer.begin() as db:
            db.execute(pairings.delete().where(pairings.c.expires < now, pairings.c.key.is_(None)))
            taken = set(db.execute(sa.select(pairings.c.code).where(pairings.c.expires >= now)).scalars())
            values = {
                "id": f"pair_{random.token_hex(ID_BYTES)}",
                "tenant": tenant,
                "label": label,
                "scopes": join_scopes(scopes),
                "token_sha256": hash_of(token),
                "code": free_code(taken),
                "expires": now + PAIRING_S,
                "key_expires": key_expires,
                "key": None,
                "parent": parent or None,
            }
            db.execute(pairings.insert().values(values))
            return pairing_from(values), token

    def pairing(self, pairing_id: str, tenant: str) -> Pairing | None:
        """Return a tenant's pairing, or None."""
        with self._engine.begin() as db:
            return find_pairing(db, sa.and_(pairings.c.id == pairing_id, pairings.c.tenant == tenant))

    def claim_pairing(self, *, token: str = "", code: str = "") -> tuple[ApiKey, str] | None:
        """Claim a pairing by its token or its code: create its key and return it with its secret.

        None where there is no such pairing, it has expired or been claimed, or the key that began it has ended: each
        can be claimed once.
        """
        wanted = pairings.c.token_sha256 == hash_of(token) if token else pairings.c.code == code
        now = time.time()
        with self._writer.begin() as db:
            open_ones = sa.and_(wanted, pairings.c.expires > now, pairings.c.key.is_(None))
            found = find_pairing(db, open_ones, lock=True)
            if found is None or (found.parent and not is_good(db, found.parent, now)):
                return None
            secret = new_secret(found.tenant)
            key = insert_key(db, found.tenant, found.scopes, found.label, found.key_expires, secret, found.parent)
            db.execute(pairings.update().where(pairings.c.id == found.id).values(key=key.id))
            return key, secret

    def secret(self, name: str) -> str:
        """Return a secret that all gateways of this database share; made at first use: 256 bits as hex."""
        select = sa.select(secrets.c.value).where(secrets.c.name == name)
        with self._engine.begin() as db:
            found = db.execute(select).scalar()
        if found is not None:
            return str(found)
        try:
            with self._writer.begin() as db:
                db.execute(secrets.insert().values(name=name, value=random.token_hex(32)))
        except IntegrityError:  # another gateway was faster
            pass
        with self._engine.begin() as db:
            return str(db.execute(select).scalar_one())


def _tenant(db: Connection, name: str) -> Tenant | None:
    row = db.execute(sa.select(tenants).where(tenants.c.name == name)).first()
    return Tenant(row.name, row.label, row.created) if row else None
