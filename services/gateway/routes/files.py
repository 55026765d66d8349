"""/v1/files: the files of assets and their catalogues, where the store is a folder of ours."""

from __future__ import annotations

import hashlib
import pathlib
from collections.abc import AsyncIterator

import anyio
from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from services.gateway.errors import Problem
from services.gateway.routes.objects import ANYBODY, in_thread, store_of
from services.gateway.routes.ranges import UnsatisfiableError, matches, wanted_range
from services.gateway.schemas import problems
from services.storage.local import LocalStore
from services.storage.store import Head

router = APIRouter(prefix="/v1", tags=["assets"])

# Captures are people's rooms; they leave this service only towards a worker.
_PUBLIC = ("assets/", "catalog/", "collections/")
_READ_BYTES = 256 << 10  # from the disk at once


@router.head("/files/{name:path}", include_in_schema=False)
@router.get("/files/{name:path}", response_class=Response, responses=problems(404, 416, 503))
async def file(name: str, request: Request) -> Response:
    """A file of an asset, immutable under its name, in whole or in part."""
    store = store_of(request)
    if not isinstance(store, LocalStore) or not name.startswith(_PUBLIC):
        raise _no_file()
    try:
        head = await in_thread(lambda: store.head(name))
    except (FileNotFoundError, ValueError):
        raise _no_file() from None
    if not name.startswith("assets/"):
        return await _small_file(store, head, request)
    return await _large_file(store, head, request)


async def _small_file(store: LocalStore, head: Head, request: Request) -> Response:
    """A document that may be replaced at any time: read at once, so that its length and content belong together."""
    body = await in_thread(lambda: store.get(head.name))
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
        content_range = {"Content-Range": f"bytes */{head.size}", **ANYBODY}
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
    return {"ETag": f'"{etag}"', "Cache-Control": head.cache_control, **ANYBODY}


def _no_file() -> Problem:
    hints = ("GET /v1/assets/{key} tells the names of an asset's files",)
    return Problem(404, "FILE_UNKNOWN", "there is no such file here", hints=hints, headers=dict(ANYBODY))
