"""/v1/collections: signed catalogues of many assets, as they stand on the store, and a search in them by label."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache, partial
from itertools import chain, islice
from typing import Annotated, TypeVar

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel

from services.gateway.errors import Problem
from services.gateway.jobs.place import require_collection
from services.gateway.routes.objects import ANYBODY, in_thread, store_of, url_of
from services.gateway.routes.ranges import matches
from services.gateway.schemas import problems
from services.storage.catalogue import valid_key
from services.storage.collection import Index, Row, index_name, load_shard, opened, read_index
from services.storage.reading import Rows, again_if_moved, row_in
from services.storage.store import NO_CACHE, Store

router = APIRouter(prefix="/v1", tags=["collections"])

_KEPT_SHARDS = 64  # parsed, by content, 0.7 MB each at most: every search walks all shards of its collection

_T = TypeVar("_T")

Name = Annotated[str, Path(max_length=200, description="The collection's name; `default` where nobody named another.")]
Key = Annotated[str, Path(max_length=200, description="The asset's key.")]


class RowView(BaseModel):
    """An asset of a collection; `manifest` is the address of everything about it, `self` that of its entry."""

    key: str
    label: str
    labels: list[str]
    version: int
    state: str
    updated: datetime
    manifest: str
    manifest_sha256: str
    preview: str
    self: str
    view: str


class RowPage(BaseModel):
    """Assets by key; `next` is the `after` of the next page, or null; `version` is the collection's."""

    collection: str
    version: int
    assets: list[RowView]
    next: str | None


class PlaceView(BaseModel):
    """An asset's place in a collection; `version` is the collection's, `shard` the object that lists the asset."""

    collection: str
    version: int
    shard: str
    asset: RowView


class KeyView(BaseModel):
    """A public key: its id, and its 32 raw bytes as base64."""

    key: str
    ed25519: str


class KeyPage(BaseModel):
    """The public keys whose collections this gateway believes; none: it believes any."""

    keys: list[KeyView]


def kept_rows(store: Store) -> Rows:
    """The rows of the store's shards, those asked for last without reading them again: none changes under its hash."""
    return lru_cache(maxsize=_KEPT_SHARDS)(partial(load_shard, store))


@router.get("/collections/{name}", responses={200: {"content": {"application/json": {}}}, **problems(404, 422, 503)})
async def envelope(name: Name, request: Request) -> Response:
    """The signed index as it stands on the store, and `base`, below which its objects are; 304 under a known ETag."""
    require_collection(name, "check the address")
    store = store_of(request)
    try:
        text, signatures = await in_thread(lambda: opened(store.get(index_name(name)), name))
    except FileNotFoundError:
        raise _unknown(name) from None
    # The base is not signed, and need not be: whatever is read below it is checked by its hash.
    document = {"signed": text, "signatures": signatures, "base": _base(request)}
    body = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
    etag = hashlib.sha256(body).hexdigest()[:32]
    headers = {"ETag": f'"{etag}"', "Cache-Control": NO_CACHE, **ANYBODY}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


@router.get("/collections/{name}/assets", response_model=RowPage, responses=problems(404, 422, 503))
async def search(
    name: Name,
    request: Request,
    label: Annotated[
        str, Query(max_length=200, description="Part of the label, or one of the labels; case does not count.")
    ] = "",
    after: Annotated[str, Query(max_length=100, description="The `next` of the page before.")] = "",
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
) -> RowPage:
    """The assets of a collection, without those that were removed."""
    require_collection(name, "check the address")
    if after and not valid_key(after):
        raise Problem(422, "KEY_INVALID", "`after` is no asset key", hints=("use the `next` of the page before",))
    rows_of: Rows = request.app.state.rows_of

    def matching(index: Index) -> tuple[int, list[Row]]:
        return index.version, _matching(index, rows_of, label, after, limit)

    version, rows = await _read(request, name, matching)
    last = rows[-1].key if len(rows) == limit else None
    views = [_view(request, row) for row in rows]
    return RowPage(collection=name, version=version, assets=views, next=last)


@router.get("/collections/{name}/assets/{key}", response_model=PlaceView, responses=problems(404, 410, 422, 503))
async def place(name: Name, key: Key, request: Request) -> PlaceView:
    """One asset of a collection, and where the collection lists it."""
    require_collection(name, "check the address")
    if not valid_key(key):
        raise Problem(422, "KEY_INVALID", "this is no asset key", hints=("check the address",))
    rows_of: Rows = request.app.state.rows_of

    version, found = await _read(request, name, lambda index: (index.version, row_in(index, key, rows_of)))
    if found is None:
        raise Problem(404, "ASSET_UNKNOWN", f"there is no asset {key} in collection {name}", hints=("check the key",))
    shard, row = found
    if row.removed:
        hints = (f"POST /v1/assets/{key}/restore brings it back",)
        raise Problem(410, "ASSET_REMOVED", f"asset {key} was removed", hints=hints, headers=dict(ANYBODY))
    asset = _view(request, row)
    return PlaceView(collection=name, version=version, shard=url_of(request, shard.name), asset=asset)


@router.get("/keys", response_model=KeyPage)
async def public_keys(request: Request) -> KeyPage:
    """Whose signatures under collections to believe: for clients to keep from their first visit on."""
    believed = request.app.state.keys.believed
    return KeyPage(keys=[KeyView(key=each.id, ed25519=base64.b64encode(each.raw).decode()) for each in believed])


async def _read(request: Request, name: str, take: Callable[[Index], _T]) -> _T:
    """What `take` reads of a collection. Raises Problem COLLECTION_UNKNOWN, and those of `in_thread`."""
    store, believed = store_of(request), request.app.state.keys.believed

    def attempt() -> _T:
        return take(read_index(store.get(index_name(name)), name, believed))

    try:
        return await in_thread(lambda: again_if_moved(attempt))
    except FileNotFoundError:
        raise _unknown(name) from None


def _matching(index: Index, rows: Rows, label: str, after: str, limit: int) -> list[Row]:
    """At most `limit` rows behind `after` that match."""
    shards = (shard for shard in index.shards if shard.last > after)
    behind = (row for row in chain.from_iterable(map(rows, shards)) if row.key > after)
    return list(islice((row for row in behind if not row.removed and row.matches(label)), limit))


def _view(request: Request, row: Row) -> RowView:
    return RowView(
        key=row.key,
        label=row.label or row.key,
        labels=list(row.labels),
        version=row.version,
        state=row.state,
        updated=datetime.fromtimestamp(row.updated, UTC),
        manifest=url_of(request, row.manifest_name),
        manifest_sha256=row.manifest,
        preview=url_of(request, row.preview_name) if row.preview else "",
        self=f"/v1/assets/{row.key}",
        view=f"/view/{row.key}",
    )


def _base(request: Request) -> str:
    return url_of(request, "x").removesuffix("x")


def _unknown(name: str) -> Problem:
    hints = ("publishing its first asset makes it",)
    return Problem(404, "COLLECTION_UNKNOWN", f"there is no collection {name}", hints=hints)
