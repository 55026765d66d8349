"""/v1/collections: signed catalogues of assets as they are on the store, and search in them; /v1/keys: public keys."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
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
from capture2vr.gateway.search.collection_index import ReadListing
from capture2vr.gateway.search.known_roots import token_of
from capture2vr.gateway.search.listing import CollectionListing, Search
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.commit import MOST_FLAT
from capture2vr.storage.catalogue.earlier_forms import flat_index, take_over_flat
from capture2vr.storage.catalogue.entry import valid_key
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.reader import TreeParts, find_row, read_root, read_root_data, retry_if_shard_missing
from capture2vr.storage.catalogue.root import Index, parse_envelope
from capture2vr.storage.catalogue.row_filter import RowFilter
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.tree import shards_of
from capture2vr.storage.store import NO_CACHE, Store

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
    null on the last one. A page with `next` may have fewer assets than `limit`, or none: a collection that is being
    indexed is searched for two seconds at a time.
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
async def get_collection(
    name: Name,
    request: Request,
    form: Annotated[Literal["", "tree"], Query(description="`tree`: the root of the tree of its assets.")] = "",
) -> Response:
    """Get a collection's signed root (`form=tree`), or its flat index, and `base`, the URL prefix of its objects.

    Collections of over 5,000 assets have no flat index. Answers 304 for an ETag in If-None-Match.
    """
    require_collection(name, say("check_name_in_url"))
    store = store_of(request)
    try:
        text, signatures = await in_thread(
            lambda: parse_envelope(_signed(store, name, gateway_of(request).keys, is_tree=form == "tree"), name)
        )
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
    indexes, tenant, read = gateway_of(request).search, reads_tenant(request), _listing_reader(request, name)
    wanted = Search(search.rows, search.after, search.limit)
    found = await _from_store(name, lambda: indexes.search(tenant, name, read, wanted))
    views = [_row_view(request, row) for row in found.rows]
    return RowPage(collection=name, version=found.version, assets=views, next=found.next)


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
    parts = _parts_of(request, name)

    version, found = await _read(request, name, lambda index: (index.version, find_row(index, key, parts)))
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
    """Call `take` with a collection's verified root. Raises Problem COLLECTION_UNKNOWN, and those of `in_thread`."""
    store, keys = store_of(request), gateway_of(request).keys

    return await _from_store(name, lambda: take(_newest_root(store, name, keys)))


async def _from_store(name: str, attempt: Callable[[], _T]) -> _T:
    """Call `attempt`, which reads a collection. Raises Problem COLLECTION_UNKNOWN, and those of `in_thread`."""
    try:
        return await in_thread(lambda: retry_if_shard_missing(attempt))
    except FileNotFoundError:
        raise unknown_collection(name) from None


def _newest_root(store: Store, name: str, keys: Keys) -> Index:
    """Read a collection's root, after it has taken over what a worker of an earlier release has listed beside it."""
    _take_over(store, name, keys)
    return read_root(store, name, keys.verification_keys)


def _take_over(store: Store, name: str, keys: Keys) -> None:
    with suppress(CatalogueFault):  # who cannot sign reads what there is
        take_over_flat(store, name, keys)


def _signed(store: Store, name: str, keys: Keys, *, is_tree: bool) -> bytes:
    """Return the bytes of a collection's root or flat index, the latter as new as the root; who reads them checks them.

    Raises FileNotFoundError, Problem COLLECTION_LARGE where it has no flat index any more, CatalogueFault.
    """
    _take_over(store, name, keys)
    if is_tree:
        return read_root_data(store, name)
    index = read_root(store, name)
    if index.count > MOST_FLAT:
        detail = say("collection_too_large_for_client", name=name, most=MOST_FLAT)
        raise Problem(410, "COLLECTION_LARGE", detail, hints=(say("update_client"),))
    return flat_index(store, name, keys, index)


def _parts_of(request: Request, name: str) -> TreeParts:
    return gateway_of(request).parts(reads_tenant(request), name)


def _listing_reader(request: Request, name: str) -> ReadListing:
    """Return what reads a collection's root for searches, also once the request has been answered."""
    store, keys, parts = store_of(request), gateway_of(request).keys, _parts_of(request, name)

    tenant, roots = reads_tenant(request), gateway_of(request).search.roots

    def read() -> CollectionListing:
        index = _newest_root(store, name, keys)
        roots.remember(tenant, index)
        return CollectionListing(
            version=index.version,
            token=token_of(index),
            count=index.count,
            changed=partial(roots.changed, tenant, index, parts.nodes),
            leaves=partial(shards_of, index, parts.nodes),
            rows=parts.rows,
        )

    return read


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
