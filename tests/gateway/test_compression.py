"""Compression of answers: text alone, and never what is a stream of events or fetched in parts."""

from __future__ import annotations

import gzip
from collections.abc import AsyncIterator

import httpx
import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from capture2vr.gateway.compression import Compression

TEXT = "a page in the reader's language; " * 100


async def answer(request: Request) -> Response:
    kind = request.query_params.get("kind", "text/html")
    ranged = {"ETag": '"abc"', "Accept-Ranges": "bytes"} if "ranged" in request.query_params else {"ETag": '"3"'}
    if request.headers.get("range"):
        return Response(TEXT[:1000], 206, {**ranged, "Content-Range": f"bytes 0-999/{len(TEXT)}"}, media_type=kind)
    return Response(TEXT, headers=ranged, media_type=kind)


async def events(request: Request) -> Response:
    async def lines() -> AsyncIterator[str]:
        for _ in range(100):
            yield f"data: {TEXT}\n\n"

    return StreamingResponse(lines(), media_type="text/event-stream")


async def made(request: Request) -> Response:
    return JSONResponse({"key": TEXT})


@pytest.fixture
def client() -> httpx.AsyncClient:
    app = Starlette(routes=[Route("/", answer), Route("/events", events), Route("/keys", made, methods=["POST"])])
    transport = httpx.ASGITransport(Compression(app))
    return httpx.AsyncClient(transport=transport, base_url="http://test", headers={"Accept-Encoding": "gzip"})


@pytest.mark.parametrize("kind", ["text/html", "application/json", "application/problem+json", "text/javascript"])
async def test_text_is_compressed(client: httpx.AsyncClient, kind: str) -> None:
    async with client.stream("GET", "/", params={"kind": kind}) as got:
        sent = b"".join([chunk async for chunk in got.aiter_raw()])
    assert (got.headers["content-encoding"], got.headers["vary"]) == ("gzip", "Accept-Encoding")
    assert gzip.decompress(sent).decode() == TEXT
    assert len(sent) == int(got.headers["content-length"]) < len(TEXT) / 10
    assert got.headers["etag"] == '"3"', "which a change of a scene names in If-Match"


@pytest.mark.parametrize("kind", ["model/gltf-binary", "application/octet-stream", "image/jpeg", "application/zip"])
async def test_what_has_its_own_compression_is_not(client: httpx.AsyncClient, kind: str) -> None:
    got = await client.get("/", params={"kind": kind})
    assert "content-encoding" not in got.headers
    assert got.text == TEXT


async def test_a_client_that_cannot_gets_it_plain(client: httpx.AsyncClient) -> None:
    got = await client.get("/", headers={"Accept-Encoding": "identity"})
    assert ("content-encoding" in got.headers, got.headers["vary"]) == (False, "Accept-Encoding")


async def test_events_and_answers_to_changes_are_not_compressed(client: httpx.AsyncClient) -> None:
    assert "content-encoding" not in (await client.get("/events")).headers
    assert "content-encoding" not in (await client.post("/keys")).headers


async def test_parts_of_two_encodings_are_never_joined(client: httpx.AsyncClient) -> None:
    whole = await client.get("/", params={"ranged": "1"})
    assert ("accept-ranges" in whole.headers, whole.headers["etag"]) == (False, 'W/"abc"')
    part = await client.get("/", params={"ranged": "1"}, headers={"Range": "bytes=0-999"})
    assert (part.status_code, "content-encoding" in part.headers, part.headers["etag"]) == (206, False, '"abc"')
