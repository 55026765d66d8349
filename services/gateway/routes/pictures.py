"""/v1/captures/{capture}/pictures and /films: the photos of a stored capture, small and upright, and its films, for
drawing lassos in them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.jobs.capture_objects import object_chunks, read_receipt
from capture2vr.gateway.pictures.capture_films import films_in, find_film
from capture2vr.gateway.pictures.capture_pictures import pictures_in, read_picture, with_archive
from capture2vr.gateway.routes.access_rules import needs
from capture2vr.gateway.routes.captures import CaptureId
from capture2vr.gateway.routes.http_ranges import take_range
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import problems

router = APIRouter(prefix="/v1", tags=["captures"])

_PRIVATE = {"Cache-Control": "private, no-store"}
_CHUNK_BYTES = 256 << 10


class CapturePicture(BaseModel):
    """A photo of a stored capture: its file in it, and the URL of a small upright JPEG of it."""

    name: str
    url: str


class CaptureFilm(BaseModel):
    """A video of a stored capture: its file in it, and the URL of that file. A key frame of it is a lasso's `photo` as
    `NAME at SECONDS s`, with two decimals."""

    name: str
    url: str


class CapturePictures(BaseModel):
    """The photos and videos of a stored capture."""

    pictures: list[CapturePicture]
    films: list[CaptureFilm]


@router.get(
    "/captures/{capture}/pictures",
    response_model=CapturePictures,
    dependencies=[needs(Scope.MANAGE)],  # as the archive
    responses=problems(404, 422, 503),
)
async def get_pictures(capture: CaptureId, request: Request) -> CapturePictures:
    """List a capture's photos, as `photo` of a recipe's lassos names them, and the videos whose key frames it names."""
    store = store_of(request)

    def names() -> tuple[list[str], list[str]]:
        kind = read_receipt(store, _kind_of, capture)
        return with_archive(
            store,
            capture,
            lambda archive: (pictures_in(archive, kind), [film.filename for film in films_in(archive, kind)]),
        )

    pictures, films = await in_thread(names)
    url = f"/v1/captures/{capture}"
    return CapturePictures(
        pictures=[CapturePicture(name=name, url=f"{url}/pictures/{number}") for number, name in enumerate(pictures)],
        films=[CaptureFilm(name=name, url=f"{url}/films/{number}") for number, name in enumerate(films)],
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
    gateway: GatewayOf,
) -> Response:
    """Get a photo of a capture as a small JPEG, turned upright: what the corners of a lasso are shares of."""
    store = store_of(request)

    def read() -> tuple[str, bytes]:
        return read_picture(store, capture, read_receipt(store, _kind_of, capture), picture)

    jpeg = await gateway.captures.pictures.shrink(lambda: in_thread(read))
    return Response(jpeg, media_type="image/jpeg", headers=_PRIVATE)


@router.get(
    "/captures/{capture}/films/{film}",
    response_class=Response,
    dependencies=[needs(Scope.MANAGE)],
    responses={200: {"content": {"video/mp4": {}, "video/webm": {}}}, **problems(404, 416, 422, 503)},
)
async def get_film(
    capture: CaptureId,
    film: Annotated[int, Path(ge=0, le=100_000, description="Place in the list of the capture's videos, from 0.")],
    request: Request,
) -> Response:
    """Get a stored video of a capture, or a part of it with a Range header: a browser seeks in it by parts."""
    store = store_of(request)
    found = await in_thread(lambda: find_film(store, capture, read_receipt(store, _kind_of, capture), film))
    etag = f"{capture}-{film}"  # a stored capture never changes
    headers = {"Accept-Ranges": "bytes", "ETag": f'"{etag}"', **_PRIVATE}
    start, end, status = take_range(request.headers, etag, found.size, headers, {})
    body = object_chunks(store, found.archive, found.start + start, found.start + end, _CHUNK_BYTES)
    return StreamingResponse(body, status, headers, found.media_type)


def _kind_of(receipt: dict[str, Any]) -> str:
    return str(receipt.get("kind", ""))
