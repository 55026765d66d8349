"""A gateway with two tenants, each with captures, jobs, assets and keys of its own."""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import open_engine
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.bundles import bundle
from tests.support.in_process_gateway import gateway


def make_key(data_dir: Path, tenant: str, scopes: Collection[Scope] = ALL_SCOPES, **options: Any) -> str:
    """Create a key of a tenant, and the tenant, in a gateway's database, as the command line does; its secret."""
    data_dir.mkdir(parents=True, exist_ok=True)
    engine = open_engine(f"sqlite:///{data_dir / 'gateway.db'}")
    store = AccessStore(engine)
    store.ensure_tenant(tenant)
    _, secret = store.create_key(tenant, scopes, **options)
    engine.dispose()
    return secret


def bearer(secret: str) -> dict[str, str]:
    """The header that shows a key."""
    return {"Authorization": f"Bearer {secret}"}


@dataclass(frozen=True, slots=True)
class TwoTenants:
    """A gateway that asks for keys, and a client of each tenant; whose keys have all scopes but `operate`."""

    url: str
    ada: httpx.AsyncClient
    bob: httpx.AsyncClient
    operator: httpx.AsyncClient
    anonymous: httpx.AsyncClient


@asynccontextmanager
async def two_tenants(folder: Path, store: Store, *ports: int, **settings: Any) -> AsyncIterator[TwoTenants]:
    """Start a gateway with the tenants ada and bob, and an operator in the default tenant."""
    owner = ALL_SCOPES - {Scope.OPERATE}
    secrets = [make_key(folder / "gw", tenant, owner) for tenant in ("ada", "bob")]
    secrets.append(make_key(folder / "gw", "default", {Scope.OPERATE}))
    async with gateway(folder / "gw", store, *ports, **settings) as client:
        url = str(client.base_url)
        clients = [httpx.AsyncClient(base_url=url, headers=bearer(secret), timeout=30) for secret in secrets]
        try:
            yield TwoTenants(url, *clients, anonymous=client)
        finally:
            for each in clients:
                await each.aclose()


def publish_for(store: Store, tenant: str, key: str, **options: Any) -> None:
    """Publish an asset of a tenant."""
    publish(bundle(), store_of_tenant(store, tenant), key=key, job="job_1", **options)
