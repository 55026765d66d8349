"""Rows of access keys in the database."""

from __future__ import annotations

import secrets as random
import time
from collections.abc import Iterable
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.access.api_key import ApiKey, hash_of
from capture2vr.gateway.access.caller import Scope, parse_scopes, scope_names
from capture2vr.gateway.access.tables import api_keys

ID_BYTES = 8


def is_good(db: Connection, key_id: str, now: float) -> bool:
    """Return whether there is a key with this id that is neither revoked nor expired."""
    key = key_from(db.execute(sa.select(api_keys).where(api_keys.c.id == key_id)).first())
    return key is not None and not key.refusal(now)


def insert_key(
    db: Connection,
    tenant: str,
    scopes: Iterable[Scope],
    label: str,
    expires: float | None,
    secret: str,
    parent: str | None = None,
) -> ApiKey:
    """Add a key, by its hash. parent: id of the key that a device was paired with"""
    key = ApiKey(
        # Ids begin with the time of creation, so that lists are in its order.
        id=f"key_{int(time.time() * 1000):012x}{random.token_hex(ID_BYTES)}",
        tenant=tenant,
        label=label,
        sha256=hash_of(secret),
        scopes=frozenset(scopes),
        created=time.time(),
        expires=expires,
        parent=parent,
    )
    values = {column.name: getattr(key, column.name) for column in api_keys.c}
    db.execute(api_keys.insert().values({**values, "scopes": join_scopes(key.scopes)}))
    return key


def key_from(row: sa.Row[Any] | None) -> ApiKey | None:
    """Make a key from its row; None where there is none."""
    return ApiKey(**{**row._mapping, "scopes": parse_scopes(row.scopes.split())}) if row else None


def join_scopes(scopes: Iterable[Scope]) -> str:
    """Write scopes as they lie in the database."""
    return " ".join(scope_names(scopes))
