"""/v1/captures and /v1/outlines: upload of captures, and a look at one photo.

The body is streamed by our own code, so its OpenAPI schema is written here too.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field

from services.gateway.photo_boxes import BoxQuery, parse_box
from services.gateway.schemas import problems
from services.gateway.uploads.accept import Uploads

router = APIRouter(prefix="/v1", tags=["captures"])


class FileVerdict(BaseModel):
    """Result for one uploaded file. `verdict` is "ok", or why the file was left out; `bytes` and `sha256` are those of
    the stored file; `stripped` names the metadata that were removed.
    """

    file: str
    bytes: int
    sha256: str
    verdict: str
    stripped: list[str]


class CaptureView(BaseModel):
    """A stored capture. `inspected`: whether a worker has read it; if not, kind, format, frames and points are not
    known yet. `collection` is the one that the upload named; jobs that name none use it.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "capture": "cap_019b2f7c8a3e5b2d4c681f0a9b8c",
                "name": "Dress",
                "collection": "",
                "created": "2026-01-01T00:00:00Z",
                "bytes": 123456,
                "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
                "inspected": True,
                "kind": "rgbd",
                "format": "tum",
                "frames": 5,
                "points": 0,
                "warnings": [],
                "files": [
                    {"file": "a.jpg", "bytes": 123, "sha256": "…", "verdict": "ok", "stripped": ["GPSInfo"]},
                ],
            }
        }
    )

    capture: str
    name: str
    collection: str
    created: str
    bytes: int
    sha256: str
    inspected: bool
    kind: str
    format: str
    frames: int
    points: int
    warnings: list[str]
    files: list[FileVerdict]


class OutlineView(BaseModel):
    """The thing in a single photo: closed lines around it, of corners [x, y] as shares of the upright photo's width and
    height. Captures of another kind have none. `warnings` says where the choice is doubtful; `inspected`: whether a
    worker could look.
    """

    inspected: bool
    kind: str
    outline: list[list[Annotated[list[float], Field(min_length=2, max_length=2)]]]
    warnings: list[str]


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
    responses=problems(400, 408, 413, 415, 422, 503, 507),
    openapi_extra=_BODY,
)
async def upload_capture(request: Request, box: BoxQuery = "") -> CaptureView:
    """Upload a capture: photos, a video, a point cloud, or the export of a scanner app, as files or as one zip.

    Every file is checked, and locations, serial numbers and names of persons are removed from it. The answer is sent
    after the capture has been stored. `box` is only for the inspection of a single photo; a job names it again.
    """
    return CaptureView.model_validate(await _uploads(request).accept(request, parse_box(box)))


@router.post(
    "/outlines",
    response_model=OutlineView,
    responses=problems(400, 408, 413, 415, 422, 503, 507),
    openapi_extra=_BODY,
)
async def outline_photo(request: Request, box: BoxQuery = "") -> OutlineView:
    """Outline the thing that would be reconstructed from a single photo, or from a rectangle of it.

    Takes the same body as an upload, and stores nothing. Send the photo itself: a smaller copy may give another
    outline.
    """
    return OutlineView.model_validate(await _uploads(request).outline(request, parse_box(box)))


def _uploads(request: Request) -> Uploads:
    """Return the app's `Uploads`, created at the first upload because its limiters belong to the running event loop."""
    state = request.app.state
    if not hasattr(state, "uploads"):
        state.uploads = Uploads(state.settings, state.store, state.workers)
    uploads: Uploads = state.uploads
    return uploads
