"""/v1/captures and /v1/outlines: upload, list, download and delete captures, and a look at one photo.

An upload's body is streamed by our own code, so its OpenAPI schema is written here too.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.usage import Allowance
from capture2vr.gateway.coded_views import AllCoded, Coded, QuestionView
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.jobs.capture_objects import (
    capture_bytes,
    capture_name,
    delete_capture,
    list_captures,
    new_capture,
    object_chunks,
    read_receipt,
    unknown_capture,
)
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.languages import for_reader
from capture2vr.gateway.photo_boxes import BoxQuery, parse_box
from capture2vr.gateway.routes.access_rules import caller_of, limits_of, needs
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.uploads.accept import Uploader
from capture2vr.gateway.uploads.receive import body_of
from capture2vr.order.questions import questions_of
from capture2vr.sentences.documents import with_sentences
from capture2vr.sentences.sentence import say

router = APIRouter(prefix="/v1", tags=["captures"])

_CHUNK_BYTES = 256 << 10
_LISTS = needs(Scope.CAPTURE, Scope.READ, Scope.MANAGE)
_PRIVATE = {"Cache-Control": "private, no-store"}

Continues = Annotated[
    str,
    Query(
        max_length=100,
        pattern=r"^[A-Za-z0-9_-]*$",
        description="Id of a stored capture of photos: the new one has its photos too, and it stays as it is.",
    ),
]
"""The query parameter `continues`."""
CaptureId = Annotated[str, Path(max_length=100, pattern=r"^[A-Za-z0-9_-]+$", description="Id from POST /v1/captures.")]


class FileVerdict(BaseModel):
    """Result for one uploaded file. `verdict` is "ok", or why the file was left out; `bytes` and `sha256` are those of
    the stored file; `stripped` names the metadata that were removed.
    """

    file: str
    bytes: int
    sha256: str
    verdict: str
    stripped: list[str]
    verdict_i18n: Coded = None


class CaptureView(BaseModel):
    """A stored capture. `inspected`: whether a worker has read it, as none had of a few that former versions stored:
    their kind, format, frames and points are not known. `collection` is the one that the upload named; jobs that name
    none use it. `continues` is the capture whose photos it has too, "" for none.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "capture": "cap_019b2f7c8a3e5b2d4c681f0a9b8c",
                "name": "Dress",
                "collection": "",
                "continues": "",
                "created": "2026-01-01T00:00:00Z",
                "bytes": 123456,
                "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
                "inspected": True,
                "kind": "rgbd",
                "format": "tum",
                "frames": 5,
                "points": 0,
                "warnings": [],
                "questions": [],
                "files": [
                    {"file": "a.jpg", "bytes": 123, "sha256": "…", "verdict": "ok", "stripped": ["GPSInfo"]},
                ],
            }
        }
    )

    capture: str
    name: str
    collection: str
    continues: str = ""
    created: str
    bytes: int
    sha256: str
    inspected: bool
    kind: str
    format: str
    frames: int
    points: int
    warnings: list[str]
    warnings_i18n: AllCoded = []
    questions: list[QuestionView]
    files: list[FileVerdict]

    @classmethod
    def of(cls, receipt: dict[str, Any]) -> CaptureView:
        """Convert a receipt, as it was made or as it is stored."""
        known = with_sentences(receipt)
        warnings = known.get("warnings")  # a damaged receipt may have anything; the validation says so
        questions = questions_of(warnings if isinstance(warnings, list) else ())
        return cls.model_validate(for_reader({**known, "questions": questions}))


class CaptureSummary(BaseModel):
    """One capture in a list; `self` is the URL of its receipt, `archive` the one of its files as a zip."""

    capture: str
    name: str
    collection: str
    created: str
    bytes: int
    inspected: bool
    kind: str
    format: str
    frames: int
    points: int
    self: str
    archive: str


class CapturePage(BaseModel):
    """A page of captures, the oldest first. `next` is the value of `after` for the next page; null on the last page.
    `damaged` names the captures that were skipped because their receipts cannot be read.
    """

    captures: list[CaptureSummary]
    next: str | None
    damaged: list[str]


class CaptureDeletionView(BaseModel):
    """A capture that has been deleted for good, and the bytes that this freed."""

    capture: str
    bytes: int


class OutlineView(BaseModel):
    """The object in a photo: closed lines around it, of corners [x, y] as shares of the upright photo's width and
    height. Captures of another kind have none. `warnings` says where the choice is doubtful.
    """

    kind: str
    outline: list[list[Annotated[list[float], Field(min_length=2, max_length=2)]]]
    warnings: list[str]
    warnings_i18n: AllCoded = []


_FORM = {
    "type": "object",
    "properties": {
        "files": {"type": "array", "items": {"type": "string", "format": "binary"}},
        "name": {"type": "string", "maxLength": 200},
        "collection": {"type": "string", "maxLength": 100},
    },
    "required": ["files"],
}
_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {"schema": _FORM},
            "application/zip": {"schema": {"type": "string", "format": "binary"}},
        },
    }
}


