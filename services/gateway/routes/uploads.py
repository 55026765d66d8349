"""/v1/uploads: uploads that go on after a lost connection, by the protocol tus 1.0.0, and the captures they become.

An upload's bytes are the body that POST /v1/captures takes, or one file of any kind. A last call makes the capture of
them, in the same way, and can be repeated when its answer was lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import APIRouter, BackgroundTasks, Depends, Path, Request, Response
from fastapi.routing import APIRoute

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.limits import limited
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.jobs.capture_objects import is_stored, read_receipt
from capture2vr.gateway.photo_boxes import BoxQuery, parse_box
from capture2vr.gateway.resumable import protocol
from capture2vr.gateway.resumable.receiver import Part, too_long
from capture2vr.gateway.resumable.store import Upload
from capture2vr.gateway.resumable.uploads import content_of
from capture2vr.gateway.routes.access_rules import caller_of, limits_of, needs
from capture2vr.gateway.routes.captures import CaptureView, Continues
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.uploads.accept import Uploader
from capture2vr.gateway.uploads.receive import batches, require_media_type
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_MOST_UNFINISHED = 1_000  # uploads of a tenant: a row each; a walk of 2,000 photos is one upload
_RETRY_S = 60

UploadId = Annotated[str, Path(max_length=40, pattern=r"^upl_[0-9a-f]+$", description="Id of an upload.")]


class _TusRoute(APIRoute):
    """A route whose answers, problems too, carry the version of tus."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def handle_tus(request: Request) -> Response:
            try:
                answer = await handle(request)
            except Problem as problem:
                problem.headers.setdefault("Tus-Resumable", protocol.VERSION)
                raise
            answer.headers["Tus-Resumable"] = protocol.VERSION
            return answer

        return handle_tus


def _speaks_tus(request: Request) -> None:
    protocol.require_version(request.headers)


router = APIRouter(prefix="/v1/uploads", tags=["captures"], route_class=_TusRoute)
_UPLOADS = needs(Scope.CAPTURE)
_TUS = [_UPLOADS, Depends(_speaks_tus)]
_NUMBER = {"type": "integer", "minimum": 0}
_TEXT = {"type": "string"}
_VERSION = {"type": "string", "enum": [protocol.VERSION]}


def _document(*, has_body: bool = False, **headers: dict[str, Any]) -> dict[str, Any]:
    """Return what the OpenAPI document says of a request of tus, whose body and headers are read by our own code."""
    told = {"Tus-Resumable": _VERSION, **{name.replace("_", "-"): schema for name, schema in headers.items()}}
    required = ("Tus-Resumable", "Upload-Length", "Upload-Offset")
    parameters = [
        {"name": name, "in": "header", "required": name in required, "schema": schema} for name, schema in told.items()
    ]
    content = {protocol.MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}
    return {"parameters": parameters, **({"requestBody": {"content": content}} if has_body else {})}


@router.options("", status_code=204, dependencies=[_UPLOADS], response_class=Response)
async def get_tus_options(request: Request, gateway: GatewayOf) -> Response:
    """Ask which version and extensions of tus there are, and how large an upload may be."""
    most = gateway.settings.max_upload_bytes
    own = (await limits_of(request)).capture_bytes
    return Response(status_code=204, headers=protocol.option_headers(min(most, own) if own else most))


@router.post(
    "",
    status_code=201,
    dependencies=_TUS,
    response_class=Response,
    responses=problems(400, 408, 412, 413, 415, 429, 503, 507),
    openapi_extra=_document(has_body=True, Upload_Length=_NUMBER, Upload_Metadata=_TEXT, Upload_Checksum=_TEXT),
)
async def create_upload(request: Request, gateway: GatewayOf) -> Response:
    """Create an upload, and send its first bytes if you like. `Upload-Metadata` may have `filename`, `filetype` (the
    body's media type: a form, a zip, or anything), and `name` and `collection` of the capture.
    """
    length, metadata = protocol.parse_bytes(request.headers, "Upload-Length"), protocol.parse_metadata(request.headers)
    require_media_type(*content_of(metadata))
    await _check_length(request, length)
    begins = "content-type" in request.headers
    checksum = _parse_part(request, length) if begins else None
    resumable, tenant = gateway.captures.resumable, caller_of(request).tenant
    database, expiry = resumable.database, resumable.expiry()
    upload = await resumable.run(lambda: database.create(tenant, length, metadata, expiry, _MOST_UNFINISHED))
    if upload is None:
        detail = say("uploads_unfinished_already", count=_MOST_UNFINISHED)
        raise limited("UPLOADS_LIMITED", detail, _RETRY_S, hint=say("finish_some_delete_them"))
    if begins:
        try:
            upload = await _append(request, upload, checksum)
        except Exception:  # nobody is told its id: it would stay unfinished until it expires
            await _discard(request, await resumable.find(tenant, upload.id))
            raise
    headers = {"Location": f"/v1/uploads/{upload.id}", **protocol.state_headers(upload)}
    return Response(status_code=201, headers=headers)


