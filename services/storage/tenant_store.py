"""Stores of tenants: a view of one store in which every object name has the tenant's prefix.

Nothing that a tenant names can reach another tenant's objects: the prefix is added to every name, below this interface.
The tenant "default" has no prefix, because stores that are older than tenants hold its objects.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from capture2vr.storage.store import IMMUTABLE, Head, Store, check_name

DEFAULT_TENANT = "default"
FOLDER = "tenants/"
"""Prefix of the objects of all tenants but the default one."""

TENANT_PATTERN = r"[a-z0-9][a-z0-9-]{0,31}"
_TENANT = re.compile(TENANT_PATTERN)


def valid_tenant(name: str) -> bool:
    """Return whether this is a valid tenant name: 1 to 32 of a-z 0-9 - that begin with a letter or digit."""
    return _TENANT.fullmatch(name) is not None


def check_tenant(name: str) -> str:
    """Return the name unchanged. Raises ValueError for one that `valid_tenant` refuses."""
    if not valid_tenant(name):
        raise ValueError(f"{name!r} is not a valid tenant: use 1 to 32 of a-z 0-9 - and begin with a letter or digit")
    return name


def tenant_prefix(tenant: str) -> str:
    """Return what the names of the tenant's objects begin with: "tenants/ada/", or "" for the default tenant."""
    return "" if tenant == DEFAULT_TENANT else f"{FOLDER}{check_tenant(tenant)}/"


def tenant_of(name: str) -> tuple[str, str]:
    """Split the name of an object of the whole store into its tenant and its name there.

    Raises ValueError for a name below `tenants/` that no tenant's store can have.
    """
    if not name.startswith(FOLDER):
        return DEFAULT_TENANT, name
    tenant, _, own = name.removeprefix(FOLDER).partition("/")
    if tenant == DEFAULT_TENANT or not own:
        raise ValueError(f"{name!r} is not an object of a tenant")
    return check_tenant(tenant), own


def store_of_tenant(store: Store, tenant: str) -> Store:
    """Return the tenant's view of a store. Raises ValueError for an invalid tenant."""
    prefix = tenant_prefix(tenant)
    return PrefixStore(store, prefix) if prefix else store


class PrefixStore:
    """The objects of a store below a prefix, under names without it; errors name the object without it too."""

    def __init__(self, store: Store, prefix: str) -> None:
        self._store = store
        self._prefix = prefix

    def put(
        self,
        name: str,
        data: bytes | Path,
        *,
        content_type: str,
        cache_control: str = IMMUTABLE,
        if_match: str | None = None,
        if_absent: bool = False,
        link: bool = False,
    ) -> Head:
        head = self._store.put(
            self._full(name),
            data,
            content_type=content_type,
            cache_control=cache_control,
            if_match=if_match,
            if_absent=if_absent,
            link=link,
        )
        return self._own(head)

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        return self._store.get(self._full(name), start=start, length=length)

    def fetch(self, name: str, path: Path) -> None:
        self._store.fetch(self._full(name), path)

    def head(self, name: str) -> Head:
        return self._own(self._store.head(self._full(name)))

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        full_after = self._prefix + after if after else ""
        return [self._own(head) for head in self._store.list(self._prefix + prefix, after=full_after, limit=limit)]

    def delete(self, name: str) -> None:
        self._store.delete(self._full(name))

    def url(self, name: str) -> str:
        return self._store.url(self._full(name))

    def _full(self, name: str) -> str:
        return self._prefix + check_name(name)

    def _own(self, head: Head) -> Head:
        return replace(head, name=head.name.removeprefix(self._prefix))
