"""/v1/files: serves the files of assets and catalogues, with range requests, where the store is a local folder.

/v1/readable tells a proxy that serves them itself who may read them.
"""

from __future__ import annotations

import hashlib
import logging
import pathlib
from collections.abc import AsyncIterator

import anyio
from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse, StreamingResponse

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.routes.http_ranges import etag_matches, take_range
from capture2vr.gateway.routes.read_rules import READS_FILE, READS_FOLDER, Reading, reading_of, unknown_file
from capture2vr.gateway.routes.store_access import in_thread
from capture2vr.gateway.schemas import problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import hash_in_name
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import NO_CACHE, Head, PresigningStore, Store

router = APIRouter(prefix="/v1", tags=["assets"])

_READ_BYTES = 256 << 10  # per read from the disk

_log = logging.getLogger(__name__)


@router.head("/files/{name:path}", include_in_schema=False, dependencies=[READS_FILE])
@router.get(
    "/files/{name:path}",
    response_class=Response,
    dependencies=[READS_FILE],
    responses=problems(404, 416, 503),
)
async def get_file(name: str, request: Request, gateway: GatewayOf) -> Response:
    """Get a file of an asset, or a part of it with a Range header. Files under `assets/` never change."""
    store = gateway.store
    if not isinstance(store, LocalStore):
        redirect = _redirect(store, name)
        # A presigned URL is good for GET alone.
        return await headers_alone(store, name, request) if request.method == "HEAD" else redirect
    try:
        head = await in_thread(lambda: store.head(name))
    except (FileNotFoundError, ValueError):
        raise unknown_file() from None
    reading = reading_of(request)
    if reading.thing.kind == "collection":
        return await _small_file(store, head, request)
    if not _is_intact(head):
        _log.error("%s is not what was published: its sha256 is %s", head.name, head.etag)
        gateway.metrics.observe_damage("file")
        raise _damaged_file(head.name, reading)
    return await _large_file(store, head, request)


def _redirect(store: Store, name: str) -> Response:
    """Send the client to the object for some minutes, where the bucket is private. Raises Problem FILE_UNKNOWN."""
    try:
        url = store.presigned_url(name) if isinstance(store, PresigningStore) else ""
    except ValueError:
        raise unknown_file() from None
    if not url:
        raise unknown_file()
    return RedirectResponse(url, 307, {"Cache-Control": "private, no-store"})


async def headers_alone(store: Store, name: str, request: Request) -> Response:
    """Answer HEAD for an object that is read elsewhere. Raises Problem FILE_UNKNOWN."""
    try:
        head = await in_thread(lambda: store.head(name))
    except FileNotFoundError:
        raise unknown_file() from None
    headers = {**_file_headers(head, head.etag, request), "Accept-Ranges": "bytes", "Content-Length": str(head.size)}
    return Response(headers=headers, media_type=head.content_type)


@router.get(
    "/readable/{folder:path}",
    status_code=204,
    dependencies=[READS_FOLDER],
    responses={204: {"headers": {"X-Visibility": {"schema": {"type": "string"}}}}, **problems(401, 404)},
)
async def may_read_folder(folder: str, request: Request) -> Response:
    """Authorise a proxy's request for files of an asset or a collection: 204 and the visibility, or 401.

    For nginx's auth_request. `folder` is `assets/KEY` or `collections/NAME`, of others behind `tenants/TENANT/`.
    """
    reading = reading_of(request)
    return Response(status_code=204, headers={"X-Visibility": reading.visibility, "Cache-Control": "no-store"})


async def _small_file(store: LocalStore, head: Head, request: Request) -> Response:
    """Answer with a document that may be replaced at any time: read as a whole, so that length and content match."""
    body = await in_thread(lambda: store.get(head.name))
    etag = hashlib.sha256(body).hexdigest()
    if etag_matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=_file_headers(head, etag, request))
    return Response(body, headers=_file_headers(head, etag, request), media_type=head.content_type)


async def _large_file(store: LocalStore, head: Head, request: Request) -> Response:
    headers = {**_file_headers(head, head.etag, request), "Accept-Ranges": "bytes"}
    if etag_matches(request.headers.get("if-none-match"), head.etag):
        return Response(status_code=304, headers=headers)
    cors = reading_of(request).cors_headers
    start, end, status = take_range(request.headers, head.etag, head.size, headers, cors)
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=head.content_type)
    return StreamingResponse(_blocks(store.path(head.name), start, end), status, headers, head.content_type)


async def _blocks(path: pathlib.Path, start: int, end: int) -> AsyncIterator[bytes]:
    async with await anyio.open_file(path, "rb") as source:
        await source.seek(start)
        while start < end and (block := await source.read(min(_READ_BYTES, end - start))):
            start += len(block)
            yield block


def _file_headers(head: Head, etag: str, request: Request) -> dict[str, str]:
    reading = reading_of(request)
    cache_control = reading.cache_control(head.cache_control)
    return {"ETag": f'"{etag}"', "Cache-Control": cache_control, **reading.cors_headers}


def _is_intact(head: Head) -> bool:
    """Whether an asset's file is still that of the hash in its name. A local store's etag is the content's hash, and
    is computed again for a file that has changed.
    """
    return hash_in_name(head.name) in (None, head.etag)


def _damaged_file(name: str, reading: Reading) -> Problem:
    hints = (say("publish_asset_again_restore_file"),)
    detail = say("stored_file_not_one_published")
    headers = {"Cache-Control": NO_CACHE, **reading.cors_headers}
    return Problem(503, "FILE_DAMAGED", detail, file=pathlib.PurePosixPath(name).name, hints=hints, headers=headers)
