"""Who makes a request: the tenant, and what the access key allows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal


class Scope(StrEnum):
    """What an access key allows, within its tenant; `operate` alone reaches beyond it."""

    CAPTURE = "capture"
    """Upload captures, and start, follow and cancel jobs."""
    READ = "read"
    """Read assets, collections and jobs."""
    MANAGE = "manage"
    """Remove, restore and delete assets and captures; create and revoke the tenant's keys."""
    OPERATE = "operate"
    """Run the service: tenants and keys of all, metrics, the operator's page."""


ALL_SCOPES = frozenset(Scope)


@dataclass(frozen=True, slots=True)
class Caller:
    """The author of a request.

    key  id of the access key; "" where there is none
    session  hash of the browser's cookie; "" for a caller without one
    via  open: the gateway asks for no keys; key: a key in the header; session: a browser's cookie; anonymous: none
    """

    tenant: str
    scopes: frozenset[Scope]
    via: Literal["open", "key", "session", "anonymous"]
    key: str = ""
    session: str = ""


def parse_scopes(names: Iterable[str]) -> frozenset[Scope]:
    """Convert names of scopes. Raises ValueError that names the unknown one."""
    names = list(names)
    try:
        return frozenset(map(Scope, names))
    except ValueError:
        unknown = ", ".join(set(names) - set(Scope))
        raise ValueError(f"there is no scope {unknown}; the scopes are {', '.join(Scope)}") from None


def scope_names(scopes: Iterable[Scope]) -> list[str]:
    """Return the names of scopes in the order of `Scope`."""
    chosen = set(scopes)
    return [scope.value for scope in Scope if scope in chosen]
