"""/v1/assets: list published assets, read one by its key, remove and restore it."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from typing import Annotated, Any
from urllib.parse import urljoin

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.jobs.collection_choice import require_collection
from capture2vr.gateway.qr_code import qr_svg
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.http_ranges import etag_matches
from capture2vr.gateway.routes.read_rules import READS_ASSET, Reading, reading_of, unknown_asset
from capture2vr.gateway.routes.store_access import gateway_url, in_thread, object_url, page_path, store_of
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.webhooks.outbox import WebhookEvent
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.change_entry import remove, restore
from capture2vr.storage.catalogue.entry import Entry, list_keys, read_entry, valid_key
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.store import NO_CACHE, Store

router = APIRouter(prefix="/v1", tags=["assets"])

_log = logging.getLogger(__name__)

Key = Annotated[str, Path(max_length=200, description="The asset's key.")]
InCollection = Annotated[
    str, Query(max_length=200, description="Do it only if the asset is in this collection; empty: in any case.")
]


class AssetSummary(BaseModel):
    """One asset in a list. `preview` is the URL of a picture, `self` the URL of the whole entry, `view` the URL of its
    viewer page; `labels` are its tags, `collections` names the collections that list it. `grade` is good, usable,
    incomplete or shoot again; "" where nothing could tell.
    """

    key: str
    version: int
    state: str
    grade: str
    updated: str
    label: str
    labels: list[str]
    collections: list[str]
    preview: str
    self: str
    view: str


class AssetPage(BaseModel):
    """A page of assets, sorted by key. `next` is the value of `after` for the next page; null on the last page.
    `damaged` names the assets that were skipped because their catalogue entries cannot be read.
    """

    assets: list[AssetSummary]
    next: str | None
    damaged: list[str]


class AssetRemovalView(BaseModel):
    """Whether an asset is removed (hidden). `updated`: when it was last published, removed or restored."""

    key: str
    version: int
    removed: bool
    updated: str


@router.get("/assets", response_model=AssetPage, dependencies=[needs(Scope.READ)], responses=problems(422, 503))
async def list_assets(
    request: Request,
    gateway: GatewayOf,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    after: Annotated[str, Query(max_length=100, description="`next` of the previous page; empty: first page.")] = "",
    held: Annotated[bool, Query(description="List instead those that are held back.")] = False,
) -> AssetPage:
    """List assets, sorted by key, without removed ones and those that are held back: their grade says to shoot again,
    and nobody has kept them.
    """
    if after and not valid_key(after):
        hints = ("use the `next` of the previous page",)
        raise Problem(422, "KEY_INVALID", "`after` is not a valid asset key", hints=hints)
    store = store_of(request)
    entries, damaged = await in_thread(lambda: _entries(store, after, limit, held=held))
    gateway.metrics.observe_damage("entry", len(damaged))
    last = entries[-1].key if len(entries) == limit else None
    return AssetPage(assets=[_summary(request, each) for each in entries], next=last, damaged=damaged)


@router.get(
    "/assets/{key}",
    dependencies=[READS_ASSET],
    responses={200: {"content": {"application/json": {}}}, **problems(404, 410, 422, 503)},
)
async def get_asset(key: Key, request: Request) -> Response:
    """Get an asset's catalogue entry, with the URL of every file. Answers 304 for an ETag in If-None-Match."""
    found = await read_asset(request, key)
    reading = reading_of(request)
    document = add_urls(request, _document(found, reading))
    body = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
    etag = hashlib.sha256(body).hexdigest()[:32]
    headers = {"ETag": f'"{etag}"', "Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}
    if etag_matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


@router.get(
    "/assets/{key}/lod/{level}",
    status_code=307,
    dependencies=[READS_ASSET],
    responses=problems(404, 410, 422, 503),
)
async def get_level_of_detail(key: Key, level: Annotated[int, Path(ge=0, le=99)], request: Request) -> Response:
    """Redirect to the GLB file of a level of detail of the current version; 0 is the finest."""
    levels = (await read_asset(request, key)).document["lods"]
    name = next((each["name"] for each in levels if each["level"] == level), None)
    if name is None:
        known = ", ".join(str(each["level"]) for each in levels)
        hints = (say("ask_one", names=known),)
        raise Problem(
            404, "LOD_UNKNOWN", say("asset_has_no_level_detail", key=key, level=level, known=known), hints=hints
        )
    reading = reading_of(request)
    headers = {"Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}
    return RedirectResponse(object_url(request, name), 307, headers)


@router.get(
    "/assets/{key}/qr.svg",
    response_class=Response,
    dependencies=[READS_ASSET],
    responses={200: {"content": {"image/svg+xml": {}}}, **problems(404, 410, 422, 503)},
)
async def get_qr_code(key: Key, request: Request) -> Response:
    """Get the URL of the asset's viewer page as a QR code (SVG), to open it on a headset."""
    await read_asset(request, key)
    address = urljoin(gateway_url(request), page_path(request, f"view/{key}"))
    return Response(qr_svg(address), media_type="image/svg+xml")


@router.post(
    "/assets/{key}/remove",
    response_model=AssetRemovalView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 422, 503),
)
async def remove_asset(key: Key, request: Request, collection: InCollection = "") -> AssetRemovalView:
    """Remove (hide) an asset. Its files are kept: restoring it, or publishing a new version, brings it back."""
    return await _set_removed(request, key, remove, collection)


@router.post(
    "/assets/{key}/restore",
    response_model=AssetRemovalView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 422, 503),
)
async def restore_asset(key: Key, request: Request, collection: InCollection = "") -> AssetRemovalView:
    """Restore a removed asset as it was."""
    return await _set_removed(request, key, restore, collection)


