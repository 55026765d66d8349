"""Following a scene: each version and what is moved just now, for whoever may read it, as long as they may."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from limits import RateLimitItemPerMinute

from capture2vr.gateway.access import limits, sharing
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.routes import scene_events
from capture2vr.gateway.scenes import reads
from capture2vr.storage.scenes.scene_documents import replace_scene, scene_name
from capture2vr.storage.store import Store
from tests.gateway.routes.test_access import code_of
from tests.support.in_process_gateway import gateway, memory
from tests.support.patience import PATIENCE_S
from tests.support.tenants import TwoTenants, bearer, make_key, two_tenants

CHAIR = {"id": "a", "asset": "chair", "position_m": [0, 0, -1.5]}
THERE = {"id": "a", "position_m": [1, 0, -1.5], "rotation": [0, 0, 0, 1], "scale": 2}

Told = asyncio.Queue[tuple[str, str, dict[str, Any]]]
"""Events of a stream: (kind, id, data). ("end", "", {}) is its end."""


@pytest.fixture
def store() -> Store:
    return memory()


@pytest.fixture
async def site(tmp_path: Path, store: Store) -> AsyncIterator[TwoTenants]:
    async with two_tenants(tmp_path, store) as site:
        yield site


@pytest.fixture
async def scene(site: TwoTenants) -> str:
    """The path of a scene of ada's, with a chair."""
    return await saved(site.ada)


async def saved(client: httpx.AsyncClient) -> str:
    answer = await client.post("/v1/scenes", json={"name": "Room", "items": [CHAIR]})
    return str(answer.headers["location"])


async def replaced(client: httpx.AsyncClient, scene: str, version: int) -> dict[str, Any]:
    body = {"name": f"Room {version + 1}", "items": [CHAIR]}
    answer = await client.put(scene, json=body, headers={"If-Match": f'"{version}"'})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


async def move(client: httpx.AsyncClient, scene: str, *items: dict[str, Any], **options: Any) -> httpx.Response:
    return await client.post(f"{scene}/moving", json={"sender": "me", "items": items or (THERE,)}, **options)


@asynccontextmanager
async def following(client: httpx.AsyncClient, scene: str, **options: Any) -> AsyncIterator[Told]:
    """The events of a scene, without heartbeats."""
    told: Told = asyncio.Queue()
    async with client.stream("GET", f"{scene}/events", **options) as answer:
        assert answer.status_code == 200, await answer.aread()
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["cache-control"] == "no-store"
        task = asyncio.create_task(_tell(answer, told))
        try:
            yield told
        finally:
            task.cancel()


async def _tell(answer: httpx.Response, told: Told) -> None:
    event: dict[str, str] = {}
    async for line in answer.aiter_lines():
        name, _, value = line.partition(": ")
        event[name] = value
        if name == "data" and event["event"] != "heartbeat":
            told.put_nowait((event["event"], event.get("id", ""), json.loads(value)))
        if not line:
            event = {}
    told.put_nowait(("end", "", {}))


async def following_event(told: Told) -> tuple[str, str, dict[str, Any]]:
    return await asyncio.wait_for(told.get(), PATIENCE_S)


async def test_every_version_is_told_and_then_the_deletion(site: TwoTenants, scene: str) -> None:
    async with following(site.ada, scene) as told:
        kind, number, document = await following_event(told)
        assert (kind, number) == ("scene", "1")
        assert document == (await site.ada.get(scene)).json()
        for version in (1, 2):
            changed = await replaced(site.ada, scene, version)
            assert await following_event(told) == ("scene", str(version + 1), changed)
        assert (await site.ada.delete(scene)).status_code == 204
        assert await following_event(told) == ("deleted", "", {})
        assert await following_event(told) == ("end", "", {})
    assert (await site.ada.get(f"{scene}/events")).status_code == 404


async def test_who_has_lost_some_versions_gets_the_newest_alone(site: TwoTenants, scene: str) -> None:
    for version in (1, 2, 3):
        await replaced(site.ada, scene, version)
    for known in ({"headers": {"Last-Event-ID": "2"}}, {"params": {"after": 2}}, {"params": {"after": 0}}):
        async with following(site.ada, scene, **known) as told:
            assert (await following_event(told))[:2] == ("scene", "4")
            assert told.empty()
    async with following(site.ada, scene, headers={"Last-Event-ID": "4"}, params={"after": 1}) as told:
        await move(site.ada, scene)
        assert (await following_event(told))[0] == "moving", "version 4 is known"


async def test_what_is_moved_is_told_and_not_stored(
    site: TwoTenants, scene: str, store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, "capture2vr.gateway.requests")
    before = (await site.ada.get(scene)).json()
    async with following(site.ada, scene, params={"after": 1}) as one, following(site.ada, scene) as other:
        await following_event(other)
        moved = await move(site.ada, scene, THERE, {**THERE, "id": "b", "scale": 0.5})
        assert (moved.status_code, moved.content) == (204, b"")
        for told in (one, other):
            assert await following_event(told) == ("moving", "", {"sender": "me", **THERE})
            assert (await following_event(told))[2]["id"] == "b"
        await replaced(site.ada, scene, 1)
        assert (await following_event(one))[:2] == ("scene", "2")
    assert before["version"] == 1
    audit = (await site.ada.get("/v1/audit")).text
    assert scene in audit
    assert "/moving" not in audit, "ten rows a second would bury all others"
    levels = {record.levelno for record in caplog.records if f"POST {scene}" in record.getMessage()}
    assert levels == {logging.DEBUG}, "and so would ten lines in the request log"