@router.head(
    "/{upload}",
    dependencies=_TUS,
    response_class=Response,
    responses=problems(404, 412, 422),
    openapi_extra=_document(),
)
async def get_upload(upload: UploadId, request: Request, gateway: GatewayOf) -> Response:
    """Ask how far an upload is, to go on from there. `Upload-Capture` is the capture that a finished one became."""
    found = await gateway.captures.resumable.find(caller_of(request).tenant, upload)
    headers = {"Upload-Length": str(found.length), "Cache-Control": "no-store", **protocol.state_headers(found)}
    if found.metadata:
        headers["Upload-Metadata"] = protocol.format_metadata(found.metadata)
    return Response(status_code=200, headers=headers)


@router.patch(
    "/{upload}",
    status_code=204,
    dependencies=_TUS,
    response_class=Response,
    responses=problems(400, 404, 408, 409, 412, 413, 415, 422, 423, 429, 503, 507),
    openapi_extra=_document(has_body=True, Upload_Offset=_NUMBER, Upload_Checksum=_TEXT),
)
async def continue_upload(upload: UploadId, request: Request, gateway: GatewayOf) -> Response:
    """Send the bytes from `Upload-Offset` on. What arrived before the connection broke is kept, unless
    `Upload-Checksum` tells the checksum of the whole body.
    """
    found = await gateway.captures.resumable.find(caller_of(request).tenant, upload)
    protocol.require_media_type(request.headers)
    offset = protocol.parse_bytes(request.headers, "Upload-Offset")
    if offset != found.received:
        detail = say("upload_bytes", received=found.received, offset=offset)
        answer = {"Upload-Offset": str(found.received)}
        raise Problem(409, "UPLOAD_OFFSET", detail, hints=(say("go_on_from_upload_offset"),), headers=answer)
    if found.received < found.length:
        found = await _append(request, found, _parse_part(request, found.length, found.received))
    elif await _has_body(request):
        raise too_long(found.length)
    return Response(status_code=204, headers=protocol.state_headers(found))


@router.delete(
    "/{upload}",
    status_code=204,
    dependencies=_TUS,
    response_class=Response,
    responses=problems(404, 412, 422, 423, 503),
    openapi_extra=_document(),
)
async def delete_upload(upload: UploadId, request: Request, gateway: GatewayOf) -> Response:
    """Delete an upload and its bytes for good. The capture that a finished one became stays."""
    await _discard(request, await gateway.captures.resumable.find(caller_of(request).tenant, upload))
    return Response(status_code=204)


@router.post("/{upload}", dependencies=_TUS, include_in_schema=False, response_class=Response)
async def override_method(upload: UploadId, request: Request, gateway: GatewayOf) -> Response:
    """Answer a POST as the method that X-HTTP-Method-Override names, for clients that can send nothing else."""
    methods = {"PATCH": continue_upload, "HEAD": get_upload, "DELETE": delete_upload}
    named = methods.get(request.headers.get("x-http-method-override", "").upper())
    if named is None:
        raise Problem(405, "METHOD_NOT_ALLOWED", "an upload goes on with PATCH", headers={"Allow": ", ".join(methods)})
    return await named(upload, request, gateway)


