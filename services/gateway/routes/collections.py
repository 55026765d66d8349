"""/v1/collections: signed catalogues of assets as they are on the store, and search in them; /v1/keys: public keys."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from itertools import chain, islice
from typing import Annotated, Literal, TypeVar

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, Field

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.jobs.collection_choice import require_collection
from capture2vr.gateway.routes.access_rules import ANYONE
from capture2vr.gateway.routes.http_ranges import etag_matches
from capture2vr.gateway.routes.read_rules import READS_COLLECTION, reading_of, reads_tenant, unknown_collection
from capture2vr.gateway.routes.store_access import in_thread, object_url, page_path, store_of
from capture2vr.gateway.schemas import problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.collection import (
    Index,
    Row,
    index_name,
    parse_envelope,
    read_index,
)
from capture2vr.storage.catalogue.entry import valid_key
from capture2vr.storage.catalogue.reader import LoadRows, find_row, retry_if_shard_missing
from capture2vr.storage.catalogue.row_filter import RowFilter
from capture2vr.storage.store import NO_CACHE

router = APIRouter(prefix="/v1", tags=["collections"])

_T = TypeVar("_T")

Name = Annotated[
    str,
    Path(max_length=200, description="The collection's name; `default` is the one of assets for which none was named."),
]
Key = Annotated[str, Path(max_length=200, description="The asset's key.")]


class RowView(BaseModel):
    """An asset of a collection. `bytes`: size of all files, null where it is not known. `manifest` is the URL of its
    manifest (all its data), `self` the URL of its catalogue entry, `preview` the URL of a picture or "", `view` the URL
    of its viewer page. `grade` is good, usable, incomplete or shoot again; "" where nothing could tell.
    """

    key: str
    label: str
    labels: list[str]
    version: int
    state: str
    grade: str
    updated: datetime
    bytes: int | None
    manifest: str
    manifest_sha256: str
    preview: str
    self: str
    view: str


class RowPage(BaseModel):
    """A page of assets, sorted by key. `version` is the collection's; `next` is the value of `after` for the next page,
    null on the last one.
    """

    collection: str
    version: int
    assets: list[RowView]
    next: str | None


class PlaceView(BaseModel):
    """An asset in a collection. `version` is the collection's, `shard` the URL of the object that lists the asset."""

    collection: str
    version: int
    shard: str
    asset: RowView


class PublicKeyView(BaseModel):
    """An Ed25519 public key: `key` is its id, `ed25519` its 32 raw bytes as base64."""

    key: str
    ed25519: str


class PublicKeyPage(BaseModel):
    """The public keys whose signatures this gateway accepts; if empty, it does not check signatures."""

    keys: list[PublicKeyView]


class RowSearch(BaseModel):
    """What a search in a collection asks for, in the query of its URL."""

    label: str = Field("", max_length=200, description="Part of the label, or one of the labels; case is ignored.")
    state: Literal["", "preview", "refined"] = Field("", description="Only assets in this state.")
    since: AwareDatetime | None = Field(None, description="Only assets that changed at this time or later.")
    until: AwareDatetime | None = Field(None, description="Only assets that changed at this time or earlier.")
    min_bytes: int | None = Field(None, ge=0, description="Only assets of this size or more, all files.")
    max_bytes: int | None = Field(None, ge=0, description="Only assets of this size or less, all files.")
    after: str = Field("", max_length=100, description="`next` of the previous page; empty: first page.")
    limit: int = Field(20, ge=1, le=100)

    @property
    def rows(self) -> RowFilter:
        """Which rows of the collection are meant."""
        return RowFilter(self.label, self.state, self.since, self.until, self.min_bytes, self.max_bytes)


