"""/v1/assets: what was published, by key."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from typing import Annotated
from urllib.parse import urljoin

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel

from services.gateway.errors import Problem
from services.gateway.jobs.place import require_collection
from services.gateway.routes.objects import ANYBODY, home_of, in_thread, store_of, url_of
from services.gateway.routes.ranges import matches
from services.gateway.schemas import problems
from services.storage.catalogue import Entry, entry, list_keys, valid_key
from services.storage.removal import remove, restore
from services.storage.signing import Keys
from services.storage.store import NO_CACHE, Store

router = APIRouter(prefix="/v1", tags=["assets"])

_QR_SCALE, _QR_BORDER = 8, 4  # pixels per module; the quiet zone that ISO/IEC 18004 asks for

Key = Annotated[str, Path(max_length=200, description="The asset's key.")]
Of = Annotated[str, Query(max_length=200, description="Only if the asset is in this collection; empty: wherever.")]


class AssetSummary(BaseModel):
    """One asset in a list; `preview` is the address of a picture, `self` that of the whole entry.

    `collections` are where it is listed.
    """

    key: str
    version: int
    state: str
    updated: str
    label: str
    collections: list[str]
    preview: str
    self: str
    view: str


class AssetPage(BaseModel):
    """Assets by key; `next` is the `after` of the next page, or null."""

    assets: list[AssetSummary]
    next: str | None


class AssetMark(BaseModel):
    """Whether an asset is out of sight."""

    key: str
    version: int
    removed: bool
    updated: str


@router.get("/assets", response_model=AssetPage, responses=problems(422, 503))
async def page(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    after: Annotated[str, Query(max_length=100, description="The `next` of the page before.")] = "",
) -> AssetPage:
    """The assets there are."""
    if after and not valid_key(after):
        raise Problem(422, "KEY_INVALID", "`after` is no asset key", hints=("use the `next` of the page before",))
    store = store_of(request)
    entries = await in_thread(lambda: _entries(store, after, limit))
    last = entries[-1].key if len(entries) == limit else None
    return AssetPage(assets=[_summary(request, each) for each in entries], next=last)


@router.get("/assets/{key}", responses={200: {"content": {"application/json": {}}}, **problems(404, 410, 422, 503)})
async def asset(key: Key, request: Request) -> Response:
    """The catalogue entry of an asset with the address of every file; 304 under a known ETag."""
    found = await _entry(request, key)
    document = json.loads(json.dumps(found.document))
    for file in [document["manifest"], document["preview"], *document["lods"], *document["files"]]:
        if file is not None:
            file["url"] = url_of(request, file["name"])
    body = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
    etag = hashlib.sha256(body).hexdigest()[:32]
    headers = {"ETag": f'"{etag}"', "Cache-Control": NO_CACHE, **ANYBODY}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


@router.get("/assets/{key}/lod/{level}", status_code=307, responses=problems(404, 410, 422, 503))
async def lod(key: Key, level: Annotated[int, Path(ge=0, le=99)], request: Request) -> Response:
    """To the file of a level of detail, 0 being the finest, of the current version."""
    levels = (await _entry(request, key)).document["lods"]
    name = next((each["name"] for each in levels if each["level"] == level), None)
    if name is None:
        known = ", ".join(str(each["level"]) for each in levels)
        hints = (f"ask for one of: {known}",)
        raise Problem(404, "LOD_UNKNOWN", f"asset {key} has no level {level}; there are {known}", hints=hints)
    return RedirectResponse(url_of(request, name), 307, {"Cache-Control": NO_CACHE, **ANYBODY})


@router.get(
    "/assets/{key}/qr.svg",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}, **problems(404, 410, 422, 503)},
)
async def qr(key: Key, request: Request) -> Response:
    """The address of the asset's viewer as a QR code, to hand it from a screen to a headset."""
    await _entry(request, key)
    return Response(_qr_svg(urljoin(home_of(request), f"view/{key}")), media_type="image/svg+xml")


@router.post("/assets/{key}/remove", response_model=AssetMark, responses=problems(404, 422, 503))
async def take_away(key: Key, request: Request, collection: Of = "") -> AssetMark:
    """Take an asset out of sight. Its files stay: a restoration or a new version brings it back."""
    return await _marked(request, key, remove, collection)


@router.post("/assets/{key}/restore", response_model=AssetMark, responses=problems(404, 422, 503))
async def bring_back(key: Key, request: Request, collection: Of = "") -> AssetMark:
    """Bring a removed asset back as it was."""
    return await _marked(request, key, restore, collection)


async def _entry(request: Request, key: str) -> Entry:
    """The key's entry. Raises Problem KEY_INVALID, ASSET_UNKNOWN, ASSET_REMOVED, STORE_UNAVAILABLE."""
    _check_key(key)
    store = store_of(request)
    try:
        found = await in_thread(lambda: entry(store, key))
    except FileNotFoundError:
        raise _unknown(key) from None
    if found.removed:
        hints = (f"POST /v1/assets/{key}/restore brings it back",)
        raise Problem(410, "ASSET_REMOVED", f"asset {key} was removed", hints=hints, headers=dict(ANYBODY))
    return found


async def _marked(request: Request, key: str, mark: Callable[[Store, str, Keys], Entry], collection: str) -> AssetMark:
    _check_key(key)
    store, keys = store_of(request), request.app.state.keys
    try:
        if collection:
            _require_in(await in_thread(lambda: entry(store, key)), collection)
        found = await in_thread(lambda: mark(store, key, keys))
    except FileNotFoundError:
        raise _unknown(key) from None
    return AssetMark(key=key, version=found.version, removed=found.removed, updated=found.document["updated"])


def _check_key(key: str) -> None:
    if not valid_key(key):
        detail = "an asset key has 1 to 100 letters, digits and ._- and begins with no sign"
        raise Problem(422, "KEY_INVALID", detail, hints=("check the address",))


def _require_in(found: Entry, collection: str) -> None:
    """That it is the caller's own asset, not one of the same key elsewhere. Raises Problem."""
    require_collection(collection, "name another in `collection`, or none")
    if collection not in found.collections:
        detail = f"there is no asset {found.key} in collection {collection}"
        raise Problem(404, "ASSET_UNKNOWN", detail, hints=(f"it is in: {', '.join(found.collections)}",))


def _unknown(key: str) -> Problem:
    hints = ("its first job may still be under way",)
    return Problem(404, "ASSET_UNKNOWN", f"there is no asset {key}", hints=hints)


def _entries(store: Store, after: str, limit: int) -> list[Entry]:
    """As many as are wanted, where there are so many, without those that were removed."""
    found: list[Entry] = []
    while len(found) < limit and (keys := list_keys(store, after=after, limit=limit - len(found))):
        found += [each for each in (entry(store, key) for key in keys) if not each.removed]
        after = keys[-1]
    return found


def _summary(request: Request, found: Entry) -> AssetSummary:
    preview = found.document["preview"]
    return AssetSummary(
        key=found.key,
        version=found.version,
        state=found.state,
        updated=found.document["updated"],
        label=found.document["label"] or found.key,
        collections=found.collections,
        preview=url_of(request, preview["name"]) if preview else "",
        self=f"/v1/assets/{found.key}",
        view=f"/view/{found.key}",
    )


def _qr_svg(text: str) -> bytes:
    import segno

    buffer = io.BytesIO()
    segno.make(text, micro=False).save(buffer, kind="svg", scale=_QR_SCALE, border=_QR_BORDER, light="#fff")
    return buffer.getvalue()