@router.post(
    "/{upload}/capture",
    status_code=201,
    response_model=CaptureView,
    dependencies=[_UPLOADS],
    responses=problems(400, 404, 409, 413, 415, 422, 423, 429, 503, 507),
)
async def finish_upload(
    upload: UploadId,
    request: Request,
    gateway: GatewayOf,
    tasks: BackgroundTasks,
    box: BoxQuery = "",
    continues: Continues = "",
) -> CaptureView:
    """Make the capture of a complete upload. The answer is that of POST /v1/captures; asked again, it is the same.

    An upload whose capture is refused stays, until it is deleted or expires.
    """
    rectangle = parse_box(box)
    await request.body()  # there is none: behind it the server tells when the client leaves
    store, tenant = store_of(request), caller_of(request).tenant
    found = await gateway.captures.resumable.find(tenant, upload)
    if not found.finished:
        with gateway.access.limits.upload(tenant, (await limits_of(request)).uploads_at_once):
            found = await _make_capture(request, found, store, rectangle, continues)
    tasks.add_task(gateway.captures.resumable.sweep, found, store)
    return await in_thread(lambda: read_receipt(store, CaptureView.of, found.capture))


async def _make_capture(request: Request, upload: Upload, store: Store, box: PhotoBox | None, continues: str) -> Upload:
    """Store an upload's capture, unless a gateway that died had stored it already. Raises Problem."""
    gateway, caller = gateway_of(request), caller_of(request)
    resumable, usage = gateway.captures.resumable, gateway.access.usage
    limits = await limits_of(request)
    allowance = (await usage.allowance(caller.tenant, limits)).without(upload.length)
    uploader = Uploader(caller.tenant, limits.processor_s_per_minute, allowance.check)
    async with resumable.finishing(upload) as held:
        if not await in_thread(lambda: is_stored(store, held.capture)):
            chunks = await resumable.run(lambda: resumable.database.chunks(held.id))
            body = resumable.body_of(held, chunks, store)
            await gateway.captures.uploads.accept(request, body, store, box, uploader, held.capture, continues)
        ended = await resumable.run(lambda: resumable.database.finish(held.id, time.time()))
    if ended and caller.key:
        size = await in_thread(lambda: read_receipt(store, lambda receipt: int(receipt["bytes"]), held.capture))
        await usage.add(caller.tenant, size - held.length)
    return held


async def _has_body(request: Request) -> bool:
    """Whether a request's body has any bytes. Raises ClientDisconnect."""
    async for block in request.stream():
        if block:
            return True
    return False


async def _discard(request: Request, upload: Upload) -> None:
    """Delete an upload and its bytes for good. Raises Problem UPLOAD_LOCKED."""
    gateway, caller = gateway_of(request), caller_of(request)
    await gateway.captures.resumable.remove(upload, store_of(request))
    if caller.key and not upload.finished:
        await gateway.access.usage.add(caller.tenant, -upload.received)


def _parse_part(request: Request, length: int, received: int = 0) -> protocol.Checksum | None:
    """Parse the headers of a request whose body is a part of an upload of `length` bytes, and return its checksum.

    Raises Problem UPLOAD_MEDIA_TYPE, UPLOAD_HEADER, UPLOAD_TOO_LONG.
    """
    protocol.require_media_type(request.headers)
    checksum = protocol.parse_checksum(request.headers)
    told = protocol.parse_bytes(request.headers, "Content-Length") if "content-length" in request.headers else 0
    if received + told > length:
        raise too_long(length)
    return checksum


async def _append(request: Request, upload: Upload, checksum: protocol.Checksum | None) -> Upload:
    """Append the request's body to an upload. checksum: of the body, if told. Raises Problem, ClientDisconnect."""
    gateway, caller = gateway_of(request), caller_of(request)
    usage = gateway.access.usage
    limits = await limits_of(request)

    async def before_chunk(size: int) -> None:
        (await usage.allowance(caller.tenant, await limits_of(request))).check(size)

    async def on_stored(size: int) -> None:
        if caller.key:
            await usage.add(caller.tenant, size)

    part = Part(batches(request), checksum, before_chunk, on_stored)
    with gateway.access.limits.upload(caller.tenant, limits.uploads_at_once):
        return await gateway.captures.resumable.append(upload, part, store_of(request))


async def _check_length(request: Request, length: int) -> None:
    """Raises Problem for an upload that is not allowed, or for which there is no space."""
    gateway = gateway_of(request)
    most = gateway.settings.max_upload_bytes
    if length > most:
        detail = say("upload_too_large_most_bytes", most=most)
        raise Problem(413, "UPLOAD_TOO_LARGE", detail, hints=(say("send_smaller_capture"),))
    allowance = await gateway.access.usage.allowance(caller_of(request).tenant, await limits_of(request))
    allowance.check(length)
    gateway.captures.uploads.check_free_space(length)
