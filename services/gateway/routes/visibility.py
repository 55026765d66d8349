"""PUT /v1/assets/{key}/visibility and the same of collections: set who may read them besides their tenant."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel, Field

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.readers import Kind, Readers, Thing
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.jobs.collection_choice import require_collection
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.read_rules import unknown_asset, unknown_collection
from capture2vr.gateway.routes.store_access import in_thread, page_path, store_of
from capture2vr.gateway.schemas import StrictBody, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.change_entry import set_asset_visibility
from capture2vr.storage.catalogue.entry import valid_key
from capture2vr.storage.catalogue.update import set_collection_visibility
from capture2vr.storage.catalogue.visibility import Visibility

router = APIRouter(prefix="/v1", tags=["visibility"])

Key = Annotated[str, Path(max_length=200, description="The asset's key.")]
Name = Annotated[str, Path(max_length=200, description="The collection's name.")]


class VisibilityRequest(StrictBody):
    """Who may read it besides its tenant. null: an asset has that of its collections, a collection the gateway's."""

    visibility: Annotated[
        Visibility | None,
        Field(description="private: nobody; unlisted: whoever has its address; public: everybody, and it is listed."),
    ]


class VisibilityView(BaseModel):
    """Who may read it. `visibility`: as set; `effective`: what holds; null is the gateway's default, which is public
    as long as it asks nobody for a key, and private then. `view`: path of its page, for anybody.
    """

    visibility: Visibility | None
    effective: Visibility | None
    view: str


@router.put(
    "/assets/{key}/visibility",
    response_model=VisibilityView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def set_visibility_of_asset(
    key: Key, body: VisibilityRequest, request: Request, gateway: GatewayOf
) -> VisibilityView:
    """Set an asset's visibility. Other gateways, and the CDN, follow within a minute."""
    if not valid_key(key):
        raise Problem(422, "KEY_INVALID", say("not_valid_asset_key"), hints=(say("check_key_in_url"),))
    store, keys = store_of(request), gateway.keys
    try:
        await in_thread(lambda: set_asset_visibility(store, key, body.visibility, keys))
    except FileNotFoundError:
        raise unknown_asset(key) from None
    found = await _readers(request, "asset", key)
    return VisibilityView(
        visibility=body.visibility, effective=found.visibility, view=page_path(request, f"/view/{key}")
    )


@router.put(
    "/collections/{name}/visibility",
    response_model=VisibilityView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def set_visibility_of_collection(
    name: Name, body: VisibilityRequest, request: Request, gateway: GatewayOf
) -> VisibilityView:
    """Set a collection's visibility, which is also that of its assets without one of their own. One that others may
    read lists only what is public.
    """
    require_collection(name, say("check_name_in_url"))
    store, keys = store_of(request), gateway.keys
    try:
        await in_thread(lambda: set_collection_visibility(store, name, body.visibility, keys))
    except FileNotFoundError:
        raise unknown_collection(name) from None
    found = await _readers(request, "collection", name)
    return VisibilityView(
        visibility=body.visibility, effective=found.visibility, view=page_path(request, f"/browse/{name}")
    )


async def _readers(request: Request, kind: Kind, name: str) -> Readers:
    """Return who may read a thing that was changed just now."""
    readers = gateway_of(request).access.readers
    tenant = caller_of(request).tenant
    readers.forget_all(tenant)
    return await readers.of(Thing(tenant, kind, name))
