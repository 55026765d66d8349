"""PATCH /v1/assets/{key}: change what people call an asset."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from pydantic import BaseModel

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.routes.access_rules import needs
from capture2vr.gateway.routes.assets import Key, check_key
from capture2vr.gateway.routes.read_rules import unknown_asset
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import Description, Label, Labels, StrictBody, problems
from capture2vr.storage.catalogue.change_entry import change_names

router = APIRouter(prefix="/v1", tags=["assets"])


class NamesRequest(StrictBody):
    """New names of an asset; what is left out, or null, stays as it is. An empty label is the key."""

    label: Label | None = None
    description: Description | None = None
    labels: Labels | None = None


class NamesView(BaseModel):
    """What people call an asset. `updated`: when its catalogue entry last changed."""

    key: str
    label: str
    description: str
    labels: list[str]
    updated: str


@router.patch(
    "/assets/{key}",
    response_model=NamesView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def change_names_of_asset(key: Key, body: NamesRequest, request: Request, gateway: GatewayOf) -> NamesView:
    """Change an asset's label, description or tags, without a new version. A later job keeps them, unless it
    names others.
    """
    check_key(key)
    changes: dict[str, Any] = body.model_dump(exclude_none=True)
    store, keys = store_of(request), gateway.keys
    try:
        entry = await in_thread(lambda: change_names(store, key, keys, **changes))
    except FileNotFoundError:
        raise unknown_asset(key) from None
    names = entry.names
    return NamesView(
        key=key,
        label=names.label or key,
        description=names.description,
        labels=list(names.labels),
        updated=str(entry.document["updated"]),
    )
