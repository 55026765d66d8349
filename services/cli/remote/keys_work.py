"""Implementation of `capture2vr keys`: the same work in a database on this machine, or at a gateway by HTTP."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import httpx
import typer
from rich.table import Table
from rich.text import Text
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.cli.local_settings import check_data, local_settings
from capture2vr.cli.printable import printable
from capture2vr.cli.progress import console, print_listing, warn
from capture2vr.client.answers import paged, parse_answer
from capture2vr.client.http import API_KEY_VARIABLE, open_gateway
from capture2vr.errors import BadInput
from capture2vr.gateway.access.api_key import ApiKey
from capture2vr.gateway.access.caller import parse_scopes, scope_names
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import open_engine
from capture2vr.storage.tenant_store import DEFAULT_TENANT, check_tenant

_DAY_S = 86_400.0
_PAGE = 200


@dataclass(frozen=True, slots=True)
class KeyOptions:
    """A key to be created. tenant: "" is the default one, or at a gateway the caller's; expires_days 0: never"""

    tenant: str
    scopes: tuple[str, ...]
    label: str
    expires_days: int


class KeyAdministration(Protocol):
    """Creates, lists, revokes and rotates keys; each key is a mapping as the gateway's API has it."""

    def create(self, options: KeyOptions) -> dict[str, Any]: ...
    def all(self, tenant: str) -> Iterator[dict[str, Any]]: ...
    def revoke(self, key: str) -> dict[str, Any]: ...
    def rotate(self, key: str, grace_days: int) -> dict[str, Any]: ...


@contextmanager
def open_keys(data: Path, gateway: str, *, is_first: bool = False) -> Iterator[KeyAdministration]:
    """Open a gateway's keys: by its API, or in the database of the GATEWAY_* variables or of the data folder.

    is_first  whether a data folder may be made: a key is created before the gateway is started for the first time
    Raises BadInput.
    """
    try:
        if gateway:
            if not os.environ.get(API_KEY_VARIABLE):
                raise BadInput(f"set {API_KEY_VARIABLE} to an access key with the scope manage or operate")
            with open_gateway(gateway) as client:
                yield _AtGateway(client)
        else:
            if not is_first:
                check_data(data)
            engine = open_engine(local_settings(data).database)
            try:
                yield _InDatabase(AccessStore(engine))
            finally:
                engine.dispose()
    except SQLAlchemyError as error:
        raise BadInput(f"the gateway's database cannot be used: {getattr(error, 'orig', None) or error}") from error


def create_key(keys: KeyAdministration, options: KeyOptions) -> None:
    """Create a key and print its secret to standard output. Raises BadInput."""
    try:
        parse_scopes(options.scopes)
    except ValueError as error:
        raise BadInput(f"--scope: {error}") from None
    _print_new(keys.create(options))


def list_keys(keys: KeyAdministration, tenant: str) -> None:
    """Print a table of keys."""
    table = Table()
    columns = ("id", "tenant", "label", "scopes", "state", "last used")
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column == "id")
    for key in keys.all(tenant):
        texts = (key["id"], key["tenant"], key["label"], " ".join(key["scopes"]), _state(key), key["last_used"] or "–")
        table.add_row(*(Text(printable(str(text))) for text in texts))
    print_listing(table)


def revoke_key(keys: KeyAdministration, key: str) -> None:
    """Revoke a key. Raises BadInput where there is none."""
    found = keys.revoke(key)
    console.print(f"{found['id']} of {found['tenant']} is revoked: it is refused within a minute")


def rotate_key(keys: KeyAdministration, key: str, grace_days: int) -> None:
    """Replace a key and print the new one's secret. Raises BadInput where there is none."""
    _print_new(keys.rotate(key, grace_days))
    console.print(f"{key} goes on for {grace_days} days")


def _print_new(key: dict[str, Any]) -> None:
    expires = f", until {key['expires']}" if key["expires"] else ""
    console.print(f"{key['id']} of {key['tenant']}: {', '.join(key['scopes'])}{expires}. The key is shown this once:")
    typer.echo(key["secret"])


