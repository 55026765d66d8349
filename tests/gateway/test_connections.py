"""Connections that cost without asking for anything: too many, too slow, with headers without an end, never read."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.gateway import connections, middleware
from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.local import LocalStore
from tests.support.in_process_gateway import listening
from tests.support.patience import PATIENCE_S

GET = b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\n"


@asynccontextmanager
async def port(folder: Path, **settings: Any) -> AsyncIterator[int]:
    """A gateway's port."""
    told = GatewaySettings(data_dir=folder / "gw", workers=(), **settings)
    async with listening(create_app(told, LocalStore(folder / "objects")), told) as url:
        yield int(url.rpartition(":")[2])


@asynccontextmanager
async def connected(at: int) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", at, limit=1 << 20)
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


async def answer(reader: asyncio.StreamReader) -> tuple[int, dict[str, Any]]:
    """Status and problem document of an answer behind which the connection is closed."""
    async with asyncio.timeout(PATIENCE_S):
        whole = await reader.read()
    head, _, body = whole.partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


async def until_counted(at: int, reason: str) -> None:
    """Wait until the gateway has closed a connection for this reason."""
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{at}") as client, asyncio.timeout(PATIENCE_S):
        while f'connections_refused_total{{reason="{reason}"}}' not in (await client.get("/metrics")).text:
            await asyncio.sleep(0.05)


async def test_half_a_request_does_not_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "_HEAD_S", 0.2)
    async with port(tmp_path) as at, connected(at) as (reader, writer):
        writer.write(GET)
        status, problem = await answer(reader)
        assert (status, problem["code"]) == (408, "REQUEST_SILENT")


async def test_bytes_now_and_then_do_not_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is for the whole head: "slowloris"."""
    monkeypatch.setattr(connections, "_HEAD_S", 0.3)
    async with port(tmp_path) as at, connected(at) as (reader, writer):
        reading = asyncio.create_task(answer(reader))
        writer.write(GET)
        while not reading.done():
            writer.write(b"X: y\r\n")
            await asyncio.sleep(0.02)
        with suppress(ConnectionError):  # what was still under way has cut off the answer
            assert (await reading)[0] == 408
        await until_counted(at, "REQUEST_SILENT")


async def test_a_connection_without_a_byte_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "_HEAD_S", 0.1)
    async with port(tmp_path) as at, connected(at) as (reader, _), asyncio.timeout(PATIENCE_S):
        assert await reader.read() == b""


async def test_headers_without_an_end_are_refused(tmp_path: Path) -> None:
    async with port(tmp_path) as at, connected(at) as (reader, writer):
        reading = asyncio.create_task(answer(reader))
        writer.write(GET + b"X: ")
        sent = 0
        try:
            while not reading.done() and sent < 20 << 20:
                writer.write(b"y" * 10_000)
                await writer.drain()
                await asyncio.sleep(0)
                sent += 10_000
        except ConnectionError:
            pass
        assert sent < 20 << 20
        with suppress(ConnectionError):  # what was still under way has cut off the answer
            assert (await reading)[1]["code"] == "HEADERS_TOO_LARGE"


async def test_large_headers_that_arrive_at_once_are_refused(tmp_path: Path) -> None:
    async with port(tmp_path) as at, connected(at) as (reader, writer):
        writer.write(GET + b"Connection: close\r\nX: " + b"y" * 70_000 + b"\r\n\r\n")
        status, problem = await answer(reader)
        assert (status, problem["code"]) == (431, "HEADERS_TOO_LARGE")


async def test_an_address_has_so_many_connections_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "is_own", lambda address: False)
    async with (
        port(tmp_path, limit_address_connections=2) as at,
        connected(at),
        connected(at),
        connected(at) as (reader, _),
    ):
        status, problem = await answer(reader)
        assert (status, problem["code"], problem["retryable"]) == (429, "CONNECTIONS_LIMITED", True)


async def test_a_closed_connection_makes_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "is_own", lambda address: False)
    async with port(tmp_path, limit_address_connections=1) as at, asyncio.timeout(PATIENCE_S):
        for _ in range(5):
            said = b"HTTP/1.1 429"
            while said.startswith(b"HTTP/1.1 429"):  # the one before may not have been noticed as closed yet
                async with connected(at) as (reader, writer):
                    writer.write(GET + b"Connection: close\r\n\r\n")
                    said = await reader.read()
            assert said.startswith(b"HTTP/1.1 200")


async def test_several_requests_share_a_connection(tmp_path: Path) -> None:
    async with port(tmp_path) as at, connected(at) as (reader, writer), asyncio.timeout(PATIENCE_S):
        for _ in range(3):
            writer.write(GET + b"\r\n")
            head = await reader.readuntil(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 200")
            assert await reader.readexactly(3) == b"ok\n"


async def test_a_body_that_does_not_come_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(middleware, "_SILENCE_S", 0.2)
    async with port(tmp_path) as at, connected(at) as (reader, writer):
        head = b"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        # The pace allows two seconds for so much: on a crowded machine one byte was too slow before it was silent.
        writer.write(head + b"Content-Length: 2000\r\nConnection: close\r\n\r\n" + b" " * 1000)
        status, problem = await answer(reader)
        assert (status, problem["code"]) == (408, "REQUEST_SILENT")


async def test_a_body_that_trickles_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A byte at a time, as often as silence allows; chunked, so that no length tells how many come."""
    monkeypatch.setattr(middleware, "_SILENCE_S", 0.4)
    async with port(tmp_path) as at, connected(at) as (reader, writer), asyncio.timeout(PATIENCE_S):
        head = b"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        writer.write(head + b"Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n")

        async def trickle() -> None:
            while True:
                writer.write(b"1\r\n{\r\n")
                await asyncio.sleep(0.1)

        trickling = asyncio.create_task(trickle())
        status, problem = await answer(reader)
        trickling.cancel()
        assert (status, problem["code"]) == (408, "REQUEST_SLOW")


async def test_what_does_not_say_that_it_may_be_kept_is_kept_by_nobody(tmp_path: Path) -> None:
    async with port(tmp_path) as at, connected(at) as (reader, writer), asyncio.timeout(PATIENCE_S):
        writer.write(b"GET /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert b"cache-control: private, no-store" in (await reader.readuntil(b"\r\n\r\n")).lower()


@pytest.mark.slow
async def test_an_answer_that_nobody_reads_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "_STUCK_S", 0.3)
    store = LocalStore(tmp_path / "objects")
    store.put("assets/dress/large.bin", bytes(64 << 20), content_type="application/octet-stream")
    async with port(tmp_path) as at, connected(at) as (reader, writer), asyncio.timeout(PATIENCE_S):
        writer.write(b"GET /v1/files/assets/dress/large.bin HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200")
        writer.transport.pause_reading()  # type: ignore[attr-defined]
        await until_counted(at, "ANSWER_NOT_READ")
        writer.transport.resume_reading()  # type: ignore[attr-defined]
        read = 0
        try:
            while block := await reader.read(1 << 20):
                read += len(block)
        except ConnectionError:
            pass
        assert read < 64 << 20