def add_urls(request: Request, document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of an entry's document with the URL of every file, and without notes: they have a route."""
    copy: dict[str, Any] = json.loads(json.dumps({**document, "notes": None}))
    del copy["notes"]
    for file in [copy["manifest"], copy["preview"], *copy["lods"], *copy["files"]]:
        if file is not None:
            file["url"] = object_url(request, file["name"])
    return copy


def _document(found: Entry, reading: Reading) -> dict[str, Any]:
    """Return an entry's document with the visibility that holds; for others without what only its tenant needs: its
    versions with their jobs, and collections that the reader may not read.
    """
    document: dict[str, Any] = {
        **found.document,
        "held": found.held,
        "effective_visibility": reading.visibility,
        "collections": list(reading.collections),
        "may_place": reading.may_place,
    }
    if not reading.is_own:
        document.pop("versions")
    return document


async def read_asset(request: Request, key: str) -> Entry:
    """Read the key's entry. Raises Problem KEY_INVALID, ASSET_UNKNOWN, ASSET_REMOVED, STORE_UNAVAILABLE."""
    check_key(key)
    store = store_of(request)
    try:
        found = await in_thread(lambda: read_entry(store, key))
    except FileNotFoundError:
        raise unknown_asset(key) from None
    if found.removed:
        hints = (f"POST /v1/assets/{key}/restore restores it",)
        raise Problem(
            410, "ASSET_REMOVED", say("asset_removed", key=key), hints=hints, headers=reading_of(request).cors_headers
        )
    return found


async def _set_removed(
    request: Request, key: str, change: Callable[[Store, str, Keys], Entry], collection: str
) -> AssetRemovalView:
    check_key(key)
    store, keys = store_of(request), gateway_of(request).keys
    try:
        if collection:
            _check_collection(await in_thread(lambda: read_entry(store, key)), collection)
        found = await in_thread(lambda: change(store, key, keys))
    except FileNotFoundError:
        raise unknown_asset(key) from None
    await _tell_webhooks(request, found)
    return AssetRemovalView(key=key, version=found.version, removed=found.removed, updated=found.document["updated"])


async def _tell_webhooks(request: Request, found: Entry) -> None:
    """Tell the tenant's webhooks that an asset was removed or restored; a repeated request tells it once."""
    data = {"key": found.key, "version": found.version, "updated": found.document["updated"]}
    event = WebhookEvent(f"asset.{'removed' if found.removed else 'restored'}", json.dumps(data, sort_keys=True), data)
    gateway, tenant = gateway_of(request), caller_of(request).tenant
    await gateway.access.authentication.run(lambda: gateway.webhooks.outbox.enqueue(tenant, event))
    gateway.webhooks.deliveries.wake()


def check_key(key: str) -> None:
    """Raises Problem KEY_INVALID."""
    if not valid_key(key):
        detail = say("asset_key_must_have_1")
        raise Problem(422, "KEY_INVALID", detail, hints=(say("check_key_in_url"),))


def _check_collection(found: Entry, collection: str) -> None:
    """Raises Problem where the asset is not in this collection: another collection may have an asset with this key."""
    require_collection(collection, say("change_collection_leave"))
    if collection not in found.collections:
        detail = say("no_asset_in_collection", key=found.key, collection=collection)
        raise Problem(404, "ASSET_UNKNOWN", detail, hints=(say("asset_in", names=", ".join(found.collections)),))


def _entries(store: Store, after: str, limit: int, *, held: bool) -> tuple[list[Entry], list[str]]:
    """Read at most `limit` entries with keys behind `after`, skipping removed assets and those that are held back, or
    with `held` those that are not; also the keys of damaged ones.
    """
    found: list[Entry] = []
    damaged: list[str] = []
    while len(found) < limit and (keys := list_keys(store, after=after, limit=limit - len(found))):
        for key in keys:
            try:
                entry = read_entry(store, key)
            except FileNotFoundError:
                continue  # deleted since the keys were listed
            except CatalogueFault as fault:
                _log.warning("asset %s is not listed: %s", key, fault)
                damaged.append(key)
                continue
            if not entry.removed and entry.held == held:
                found.append(entry)
        after = keys[-1]
    return found, damaged


def _summary(request: Request, found: Entry) -> AssetSummary:
    preview = found.document["preview"]
    return AssetSummary(
        key=found.key,
        version=found.version,
        state=found.state,
        grade=found.grade,
        updated=found.document["updated"],
        label=found.names.label or found.key,
        labels=list(found.names.labels),
        collections=found.collections,
        preview=object_url(request, preview["name"]) if preview else "",
        self=page_path(request, f"/v1/assets/{found.key}"),
        view=page_path(request, f"/view/{found.key}"),
    )
