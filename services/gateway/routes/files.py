"""/v1/files: serves the files of assets and catalogues, with range requests, where the store is a local folder."""

from __future__ import annotations

import hashlib
import logging
import pathlib
import re
from collections.abc import AsyncIterator

import anyio
from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from services.gateway.access.caller import Scope
from services.gateway.errors import Problem
from services.gateway.routes.access_rules import caller_of, needs
from services.gateway.routes.http_ranges import UnsatisfiableError, etag_matches, parse_range
from services.gateway.routes.store_access import ANY_ORIGIN, in_thread
from services.gateway.schemas import problems
from services.storage.local import LocalStore
from services.storage.store import NO_CACHE, Head, Store
from services.storage.tenant_store import tenant_of

router = APIRouter(prefix="/v1", tags=["assets"])

# As in the bucket's policy: files that are addressed by their hash, and signed collections. Captures are private (they
# show people's rooms): only workers get them. So are entries under catalog/: /v1/assets returns their public part.
_PUBLIC = ("assets/", "collections/")
_HASH = re.compile(r"\.([0-9a-f]{64})(\.[^./]*)?$")
_READ_BYTES = 256 << 10  # per read from the disk

_log = logging.getLogger(__name__)


@router.head("/files/{name:path}", include_in_schema=False, dependencies=[needs(Scope.READ)])
@router.get(
    "/files/{name:path}",
    response_class=Response,
    dependencies=[needs(Scope.READ)],
    responses=problems(404, 416, 503),
)
async def get_file(name: str, request: Request) -> Response:
    """Get a file of an asset, or a part of it with a Range header. Files under `assets/` never change."""
    store: Store = request.app.state.store
    if not isinstance(store, LocalStore):
        raise _unknown_file()
    tenant, own_name = _split(name)
    if tenant != caller_of(request).tenant or not own_name.startswith(_PUBLIC):
        raise _unknown_file()
    try:
        head = await in_thread(lambda: store.head(name))
    except (FileNotFoundError, ValueError):
        raise _unknown_file() from None
    if not own_name.startswith("assets/"):
        return await _small_file(store, head, request)
    if not _is_intact(head):
        _log.error("%s is not what was published: its sha256 is %s", head.name, head.etag)
        request.app.state.metrics.observe_damage("file")
        raise _damaged_file(head.name)
    return await _large_file(store, head, request)


def _split(name: str) -> tuple[str, str]:
    """Split an object's name into its tenant and its name there. Raises Problem FILE_UNKNOWN."""
    try:
        return tenant_of(name)
    except ValueError:
        raise _unknown_file() from None


async def _small_file(store: LocalStore, head: Head, request: Request) -> Response:
    """Answer with a document that may be replaced at any time: read as a whole, so that length and content match."""
    body = await in_thread(lambda: store.get(head.name))
    etag = hashlib.sha256(body).hexdigest()
    if etag_matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=_file_headers(head, etag))
    return Response(body, headers=_file_headers(head, etag), media_type=head.content_type)


async def _large_file(store: LocalStore, head: Head, request: Request) -> Response:
    headers = {**_file_headers(head, head.etag), "Accept-Ranges": "bytes"}
    if etag_matches(request.headers.get("if-none-match"), head.etag):
        return Response(status_code=304, headers=headers)
    request_headers = request.headers
    try:
        part = parse_range(request_headers.get("range"), request_headers.get("if-range"), head.etag, head.size)
    except UnsatisfiableError as error:
        content_range = {"Content-Range": f"bytes */{head.size}", **ANY_ORIGIN}
        hints = (f"ask for a range that begins below byte {head.size}",)
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
    return {"ETag": f'"{etag}"', "Cache-Control": head.cache_control, **ANY_ORIGIN}


def _is_intact(head: Head) -> bool:
    """Whether an asset's file is still that of the hash in its name. A local store's etag is the content's hash, and
    is computed again for a file that has changed.
    """
    named = _HASH.search(head.name)
    return named is None or named[1] == head.etag


def _damaged_file(name: str) -> Problem:
    hints = ("publish the asset again, or restore the file from a backup",)
    detail = "the stored file is not the one that was published"
    headers = {"Cache-Control": NO_CACHE, **ANY_ORIGIN}
    return Problem(503, "FILE_DAMAGED", detail, file=pathlib.PurePosixPath(name).name, hints=hints, headers=headers)


def _unknown_file() -> Problem:
    hints = ("GET /v1/assets/{key} lists the URLs of an asset's files",)
    return Problem(404, "FILE_UNKNOWN", "there is no such file", hints=hints, headers=dict(ANY_ORIGIN))
