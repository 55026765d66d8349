"""/v1/assets: what was published, by key. /v1/files: the files themselves, where the store is a folder of ours."""

from __future__ import annotations

import hashlib
import io
import json
import pathlib
from collections.abc import AsyncIterator, Callable
from typing import Annotated, TypeVar
from urllib.parse import urljoin

import anyio
import anyio.to_thread
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import RedirectResponse, StreamingResponse
from pydantic import BaseModel

from services.gateway.errors import Problem
from services.gateway.routes.ranges import UnsatisfiableError, matches, wanted_range
from services.gateway.schemas import problems
from services.storage.catalogue import Entry, entry, list_keys, valid_key
from services.storage.local import LocalStore
from services.storage.store import NO_CACHE, Head, Store

router = APIRouter(prefix="/v1", tags=["assets"])

_PUBLIC = ("assets/", "catalog/")  # captures are people's rooms; they leave this service only towards a worker
_READ_BYTES = 256 << 10  # from the disk at once
_ANYBODY = {"Access-Control-Allow-Origin": "*", "Access-Control-Expose-Headers": "ETag, Content-Range, Accept-Ranges"}
_QR_SCALE, _QR_BORDER = 8, 4  # pixels per module; the quiet zone that ISO/IEC 18004 asks for

Key = Annotated[str, Path(max_length=200, description="The asset's key.")]
_T = TypeVar("_T")


class AssetSummary(BaseModel):
    """One asset in a list; `preview` is the address of a picture, `self` that of the whole entry."""

    key: str
    version: int
    state: str
    updated: str
    label: str
    preview: str
    self: str
    view: str


class AssetPage(BaseModel):
    """Assets by key; `next` is the `after` of the next page, or null."""

    assets: list[AssetSummary]
    next: str | None


@router.get("/assets", response_model=AssetPage, responses=problems(422, 503))
async def page(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    after: Annotated[str, Query(max_length=100, description="The `next` of the page before.")] = "",
) -> AssetPage:
    """The assets there are."""
    if after and not valid_key(after):
        raise Problem(422, "KEY_INVALID", "`after` is no asset key", hints=("use the `next` of the page before",))
    store = _store(request)
    entries = await _in_thread(lambda: _entries(store, after, limit))
    last = entries[-1].key if len(entries) == limit else None
    return AssetPage(assets=[_summary(request, each) for each in entries], next=last)


@router.get("/assets/{key}", responses={200: {"content": {"application/json": {}}}, **problems(404, 422, 503)})
async def asset(key: Key, request: Request) -> Response:
    """The catalogue entry of an asset with the address of every file; 304 under a known ETag."""
    found = await _entry(request, key)
    document = json.loads(json.dumps(found.document))
    for file in [document["manifest"], document["preview"], *document["lods"], *document["files"]]:
        if file is not None:
            file["url"] = _url(request, file["name"])
    body = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
    etag = hashlib.sha256(body).hexdigest()[:32]
    headers = {"ETag": f'"{etag}"', "Cache-Control": NO_CACHE, **_ANYBODY}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


@router.get("/assets/{key}/lod/{level}", status_code=307, responses=problems(404, 422, 503))
async def lod(key: Key, level: Annotated[int, Path(ge=0, le=99)], request: Request) -> Response:
    """To the file of a level of detail, 0 being the finest, of the current version."""
    levels = (await _entry(request, key)).document["lods"]
    name = next((each["name"] for each in levels if each["level"] == level), None)
    if name is None:
        known = ", ".join(str(each["level"]) for each in levels)
        hints = (f"ask for one of: {known}",)
        raise Problem(404, "LOD_UNKNOWN", f"asset {key} has no level {level}; there are {known}", hints=hints)
    return RedirectResponse(_url(request, name), 307, {"Cache-Control": NO_CACHE, **_ANYBODY})


@router.get(
    "/assets/{key}/qr.svg",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}, **problems(404, 422, 503)},
)
async def qr(key: Key, request: Request) -> Response:
    """The address of the asset's viewer as a QR code, to hand it from a screen to a headset."""
    await _entry(request, key)
    return Response(_qr_svg(urljoin(_home(request), f"view/{key}")), media_type="image/svg+xml")


