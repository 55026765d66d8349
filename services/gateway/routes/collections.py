"""/v1/collections: signed catalogues of many assets, as they stand on the store, and a search in them by label."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache, partial
from itertools import chain, islice
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel

from services.gateway.errors import Problem
from services.gateway.routes.objects import ANYBODY, in_thread, store_of, url_of
from services.gateway.routes.ranges import matches
from services.gateway.schemas import problems
from services.storage.catalogue import valid_key
from services.storage.collection import Index, Row, Shard, index_name, load_shard, opened, read_index
from services.storage.faults import SHARD_MISSING, CatalogueFault
from services.storage.store import NO_CACHE, Store

router = APIRouter(prefix="/v1", tags=["collections"])

_KEPT_SHARDS = 64  # parsed, by content, 0.7 MB each at most: every search walks all shards of its collection
_TRIES = 3  # a shard goes once 32 newer ones have come; the index of that moment knows another

Rows = Callable[[Shard], tuple[Row, ...]]
"""The rows of a shard."""

Name = Annotated[str, Path(max_length=200, description="The collection's name; `default` where nobody named another.")]


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
    _check_name(name)
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
    _check_name(name)
    if after and not valid_key(after):
        raise Problem(422, "KEY_INVALID", "`after` is no asset key", hints=("use the `next` of the page before",))
    store, believed, rows_of = store_of(request), request.app.state.keys.believed, request.app.state.rows_of

    def index() -> Index:
        return read_index(store.get(index_name(name)), name, believed)

    try:
        version, rows = await in_thread(lambda: _found(index, rows_of, label, after, limit))
    except FileNotFoundError:
        raise _unknown(name) from None
    last = rows[-1].key if len(rows) == limit else None
    views = [_view(request, row) for row in rows]
    return RowPage(collection=name, version=version, assets=views, next=last)


@router.get("/keys", response_model=KeyPage)
async def public_keys(request: Request) -> KeyPage:
    """Whose signatures under collections to believe: for clients to keep from their first visit on."""
    believed = request.app.state.keys.believed
    return KeyPage(keys=[KeyView(key=each.id, ed25519=base64.b64encode(each.raw).decode()) for each in believed])


def _found(index: Callable[[], Index], rows: Rows, label: str, after: str, limit: int) -> tuple[int, list[Row]]:
    """The version of the collection, and at most `limit` rows behind `after` that match."""
    for left in reversed(range(_TRIES)):
        present = index()
        shards = (shard for shard in present.shards if shard.last > after)
        try:
            behind = (row for row in chain.from_iterable(map(rows, shards)) if row.key > after)
            matching = (row for row in behind if not row.removed and row.matches(label))
            return present.version, list(islice(matching, limit))
        except CatalogueFault as fault:
            if fault.code != SHARD_MISSING or not left:
                raise
    raise AssertionError("the last try returns or raises")


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


def _check_name(name: str) -> None:
    if not valid_key(name):
        detail = "a collection's name has 1 to 100 letters, digits and ._- and begins with no sign"
        raise Problem(422, "COLLECTION_INVALID", detail, hints=("check the address",))


def _unknown(name: str) -> Problem:
    hints = ("publishing its first asset makes it",)
    return Problem(404, "COLLECTION_UNKNOWN", f"there is no collection {name}", hints=hints)
