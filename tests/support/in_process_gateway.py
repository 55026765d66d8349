"""A gateway and its workers in this process: the real app, the real edge server, real publishing, and quick work."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import uvicorn
from fastapi import FastAPI

from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.server import EdgeServer
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.gateway.app import create_app
from capture2vr.gateway.server import server_config
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store
from tests.support.patience import PATIENCE_S
from tests.support.workers.inspecting_worker import inspecting_worker
from tests.support.workers.scripted_work import Making

TERMINAL = {"SUCCEEDED", "FAILED", "CANCELLED"}
SHORT = {"lease_s": 3.0, "silence_s": 15.0, "attach_for_s": 2.0, "retry_s": 0.05, "presets": ("draft", "fine")}


@asynccontextmanager
async def worker(work: Making, scratch: Path, *, port: int = 0, **settings: Any) -> AsyncIterator[int]:
    """A listening worker; its port."""
    hurry = asyncio.Event()
    hurry.set()
    place = Scratch(scratch)
    with place.claim():
        server = EdgeServer(EdgeSettings(port=port, scratch=scratch, **settings), work, place)
        bound = await server.start()
        try:
            yield bound
        finally:
            await server.drain(hurry)


@asynccontextmanager
async def gateway(data_dir: Path, store: Store, *ports: int, **settings: Any) -> AsyncIterator[httpx.AsyncClient]:
    """A gateway that listens on a real socket; a client of it. Leaves runs alone when it goes, as a restart does."""
    workers = tuple(f"127.0.0.1:{port}" for port in ports) or (inspecting_worker(),)
    told = GatewaySettings(data_dir=data_dir, port=0, **{**SHORT, "workers": workers, **settings})
    app = create_app(told, store)
    async with listening(app, told) as url, httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as client:
        yield client


@asynccontextmanager
async def answering(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """A started app without a socket; a client of it."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    client = httpx.AsyncClient(transport=transport, base_url="http://gateway")
    async with app.router.lifespan_context(app), client:
        yield client


@asynccontextmanager
async def listening(app: FastAPI, settings: GatewaySettings) -> AsyncIterator[str]:
    """The app behind uvicorn; its URL."""
    config = server_config(app, settings)
    config.port, config.timeout_graceful_shutdown = 0, 1
    server = uvicorn.Server(config)
    # serve() would take this process's signal handlers.
    task = asyncio.create_task(server._serve())
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not server.started:
                assert not task.done(), "the app did not start"
                await asyncio.sleep(0.01)
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        with suppress(asyncio.CancelledError):
            await task


def capture(store: Store, name: str = "cap_1", **script: Any) -> str:
    """Store a capture for `Making`; its id."""
    store.put(f"captures/{name}.zip", json.dumps(script).encode(), content_type="application/zip")
    return name


async def start(client: httpx.AsyncClient, capture_id: str, key: str = "dress", **fields: Any) -> str:
    """Start a job; its id."""
    answer = await client.post("/v1/jobs", json={"capture": capture_id, "asset_key": key, **fields})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


async def job_when(
    client: httpx.AsyncClient, job: str, holds: Callable[[dict[str, Any]], bool], within_s: float = PATIENCE_S
) -> dict[str, Any]:
    """The job as soon as something holds of it."""
    async with asyncio.timeout(within_s):
        while not holds(found := (await client.get(f"/v1/jobs/{job}")).json()):
            await asyncio.sleep(0.02)
    return dict(found)


async def ended(client: httpx.AsyncClient, job: str, within_s: float = PATIENCE_S) -> dict[str, Any]:
    """The job at its end."""
    return await job_when(client, job, lambda found: found["state"] in TERMINAL, within_s)


async def events(client: httpx.AsyncClient, job: str, **headers: str) -> list[tuple[int, str, dict[str, Any]]]:
    """(id, event, data) of the whole stream, to its end; heartbeats have id 0."""
    told: list[tuple[int, str, dict[str, Any]]] = []
    number, kind = 0, ""
    async with client.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as answer:
        assert answer.status_code == 200
        async for line in answer.aiter_lines():
            name, _, value = line.partition(": ")
            match name:
                case "id":
                    number = int(value)
                case "event":
                    kind = value
                case "data":
                    told.append((number if kind != "heartbeat" else 0, kind, json.loads(value)))
    return told


async def until(holds: Callable[[], Awaitable[bool]], within_s: float = PATIENCE_S) -> None:
    """Wait for a condition; a test that waits in vain fails here."""
    async with asyncio.timeout(within_s):
        while not await holds():
            await asyncio.sleep(0.02)


def memory() -> MemoryStore:
    """A store that forgets."""
    return MemoryStore()
