"""A client of tus 1.0.0 that does just what a test says, also what no client should."""

from __future__ import annotations

import asyncio
import base64
import hashlib
from collections.abc import Mapping
from urllib.parse import urlsplit

import httpx

TUS = {"Tus-Resumable": "1.0.0"}
PART = "application/offset+octet-stream"
CLOUD = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"


def cloud(size: int, seed: int = 0) -> bytes:
    """Bytes that pass for a point cloud and are stored as they are."""
    block = hashlib.shake_256(seed.to_bytes(4, "big")).digest(max(0, size - len(CLOUD)))
    return (CLOUD + block)[:size]


def metadata(told: Mapping[str, str]) -> str:
    """The header Upload-Metadata."""
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}".strip() for name, value in told.items())


def checksum(algorithm: str, data: bytes) -> str:
    """The header Upload-Checksum."""
    return f"{algorithm} {base64.b64encode(hashlib.new(algorithm, data).digest()).decode()}"


async def create(client: httpx.AsyncClient, length: int, *, body: bytes | None = None, **told: str) -> httpx.Response:
    """Create an upload, with its first bytes if there are some."""
    headers = {**TUS, "Upload-Length": str(length)}
    if told:
        headers["Upload-Metadata"] = metadata(told)
    if body is not None:
        headers["Content-Type"] = PART
    return await client.post("/v1/uploads", headers=headers, content=body)


async def created(client: httpx.AsyncClient, length: int, **told: str) -> str:
    """Create an upload; its path."""
    answer = await create(client, length, **told)
    assert answer.status_code == 201, answer.text
    return answer.headers["Location"]


async def patch(
    client: httpx.AsyncClient, upload: str, offset: int, data: bytes, headers: Mapping[str, str] | None = None
) -> httpx.Response:
    """Send bytes from an offset on."""
    sent = {**TUS, "Content-Type": PART, "Upload-Offset": str(offset), **(headers or {})}
    return await client.patch(upload, headers=sent, content=data)


async def offset_of(client: httpx.AsyncClient, upload: str) -> int:
    """How far the upload is."""
    answer = await client.head(upload, headers=TUS)
    assert answer.status_code == 200, answer.status_code
    return int(answer.headers["Upload-Offset"])


async def finish(client: httpx.AsyncClient, upload: str, **params: str) -> httpx.Response:
    """Make the capture."""
    return await client.post(f"{upload}/capture", params=params)


async def cut(
    client: httpx.AsyncClient,
    upload: str,
    offset: int,
    data: bytes,
    sent: int,
    headers: Mapping[str, str] | None = None,
) -> None:
    """Begin to send bytes, and break the connection after so many of them."""
    url = urlsplit(str(client.base_url))
    told = {**TUS, "Content-Type": PART, "Upload-Offset": str(offset), "Content-Length": str(len(data))}
    told |= {"Host": url.netloc, **{name: value for name, value in client.headers.items() if name == "authorization"}}
    head = "".join(f"{name}: {value}\r\n" for name, value in {**told, **(headers or {})}.items())
    _, writer = await asyncio.open_connection(url.hostname, url.port)
    writer.write(f"PATCH {upload} HTTP/1.1\r\n{head}\r\n".encode() + data[:sent])
    await writer.drain()
    writer.close()
    await writer.wait_closed()