@router.head("/files/{name:path}", include_in_schema=False)
@router.get("/files/{name:path}", response_class=Response, responses=problems(404, 416, 503))
async def file(name: str, request: Request) -> Response:
    """A file of an asset, immutable under its name, in whole or in part."""
    store = _store(request)
    if not isinstance(store, LocalStore) or not name.startswith(_PUBLIC):
        raise _no_file()
    try:
        head = await _in_thread(lambda: store.head(name))
    except (FileNotFoundError, ValueError):
        raise _no_file() from None
    if not name.startswith("assets/"):
        return await _small_file(store, head, request)
    return await _large_file(store, head, request)


async def _small_file(store: LocalStore, head: Head, request: Request) -> Response:
    """A document that may be replaced at any time: read at once, so that its length and content belong together."""
    body = await _in_thread(lambda: store.get(head.name))
    etag = hashlib.sha256(body).hexdigest()
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=_file_headers(head, etag))
    return Response(body, headers=_file_headers(head, etag), media_type=head.content_type)


async def _large_file(store: LocalStore, head: Head, request: Request) -> Response:
    headers = {**_file_headers(head, head.etag), "Accept-Ranges": "bytes"}
    if matches(request.headers.get("if-none-match"), head.etag):
        return Response(status_code=304, headers=headers)
    given = request.headers
    try:
        part = wanted_range(given.get("range"), given.get("if-range"), head.etag, head.size)
    except UnsatisfiableError as error:
        content_range = {"Content-Range": f"bytes */{head.size}", **_ANYBODY}
        hints = (f"begin below byte {head.size}",)
        raise Problem(416, "RANGE_UNSATISFIABLE", str(error), hints=hints, headers=content_range) from None
    start, end = part or (0, head.size)
    headers["Content-Length"] = str(end - start)
    if part:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{head.size}"
    status = 206 if part else 200
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=head.content_type)
    return StreamingResponse(_blocks(store.path(head.name), start, end), status, headers, head.content_type)


async def _blocks(path: pathlib.Path, start: int, end: int) -> AsyncIterator[bytes]:
    async with await anyio.open_file(path, "rb") as source:
        await source.seek(start)
        while start < end and (block := await source.read(min(_READ_BYTES, end - start))):
            start += len(block)
            yield block


def _file_headers(head: Head, etag: str) -> dict[str, str]:
    return {"ETag": f'"{etag}"', "Cache-Control": head.cache_control, **_ANYBODY}


async def _entry(request: Request, key: str) -> Entry:
    """The key's entry. Raises Problem KEY_INVALID, ASSET_UNKNOWN, STORE_UNAVAILABLE."""
    if not valid_key(key):
        detail = "an asset key has 1 to 100 letters, digits and ._- and begins with no sign"
        raise Problem(422, "KEY_INVALID", detail, hints=("check the address",))
    store = _store(request)
    try:
        return await _in_thread(lambda: entry(store, key))
    except FileNotFoundError:
        hints = ("its first job may still be under way",)
        raise Problem(404, "ASSET_UNKNOWN", f"there is no asset {key}", hints=hints) from None


def _entries(store: Store, after: str, limit: int) -> list[Entry]:
    return [entry(store, key) for key in list_keys(store, after=after, limit=limit)]


def _summary(request: Request, found: Entry) -> AssetSummary:
    preview = found.document["preview"]
    return AssetSummary(
        key=found.key,
        version=found.version,
        state=found.state,
        updated=found.document["updated"],
        label=found.document["label"] or found.key,
        preview=_url(request, preview["name"]) if preview else "",
        self=f"/v1/assets/{found.key}",
        view=f"/view/{found.key}",
    )


async def _in_thread(work: Callable[[], _T]) -> _T:
    """Off the event loop, with the store's failures told as problems."""
    try:
        return await anyio.to_thread.run_sync(work)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", "the store does not answer", retryable=True) from error


def _store(request: Request) -> Store:
    store: Store = request.app.state.store
    return store


def _home(request: Request) -> str:
    """How clients reach this gateway, with a slash at the end."""
    public: str = request.app.state.settings.public_url
    return (public or str(request.base_url)).rstrip("/") + "/"


def _url(request: Request, name: str) -> str:
    """The whole address of an object: a local store gives only a path."""
    return urljoin(_home(request), _store(request).url(name))


def _no_file() -> Problem:
    hints = ("GET /v1/assets/{key} tells the names of an asset's files",)
    return Problem(404, "FILE_UNKNOWN", "there is no such file here", hints=hints, headers=dict(_ANYBODY))


def _qr_svg(text: str) -> bytes:
    import segno

    buffer = io.BytesIO()
    segno.make(text, micro=False).save(buffer, kind="svg", scale=_QR_SCALE, border=_QR_BORDER, light="#fff")
    return buffer.getvalue()