def _state(key: dict[str, Any]) -> str:
    if key["revoked"]:
        return f"revoked {key['revoked']}"
    return f"expires {key['expires']}" if key["expires"] else "good"


class _AtGateway:
    """Keys by a gateway's API."""

    def __init__(self, client: httpx.Client) -> None:
        self._client = client

    def create(self, options: KeyOptions) -> dict[str, Any]:
        body = {
            "scopes": list(options.scopes),
            "label": options.label,
            "expires_days": options.expires_days or None,
            "tenant": options.tenant or None,
        }
        created: dict[str, Any] = parse_answer(self._client.post("/v1/api-keys", json=body))
        return created

    def all(self, tenant: str) -> Iterator[dict[str, Any]]:
        return paged(self._client, "/v1/api-keys", "keys", {"tenant": tenant or self._widest, "limit": _PAGE}, dict)

    def revoke(self, key: str) -> dict[str, Any]:
        revoked: dict[str, Any] = parse_answer(self._client.post(f"/v1/api-keys/{key}/revoke"))
        return revoked

    def rotate(self, key: str, grace_days: int) -> dict[str, Any]:
        answer = self._client.post(f"/v1/api-keys/{key}/rotate", json={"grace_days": grace_days})
        new: dict[str, Any] = parse_answer(answer)
        return new

    @property
    def _widest(self) -> str:
        """The most that this key may list: all tenants for an operator's, else its own."""
        return "*" if "operate" in parse_answer(self._client.get("/v1/session"))["scopes"] else ""


class _InDatabase:
    """Keys in a database: whoever can read its file is its operator."""

    def __init__(self, store: AccessStore) -> None:
        self._store = store

    def create(self, options: KeyOptions) -> dict[str, Any]:
        tenant = _checked(options.tenant or DEFAULT_TENANT)
        if not self._store.has_keys():
            warn("this is the first key: from now on the gateway asks everybody for one")
        if self._store.ensure_tenant(tenant):
            console.print(f"created the tenant {tenant}")
        expires = time.time() + options.expires_days * _DAY_S if options.expires_days else None
        key, secret = self._store.create_key(tenant, parse_scopes(options.scopes), label=options.label, expires=expires)
        return {**_document(key), "secret": secret}

    def all(self, tenant: str) -> Iterator[dict[str, Any]]:
        after = ""
        wanted = _checked(tenant) if tenant else None
        while page := self._store.list_keys(wanted, limit=_PAGE, after=after):
            yield from map(_document, page)
            after = page[-1].id

    def revoke(self, key: str) -> dict[str, Any]:
        revoked = self._store.revoke_key(key, None)
        if revoked is None:
            raise _unknown(key)
        return _document(revoked)

    def rotate(self, key: str, grace_days: int) -> dict[str, Any]:
        old = self._store.key(key)
        if old is None:
            raise _unknown(key)
        if why := old.refusal(time.time()):
            raise BadInput(f"the key {key} is {why}: create a new one")
        new, secret = self._store.create_key(old.tenant, old.scopes, label=old.label, expires=old.expires, replaces=old)
        self._store.expire_key(key, None, time.time() + grace_days * _DAY_S)
        return {**_document(new), "secret": secret}


def _checked(tenant: str) -> str:
    try:
        return check_tenant(tenant)
    except ValueError as error:
        raise BadInput(f"--tenant: {error}") from None


def _unknown(key: str) -> BadInput:
    return BadInput(f"there is no access key {key}; `capture2vr keys list` lists them")


def _document(key: ApiKey) -> dict[str, Any]:
    times = {name: getattr(key, name) for name in ("created", "expires", "last_used", "revoked")}
    return {
        "id": key.id,
        "tenant": key.tenant,
        "label": key.label,
        "scopes": scope_names(key.scopes),
        **{name: None if at is None else _iso(at) for name, at in times.items()},
    }


def _iso(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
