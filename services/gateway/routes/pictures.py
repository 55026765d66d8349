"""/v1/captures/{capture}/pictures: the photos of a stored capture, small and upright, for drawing lassos in them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel

from services.gateway.access.caller import Scope
from services.gateway.jobs.capture_objects import read_receipt
from services.gateway.pictures.capture_pictures import list_pictures, read_picture
from services.gateway.routes.access_rules import needs
from services.gateway.routes.captures import CaptureId
from services.gateway.routes.store_access import in_thread, store_of
from services.gateway.schemas import problems

router = APIRouter(prefix="/v1", tags=["captures"])

_PRIVATE = {"Cache-Control": "private, no-store"}


class CapturePicture(BaseModel):
    """A photo of a stored capture: its file in it, and the URL of a small upright JPEG of it."""

    name: str
    url: str


class CapturePictures(BaseModel):
    """The photos of a stored capture."""

    pictures: list[CapturePicture]


@router.get(
    "/captures/{capture}/pictures",
    response_model=CapturePictures,
    dependencies=[needs(Scope.MANAGE)],  # as the archive
    responses=problems(404, 422, 503),
)
async def get_pictures(capture: CaptureId, request: Request) -> CapturePictures:
    """List a capture's photos, as `photo` of a recipe's lassos names them. Key frames of films are not among them."""
    store = store_of(request)

    def names() -> list[str]:
        return list_pictures(store, capture, read_receipt(store, _kind_of, capture))

    found = await in_thread(names)
    return CapturePictures(
        pictures=[
            CapturePicture(name=name, url=f"/v1/captures/{capture}/pictures/{number}")
            for number, name in enumerate(found)
        ]
    )


@router.get(
    "/captures/{capture}/pictures/{picture}",
    response_class=Response,
    dependencies=[needs(Scope.MANAGE)],
    responses={200: {"content": {"image/jpeg": {}}}, **problems(404, 422, 503, 507)},
)
async def get_picture(
    capture: CaptureId,
    picture: Annotated[int, Path(ge=0, le=100_000, description="Place in the list of the capture's pictures, from 0.")],
    request: Request,
) -> Response:
    """Get a photo of a capture as a small JPEG, turned upright: what the corners of a lasso are shares of."""
    store = store_of(request)

    def read() -> tuple[str, bytes]:
        return read_picture(store, capture, read_receipt(store, _kind_of, capture), picture)

    jpeg = await request.app.state.picture_processes.shrink(lambda: in_thread(read))
    return Response(jpeg, media_type="image/jpeg", headers=_PRIVATE)


def _kind_of(receipt: dict[str, Any]) -> str:
    return str(receipt.get("kind", ""))