@router.get(
    "/collections/{name}",
    dependencies=[READS_COLLECTION],
    responses={200: {"content": {"application/json": {}}}, **problems(404, 422, 503)},
)
async def get_collection(name: Name, request: Request) -> Response:
    """Get a collection's signed index, as it is on the store, and `base`, the URL prefix of its objects.

    Answers 304 for an ETag in If-None-Match.
    """
    require_collection(name, say("check_name_in_url"))
    store = store_of(request)
    try:
        text, signatures = await in_thread(lambda: parse_envelope(store.get(index_name(name)), name))
    except FileNotFoundError:
        raise unknown_collection(name) from None
    # `base` needs no signature: clients check everything that they read below it by its hash.
    document = {"signed": text, "signatures": signatures, "base": _objects_url(request)}
    body = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
    etag = hashlib.sha256(body).hexdigest()[:32]
    reading = reading_of(request)
    headers = {"ETag": f'"{etag}"', "Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}
    if etag_matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


@router.get(
    "/collections/{name}/assets",
    response_model=RowPage,
    dependencies=[READS_COLLECTION],
    responses=problems(404, 422, 503),
)
async def search_collection(name: Name, request: Request, search: Annotated[RowSearch, Query()]) -> RowPage:
    """Search a collection's assets by label, state, date and size, without removed ones. Without any, list all."""
    require_collection(name, say("check_name_in_url"))
    if search.after and not valid_key(search.after):
        hints = ("use the `next` of the previous page",)
        raise Problem(422, "KEY_INVALID", "`after` is not a valid asset key", hints=hints)
    wanted, load_rows = search.rows, _load_rows_of(request)

    def find_matches(index: Index) -> tuple[int, list[Row]]:
        return index.version, _matching_rows(index, load_rows, wanted, search.after, search.limit)

    version, rows = await _read(request, name, find_matches)
    last = rows[-1].key if len(rows) == search.limit else None
    views = [_row_view(request, row) for row in rows]
    return RowPage(collection=name, version=version, assets=views, next=last)


@router.get(
    "/collections/{name}/assets/{key}",
    response_model=PlaceView,
    dependencies=[READS_COLLECTION],
    responses=problems(404, 410, 422, 503),
)
async def get_collection_asset(name: Name, key: Key, request: Request) -> PlaceView:
    """Get one asset of a collection, and the shard that lists it."""
    require_collection(name, say("check_name_in_url"))
    if not valid_key(key):
        raise Problem(422, "KEY_INVALID", say("not_valid_asset_key"), hints=(say("check_key_in_url"),))
    load_rows = _load_rows_of(request)

    version, found = await _read(request, name, lambda index: (index.version, find_row(index, key, load_rows)))
    if found is None:
        raise Problem(
            404, "ASSET_UNKNOWN", say("no_asset_in_collection", key=key, collection=name), hints=(say("check_key"),)
        )
    shard, row = found
    if row.removed:
        hints = (f"POST /v1/assets/{key}/restore restores it",)
        raise Problem(
            410, "ASSET_REMOVED", say("asset_removed", key=key), hints=hints, headers=reading_of(request).cors_headers
        )
    asset = _row_view(request, row)
    return PlaceView(collection=name, version=version, shard=object_url(request, shard.name), asset=asset)


@router.get("/keys", response_model=PublicKeyPage, dependencies=[ANYONE])
async def list_public_keys(gateway: GatewayOf) -> PublicKeyPage:
    """List the public keys that verify collections; clients store them at their first visit (trust on first use)."""
    keys = gateway.keys.verification_keys
    return PublicKeyPage(
        keys=[PublicKeyView(key=each.id, ed25519=base64.b64encode(each.raw).decode()) for each in keys]
    )


async def _read(request: Request, name: str, take: Callable[[Index], _T]) -> _T:
    """Call `take` with a collection's verified index. Raises Problem COLLECTION_UNKNOWN, and those of `in_thread`."""
    store, keys = store_of(request), gateway_of(request).keys.verification_keys

    def attempt() -> _T:
        return take(read_index(store.get(index_name(name)), name, keys))

    try:
        return await in_thread(lambda: retry_if_shard_missing(attempt))
    except FileNotFoundError:
        raise unknown_collection(name) from None


def _load_rows_of(request: Request) -> LoadRows:
    return partial(gateway_of(request).load_rows, reads_tenant(request))


def _matching_rows(index: Index, rows: LoadRows, wanted: RowFilter, after: str, limit: int) -> list[Row]:
    """Return at most `limit` rows with keys behind `after` that are wanted."""
    shards = (shard for shard in index.shards if shard.last > after)
    behind = (row for row in chain.from_iterable(map(rows, shards)) if row.key > after)
    return list(islice(filter(wanted.accepts, behind), limit))


def _row_view(request: Request, row: Row) -> RowView:
    return RowView(
        key=row.key,
        label=row.label or row.key,
        labels=list(row.labels),
        version=row.version,
        state=row.state,
        grade=row.grade,
        updated=datetime.fromtimestamp(row.updated, UTC),
        bytes=row.bytes or None,
        manifest=object_url(request, row.manifest_name),
        manifest_sha256=row.manifest,
        preview=object_url(request, row.preview_name) if row.preview else "",
        self=page_path(request, f"/v1/assets/{row.key}"),
        view=page_path(request, f"/view/{row.key}"),
    )


def _objects_url(request: Request) -> str:
    return object_url(request, "x").removesuffix("x")
