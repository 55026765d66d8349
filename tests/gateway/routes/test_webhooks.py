"""Webhooks over HTTP: what jobs and assets do is told, signed and once, through slow, broken and absent receivers."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest
from standardwebhooks import Webhook

from capture2vr.gateway.webhooks import outbox
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import capture, ended, gateway, memory, start, worker
from tests.support.network.receivers import receiver
from tests.support.tenants import publish_for, two_tenants
from tests.support.workers.scripted_work import Making


async def create(client: httpx.AsyncClient, url: str, *events: str) -> dict[str, str]:
    answer = await client.post("/v1/webhooks", json={"url": url, "events": events})
    assert answer.status_code == 201, answer.text
    made: dict[str, str] = answer.json()
    return made


async def test_a_job_is_told_from_its_start_to_its_asset(tmp_path: Path) -> None:
    store = memory()
    async with (
        receiver() as got,
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, webhook_private=True) as client,
    ):
        hook = await create(client, got.url)
        job = await start(client, capture(store))
        await ended(client, job)
        await got.wait(4)
        types = [document["type"] for document in got.documents]
        assert types == ["job.running", "asset.published", "asset.published", "job.succeeded"]
        assert {document["data"]["job"] for document in got.documents} == {job}
        assert got.documents[-1]["data"]["asset"]["key"] == "dress"
        for headers, body in got.got:
            Webhook(hook["secret"]).verify(body, headers)
        assert len(set(got.ids)) == 4
        messages = (await client.get(f"/v1/webhooks/{hook['id']}/messages")).json()["messages"]
        assert [message["type"] for message in messages] == types[::-1]
        assert {message["state"] for message in messages} <= {"delivered", "waiting"}


async def test_a_failed_delivery_is_repeated_with_its_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "DELAYS_S", (0.05, 0.05, 0.05))
    async with receiver() as got, gateway(tmp_path / "gw", memory(), webhook_private=True) as client:
        got.answers = [500, 503, 204]
        hook = await create(client, got.url)
        await client.post(f"/v1/webhooks/{hook['id']}/test")
        await got.wait(3)
        assert len(set(got.ids)) == 1
        async with asyncio.timeout(20):
            while (message := await newest(client, hook["id"]))["state"] != "delivered":
                await asyncio.sleep(0.05)
        assert message["attempts"] == 3
        again = await client.post(f"/v1/webhooks/{hook['id']}/messages/{message['id']}/redeliver")
        assert again.status_code == 202
        await got.wait(4)
        assert len(set(got.ids)) == 1, "whoever has seen the id knows the message"


async def newest(client: httpx.AsyncClient, hook: str) -> dict[str, object]:
    found: dict[str, object] = (await client.get(f"/v1/webhooks/{hook}/messages")).json()["messages"][0]
    return found


async def test_a_slow_receiver_delays_nobody_else(tmp_path: Path) -> None:
    async with (
        receiver() as slow,
        receiver() as quick,
        gateway(tmp_path / "gw", memory(), webhook_private=True) as client,
    ):
        slow.delay_s = 30.0
        hooks = [await create(client, each.url) for each in (slow, quick)]
        for _ in range(3):
            for hook in hooks:
                await client.post(f"/v1/webhooks/{hook['id']}/test")
        await quick.wait(3, within_s=10)
        assert len(slow.got) == 1, "one at a time"


async def test_a_receiver_that_is_gone_gets_nothing_more_until_it_is_enabled(tmp_path: Path) -> None:
    async with receiver() as got, gateway(tmp_path / "gw", memory(), webhook_private=True) as client:
        got.answers = [410, 204]
        hook = await create(client, got.url)
        await client.post(f"/v1/webhooks/{hook['id']}/test")
        async with asyncio.timeout(20):
            while (await client.get(f"/v1/webhooks/{hook['id']}")).json()["disabled"] is None:
                await asyncio.sleep(0.05)
        enabled = await client.put(f"/v1/webhooks/{hook['id']}/state", json={"disabled": False})
        assert enabled.json()["disabled"] is None


async def test_messages_survive_a_gateway_that_dies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "_LEASE_S", 0.2)
    async with receiver() as got:
        got.delay_s = 60.0
        async with gateway(tmp_path / "gw", memory(), webhook_private=True) as client:
            hook = await create(client, got.url)
            await client.post(f"/v1/webhooks/{hook['id']}/test")
            await got.wait(1)
        got.delay_s = 0.0
        async with gateway(tmp_path / "gw", memory(), webhook_private=True) as client:
            await got.wait(2)
            assert len(set(got.ids)) == 1
            async with asyncio.timeout(20):
                while (await newest(client, hook["id"]))["state"] != "delivered":
                    await asyncio.sleep(0.05)


async def test_removed_and_restored_are_told_to_the_tenant_alone(tmp_path: Path) -> None:
    store = memory()
    async with receiver() as ada, receiver() as bob, two_tenants(tmp_path, store, webhook_private=True) as site:
        await create(site.ada, ada.url, "asset.removed", "asset.restored")
        await create(site.bob, bob.url)
        publish_for(store, "ada", "dress")
        for verb in ("remove", "remove", "restore"):
            assert (await site.ada.post(f"/v1/assets/dress/{verb}")).status_code == 200
        await ada.wait(2)
        await asyncio.sleep(1.5)
        assert [document["type"] for document in ada.documents] == ["asset.removed", "asset.restored"]
        assert bob.got == []
        assert store_of_tenant(store, "ada").head("catalog/dress.json")


@pytest.mark.parametrize(
    "url",
    [
        "http://example.com/",
        "https://127.0.0.1/",
        "https://localhost:1/",
        "nonsense",
        "",
        "https://a..example/",
        f"https://{'a' * 64}.example/",
    ],
)
async def test_urls_that_nothing_is_sent_to(tmp_path: Path, url: str) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.post("/v1/webhooks", json={"url": url})
        assert (answer.status_code, answer.json()["code"]) == (422, "WEBHOOK_URL_REFUSED")
        assert (await client.get("/v1/webhooks")).json() == {"webhooks": []}


async def test_there_is_an_end_to_webhooks(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory(), webhook_private=True) as client:
        hooks = [await create(client, "http://127.0.0.1:9/") for _ in range(20)]
        answer = await client.post("/v1/webhooks", json={"url": "http://127.0.0.1:9/"})
        assert (answer.status_code, answer.json()["code"]) == (409, "WEBHOOKS_LIMITED")
        assert (await client.delete(f"/v1/webhooks/{hooks[0]['id']}")).status_code == 204
        assert (await client.get(f"/v1/webhooks/{hooks[0]['id']}")).status_code == 404
        new = (await client.post(f"/v1/webhooks/{hooks[1]['id']}/rotate")).json()
        assert new["secret"] != hooks[1]["secret"]