@pytest.mark.usefixtures("still_limits")
async def test_only_who_saves_may_move_and_only_what_makes_sense(
    site: TwoTenants, scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = bearer(make_key(tmp_path / "gw", "ada", {Scope.READ}))
    assert await code_of(await move(site.anonymous, scene, headers=reader)) == (403, "SCOPE_MISSING")
    assert await code_of(await move(site.anonymous, scene)) == (401, "KEY_MISSING")
    assert await code_of(await move(site.bob, scene)) == (404, "SCENE_UNKNOWN")
    assert (await move(site.ada, scene, {**THERE, "asset": "chair"})).status_code == 422
    monkeypatch.setattr(limits, "_MOVES", RateLimitItemPerMinute(3))
    answers = [await move(site.ada, scene) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [204, 204, 204, 429]
    assert await code_of(answers[-1]) == (429, "MOVES_LIMITED")
    assert (await move(site.ada, await saved(site.ada))).status_code == 204, "each scene has its own"
    async with following(site.anonymous, scene, headers=reader) as told:
        assert (await following_event(told))[2]["may_save"] is False


@pytest.mark.parametrize("end", ["REVOKED", "EXPIRED"])
async def test_a_share_link_follows_until_it_ends(
    end: str, site: TwoTenants, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_events, "HEARTBEAT_S", 0.1)
    of_ada = {"tenant": "ada"}
    refused = await site.anonymous.get(f"{scene}/events", params=of_ada)
    assert await code_of(refused) == (401, "KEY_MISSING")
    share = (await site.ada.post("/v1/shares", json={"scene": scene.rpartition("/")[2], "password": "open"})).json()
    token = share["url"].rpartition("/")[2]
    without = {"Authorization": f"Share {token}"}
    refused = await site.anonymous.get(f"{scene}/events", params=of_ada, headers=without)
    assert await code_of(refused) == (401, "SHARE_PASSWORD_MISSING")
    opened = await site.anonymous.post("/v1/shares/open", json={"token": token, "password": "open"})
    assert opened.status_code == 200
    async with following(site.anonymous, scene, params=of_ada) as told:
        _, _, document = await following_event(told)
        assert (document["may_place"], document["may_save"]) == (False, False)
        assert document["view"].endswith("?tenant=ada")
        assert (await move(site.anonymous, scene, params=of_ada)).status_code == 401
        await move(site.ada, scene)
        assert (await following_event(told))[0] == "moving"
        if end == "REVOKED":
            assert (await site.ada.delete(f"/v1/shares/{share['id']}")).status_code == 200
        else:
            later = time.time() + 1e8
            monkeypatch.setattr(sharing, "time", SimpleNamespace(time=lambda: later))
        assert await following_event(told) == ("end", "", {})
        await replaced(site.ada, scene, 1)
    ended = await site.anonymous.get(f"{scene}/events", params=of_ada)
    assert await code_of(ended) == (410, f"SHARE_{end}")


async def test_what_is_written_past_the_gateway_is_seen_a_little_later(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_events, "HEARTBEAT_S", 0.1)
    monkeypatch.setattr(reads, "_FRESH_S", 0.1)
    async with gateway(tmp_path / "gw", store) as client:
        scene = await saved(client)
        name = scene.rpartition("/")[2]
        async with following(client, scene, params={"after": 1}) as told:
            replace_scene(store, name, 1, "By hand", ())
            kind, number, document = await following_event(told)
            assert (kind, number, document["name"]) == ("scene", "2", "By hand")
            store.delete(scene_name(name))
            assert (await following_event(told))[0] == "deleted"


async def test_one_client_has_so_many_streams(
    site: TwoTenants, scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_events, "_MOST_STREAMS", 2)
    reader = bearer(make_key(tmp_path / "gw", "ada", {Scope.READ}))
    async with following(site.ada, scene) as one, following(site.ada, scene) as two:
        await asyncio.gather(following_event(one), following_event(two))
        refused = await site.ada.get(f"{scene}/events")
        assert await code_of(refused) == (429, "STREAMS_LIMITED")
        assert int(refused.headers["retry-after"]) > 0
        async with following(site.anonymous, scene, headers=reader) as other:
            await following_event(other)
        await until_listeners(site, 2)
    await until_listeners(site, 0)


async def test_streams_that_one_client_asks_for_at_the_same_time_are_counted(
    site: TwoTenants, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_events, "_MOST_STREAMS", 2)
    lasting = asyncio.Queue[bool]()

    async def follow() -> None:
        async with site.ada.stream("GET", f"{scene}/events") as answer:
            lasting.put_nowait(
                answer.status_code == 200 and "event: scene" in [line async for line in answer.aiter_lines()]
            )

    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(follow()) for _ in range(12)]
        for _ in range(10):
            assert not await asyncio.wait_for(lasting.get(), PATIENCE_S), "those beyond the second end"
        await until_listeners(site, 2)
        for task in tasks:
            task.cancel()


async def until_listeners(site: TwoTenants, count: int) -> None:
    """Wait until the gateway counts so many: it hears a little later that a client has left."""
    async with asyncio.timeout(PATIENCE_S):
        while f"capture2vr_event_listeners {count}.0" not in (await site.operator.get("/metrics")).text:
            await asyncio.sleep(0.05)


async def test_streams_end_when_the_gateway_stops(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        told_of = await saved(client)
        stream = following(client, told_of)
        told = await stream.__aenter__()
        await following_event(told)
    assert told.empty() or (await following_event(told))[0] == "end"
