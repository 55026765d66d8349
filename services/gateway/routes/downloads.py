"""/v1/assets/{key}/downloads and /download: an asset in the formats of other programs, made when they are asked for."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse, RedirectResponse
from pydantic import BaseModel

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.languages import for_reader
from capture2vr.gateway.routes.assets import Key, read_asset
from capture2vr.gateway.routes.files import headers_alone
from capture2vr.gateway.routes.read_rules import READS_ASSET, reading_of, reads_tenant
from capture2vr.gateway.routes.store_access import in_thread, object_url, store_of, store_problems
from capture2vr.gateway.routes.versions import read_asset_version
from capture2vr.gateway.schemas import problems
from capture2vr.order.download_formats import FORMATS, DownloadFormat, formats_of
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload, find_download
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.store import NO_CACHE, Store, list_all
from capture2vr.storage.tenant_store import DEFAULT_TENANT

router = APIRouter(prefix="/v1", tags=["assets"])

_AGAIN_S = 2
"""Seconds after which to ask again for a file that is being made."""

FormatQuery = Annotated[
    str, Query(alias="format", max_length=40, description=f"One of {', '.join(FORMATS)}.", examples=["obj"])
]
VersionQuery = Annotated[
    int | None,
    Query(
        ge=1,
        le=1_000_000_000,
        description="Number of an earlier version, for the asset's own tenant; without it the current one.",
    ),
]


class DownloadView(BaseModel):
    """A format in which an asset can be downloaded. `title` and `about` are for people, `file` is a name to save it
    under, `bytes` the size of the file where it has been made before, else null.
    """

    format: str
    title: str
    about: str
    file: str
    bytes: int | None
    url: str


class DownloadList(BaseModel):
    """The formats in which a version of an asset can be downloaded."""

    key: str
    version: int
    downloads: list[DownloadView]


class DownloadProgress(BaseModel):
    """A file that is being made: ask again after Retry-After seconds."""

    format: str
    file: str


@router.get(
    "/assets/{key}/downloads",
    response_model=DownloadList,
    dependencies=[READS_ASSET],
    responses=problems(404, 410, 422, 503),
)
async def list_downloads(key: Key, request: Request, response: Response, version: VersionQuery = None) -> DownloadList:
    """List the formats in which an asset can be downloaded for other programs."""
    entry = await _read_version(request, key, version)
    store = store_of(request)
    formats = formats_of(_bundle_files(entry))
    sizes = await in_thread(lambda: _sizes(store, entry, formats))
    response.headers.update(_headers(request, version))
    return DownloadList(
        key=key,
        version=entry.version,
        downloads=[
            DownloadView(
                format=each.name,
                title=for_reader(each.title),
                about=for_reader(each.about),
                file=each.file_name(key, version),
                bytes=sizes.get(each.name),
                url=_url(request, key, each, version),
            )
            for each in formats
        ],
    )


@router.head("/assets/{key}/download", include_in_schema=False, dependencies=[READS_ASSET])
@router.get(
    "/assets/{key}/download",
    status_code=307,
    dependencies=[READS_ASSET],
    responses={202: {"model": DownloadProgress}, **problems(404, 410, 422, 500, 503)},
)
async def get_download(
    key: Key, format_name: FormatQuery, request: Request, gateway: GatewayOf, version: VersionQuery = None
) -> Response:
    """Redirect to the asset's file in a format for other programs, which is made now if nobody has asked for it before.

    A large file takes longer than a request should: then the answer is 202 with Retry-After, and it is there when asked
    for again. The file is made once for each version, and never changes.
    """
    entry = await _read_version(request, key, version)
    order = DownloadOrder(key, str(entry.document["manifest"]["sha256"]), _format_of(entry, format_name))
    with store_problems():
        found = await gateway.downloads.get(reads_tenant(request), order)
    headers = _headers(request, version)
    if found is None:
        body = DownloadProgress(format=format_name, file=order.format.file_name(key, version)).model_dump()
        return JSONResponse(body, 202, headers | {"Retry-After": str(_AGAIN_S), "Cache-Control": "no-store"})
    if request.method == "HEAD":  # answered here: a URL that is signed for GET refuses it
        return await headers_alone(store_of(request), found.name, request)
    return RedirectResponse(object_url(request, found.name), 307, headers)


async def _read_version(request: Request, key: str, version: int | None) -> Entry:
    """Read the entry with a version; None: the current one. Raises Problem.

    Earlier versions are for the asset's own tenant alone, as GET /v1/assets/{key}/versions/{version} is: others are not
    told how many there were.
    """
    entry = await read_asset(request, key)
    if version is None or version == entry.version:
        return entry
    if reading_of(request).is_own:
        return await read_asset_version(request, key, version)
    detail = say("asset_has_no_version_you", key=key, version=version)
    raise Problem(404, "VERSION_UNKNOWN", detail, hints=(say("leave_version_away_current"),))


def _headers(request: Request, version: int | None) -> dict[str, str]:
    """Return the headers that tell who may cache and read the answer: nobody else where a version is named."""
    if version is not None:
        return {"Cache-Control": "private, no-store"}
    reading = reading_of(request)
    return {"Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}


def _format_of(entry: Entry, name: str) -> DownloadFormat:
    """Return the format of this name. Raises Problem FORMAT_UNKNOWN, and FORMAT_UNAVAILABLE for this asset."""
    formats = formats_of(_bundle_files(entry))
    found = next((each for each in formats if each.name == name), None)
    if found:
        return found
    names = ", ".join(each.name for each in formats) or "none"
    hints = (say("ask_one", names=names),)
    if name not in FORMATS:
        detail = say("no_format_name_asset", key=entry.key, names=names)
        raise Problem(422, "FORMAT_UNKNOWN", detail, hints=hints)
    missing = next(file for file in FORMATS[name].needs if file not in _bundle_files(entry))
    detail = say("asset_cannot_be_downloaded", key=entry.key, name=name, missing=missing, names=names)
    raise Problem(404, "FORMAT_UNAVAILABLE", detail, hints=hints)


def _bundle_files(entry: Entry) -> set[str]:
    return {str(file.get("file", "")) for file in entry.document["files"]}


def _sizes(store: Store, entry: Entry, formats: list[DownloadFormat]) -> dict[str, int]:
    """Return the sizes of the files that have been made already, by format."""
    made = {head.name for head in list_all(store, f"assets/{entry.key}/downloads/")}
    orders = (DownloadOrder(entry.key, str(entry.document["manifest"]["sha256"]), each) for each in formats)
    found: dict[str, StoredDownload | None] = {
        order.format.name: find_download(store, order) for order in orders if order.record_name in made
    }
    return {name: each.size for name, each in found.items() if each}


def _url(request: Request, key: str, wanted: DownloadFormat, version: int | None) -> str:
    tenant = reads_tenant(request)
    query = {"format": wanted.name} | ({"version": str(version)} if version else {})
    query |= {} if tenant == DEFAULT_TENANT else {"tenant": tenant}
    return f"/v1/assets/{key}/download?{urlencode(query)}"
