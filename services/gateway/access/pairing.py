"""Pairings: invitations of one device, and how they lie in the database."""

from __future__ import annotations

import secrets as random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.access.caller import Scope, parse_scopes
from capture2vr.gateway.access.tables import pairings


@dataclass(frozen=True, slots=True)
class Pairing:
    """An invitation of one device: whoever shows its token or its code before `expires` gets a key with its scopes.

    key_expires  when that key expires; None: never
    key          id of the key, once it has been claimed; else ""
    parent       id of the key that began it, without which it cannot be claimed; None at a gateway without keys
    """

    id: str
    tenant: str
    label: str
    scopes: frozenset[Scope]
    code: str
    expires: float
    key_expires: float | None
    key: str
    parent: str | None = None


def find_pairing(db: Connection, which: sa.ColumnElement[bool], *, lock: bool = False) -> Pairing | None:
    """Find a pairing. lock: until the transaction's end, on databases with more than one writer at a time"""
    select = sa.select(pairings).where(which)
    row = db.execute(select.with_for_update() if lock else select).first()
    return pairing_from(dict(row._mapping)) if row else None


def pairing_from(row: Mapping[str, Any]) -> Pairing:
    """Make a pairing from its row."""
    values = {name: value for name, value in row.items() if name != "token_sha256"}
    return Pairing(**{**values, "scopes": parse_scopes(row["scopes"].split()), "key": row["key"] or ""})


CODE_DIGITS = 10
"""Digits of a code: so many that guessing needs no limit which strangers could use up (see guesses.py)."""


def free_code(taken: set[str]) -> str:
    """Return random digits that no open pairing has."""
    while (code := f"{random.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}}") in taken:
        pass
    return code