@router.post(
    "/captures",
    status_code=201,
    response_model=CaptureView,
    dependencies=[needs(Scope.CAPTURE)],
    responses=problems(400, 404, 408, 413, 415, 422, 429, 503, 507),
    openapi_extra=_BODY,
)
async def upload_capture(
    request: Request, gateway: GatewayOf, box: BoxQuery = "", continues: Continues = ""
) -> CaptureView:
    """Upload a capture: photos, a video, a point cloud, or the export of a scanner app, as files or as one zip.

    Every file is checked. Locations, serial numbers and names of persons are removed from photos, videos and E57; files
    that only tell such facts of others (tracks of a way, subtitles, XMP) are left out; other files are stored as they
    are. The answer is sent after the capture has been stored. `box` is only for the inspection of a single photo; a job
    names it again. With `continues` the photos are added to those of an earlier capture, as a new one: a job again with
    it makes the next version of the same asset.
    """
    caller, limits, usage = caller_of(request), await limits_of(request), gateway.access.usage
    tenant = caller.tenant
    with gateway.access.limits.upload(tenant, limits.uploads_at_once):
        allowance = await usage.allowance(tenant, limits)
        uploads, store = gateway.captures.uploads, store_of(request)
        uploader = Uploader(tenant, limits.processor_s_per_minute, allowance.check)
        body, rectangle = body_of(request), parse_box(box)
        receipt = await uploads.accept(request, body, store, rectangle, uploader, new_capture(), continues)
        if caller.key:
            await usage.add(tenant, receipt["bytes"])
    return CaptureView.of(receipt)


@router.post(
    "/outlines",
    response_model=OutlineView,
    dependencies=[needs(Scope.CAPTURE)],
    responses=problems(400, 408, 413, 415, 422, 429, 503, 507),
    openapi_extra=_BODY,
)
async def outline_photo(request: Request, gateway: GatewayOf, box: BoxQuery = "") -> OutlineView:
    """Outline the object that would be reconstructed from a single photo, or from a rectangle of it.

    Takes the same body as an upload, and stores nothing. Send the photo itself: a smaller copy may give another
    outline.
    """
    tenant, limits = caller_of(request).tenant, await limits_of(request)
    allowance = Allowance(limits.capture_bytes)  # what is stored does not matter: this is not
    with gateway.access.limits.upload(tenant, limits.uploads_at_once):
        uploader = Uploader(tenant, limits.processor_s_per_minute, allowance.check)
        found = await gateway.captures.uploads.outline(request, parse_box(box), uploader)
    return OutlineView.model_validate(for_reader(found))


@router.get("/captures", response_model=CapturePage, dependencies=[_LISTS], responses=problems(422, 503))
async def get_captures(
    request: Request,
    gateway: GatewayOf,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    after: Annotated[
        str,
        Query(
            max_length=100,
            pattern=r"^[A-Za-z0-9_-]*$",
            description="`next` of the previous page; empty: first page.",
        ),
    ] = "",
) -> CapturePage:
    """List the stored captures, the oldest first."""
    store = store_of(request)
    found, damaged = await in_thread(lambda: list_captures(store, _summary, after=after, limit=limit))
    gateway.metrics.observe_damage("receipt", len(damaged))
    last = found[-1].capture if len(found) == limit else None
    return CapturePage(captures=found, next=last, damaged=damaged)


@router.get("/captures/{capture}", response_model=CaptureView, dependencies=[_LISTS], responses=problems(404, 422, 503))
async def get_capture(capture: CaptureId, request: Request) -> CaptureView:
    """Get a capture's receipt: the answer to its upload."""
    store = store_of(request)
    return await in_thread(lambda: read_receipt(store, CaptureView.of, capture))


@router.get(
    "/captures/{capture}/archive",
    response_class=Response,
    dependencies=[needs(Scope.MANAGE)],  # photos of people's rooms: a headset's key has no need of them
    responses={200: {"content": {"application/zip": {}}}, **problems(404, 422, 503)},
)
async def download_capture(capture: CaptureId, request: Request) -> StreamingResponse:
    """Download a capture's files as they are stored, in one zip."""
    store = store_of(request)
    try:
        size = await capture_bytes(store, capture)
    except (FileNotFoundError, ValueError):
        raise unknown_capture(capture) from None
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", say("store_cannot_be_reached"), retryable=True) from error
    headers = {"Content-Length": str(size), "Content-Disposition": f'attachment; filename="{capture}.zip"', **_PRIVATE}
    chunks = object_chunks(store, capture_name(capture), 0, size, _CHUNK_BYTES)
    return StreamingResponse(chunks, headers=headers, media_type="application/zip")


@router.delete(
    "/captures/{capture}",
    response_model=CaptureDeletionView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 409, 422, 503),
)
async def remove_capture(capture: CaptureId, request: Request, gateway: GatewayOf) -> CaptureDeletionView:
    """Delete a capture for good. Assets that were made from it stay; no job can use it again."""
    if using := await gateway.job_store.read(JobStore.unfinished, caller_of(request).tenant, capture=capture):
        detail = say("jobs_have_not_ended_need", count=len(using), names=", ".join(using[:3]))
        raise Problem(409, "CAPTURE_IN_USE", detail, hints=(say("cancel_these_jobs_wait_their"),))
    store = store_of(request)
    freed = await in_thread(lambda: delete_capture(store, capture))
    if (caller := caller_of(request)).key:
        await gateway.access.usage.add(caller.tenant, -freed)
    return CaptureDeletionView(capture=capture, bytes=freed)


def _summary(receipt: dict[str, Any]) -> CaptureSummary:
    url = f"/v1/captures/{receipt['capture']}"
    # An older receipt may lack what was added since.
    known = {"collection": "", "inspected": False, "kind": "", "format": "", "frames": 0, "points": 0, **receipt}
    return CaptureSummary.model_validate({**known, "self": url, "archive": f"{url}/archive"})
