"""/v1/assets/{key}/versions: read an earlier version of an asset, and restore it as the newest one."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.assets import Key, add_urls, check_key
from capture2vr.gateway.routes.read_rules import unknown_asset
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.webhooks.outbox import WebhookEvent
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.next_entry import grade_in
from capture2vr.storage.catalogue.versions import UnknownVersion, read_version, restore_version

router = APIRouter(prefix="/v1", tags=["assets"])

Version = Annotated[int, Path(ge=1, le=1_000_000_000, description="Number of a version, as the entry lists them.")]


class RestoredView(BaseModel):
    """The newest version after an earlier one was restored: `version` is a new number, with the files of `restored`."""

    key: str
    version: int
    restored: int
    state: str
    manifest: str
    updated: str


@router.get(
    "/assets/{key}/versions/{version}",
    dependencies=[needs(Scope.READ)],
    responses={200: {"content": {"application/json": {}}}, **problems(404, 422, 503)},
)
async def get_version(key: Key, version: Version, request: Request) -> Response:
    """Get an asset's catalogue entry as it was with another version, with the URL of every file. `held`: whether that
    version was held back, because its grade says to shoot again.
    """
    found = await read_asset_version(request, key, version)
    document = add_urls(request, {**found.document, "held": found.held})
    return JSONResponse(document, headers={"Cache-Control": "private, no-store"})


@router.post(
    "/assets/{key}/versions/{version}/restore",
    response_model=RestoredView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 422, 503),
)
async def restore_earlier_version(key: Key, version: Version, request: Request, gateway: GatewayOf) -> RestoredView:
    """Publish another version as the newest one: the undo of an edit, or to keep one that was held back because its
    grade says to shoot again. Nothing is computed or deleted.
    """
    store, keys = store_of(request), gateway.keys
    found = await _known(key, lambda: restore_version(store, key, version, keys))
    await _tell_webhooks(request, found)
    return RestoredView(
        key=key,
        version=found.version,
        restored=version,
        state=found.state,
        manifest=found.manifest,
        updated=found.document["updated"],
    )


async def read_asset_version(request: Request, key: str, version: int) -> Entry:
    """Read the key's entry as it was with this version.

    Raises Problem KEY_INVALID, ASSET_UNKNOWN, VERSION_UNKNOWN, and those of the store.
    """
    store = store_of(request)
    return await _known(key, lambda: read_version(store, key, version))


async def _known(key: str, work: Callable[[], Entry]) -> Entry:
    """Do the work on a store in a thread. Raises Problem KEY_INVALID, ASSET_UNKNOWN, VERSION_UNKNOWN."""
    check_key(key)
    try:
        return await in_thread(work)
    except UnknownVersion as unknown:
        raise Problem(404, "VERSION_UNKNOWN", str(unknown), hints=(f"GET /v1/assets/{key} lists them",)) from None
    except FileNotFoundError:
        raise unknown_asset(key) from None


async def _tell_webhooks(request: Request, found: Entry) -> None:
    """Tell the tenant's webhooks that a version was published."""
    newest, store = found.versions[-1], store_of(request)
    grade = await in_thread(lambda: grade_in(json.loads(store.get(found.manifest))))
    data = {
        "key": found.key,
        "version": found.version,
        "state": found.state,
        "manifest": found.manifest,
        "collection": found.collections[0],
        "job": newest["job"],
        "label": found.names.label,
        "grade": grade,
        "held": False,
    }
    event = WebhookEvent("asset.published", f"{found.key} {found.version}", data)
    gateway, tenant = gateway_of(request), caller_of(request).tenant
    await gateway.access.authentication.run(lambda: gateway.webhooks.outbox.enqueue(tenant, event))
    gateway.webhooks.deliveries.wake()
