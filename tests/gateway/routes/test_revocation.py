"""Access that ends takes what came of it along: paired devices, sessions, open streams, bodies on their way."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway import middleware
from capture2vr.gateway.access import authentication
from capture2vr.gateway.routes import event_streams
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import capture, memory, start
from tests.support.patience import PATIENCE_S
from tests.support.tenants import TwoTenants, bearer, make_key, two_tenants

READ = {"scopes": ["read"]}


async def code_of(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


async def own_key(client: httpx.AsyncClient) -> str:
    return str((await client.get("/v1/session")).json()["key"])


async def revoke(site: TwoTenants, key: str) -> None:
    assert (await site.operator.post(f"/v1/api-keys/{key}/revoke")).status_code == 200


@pytest.fixture
def asked_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authentication, "CACHE_S", 0.1)
    monkeypatch.setattr(middleware, "_ASK_S", 0.1)
    monkeypatch.setattr(event_streams, "HEARTBEAT_S", 0.2)


@pytest.mark.usefixtures("asked_often")
async def test_a_paired_device_ends_with_the_key_that_paired_it(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        claimed, still_open = [(await site.ada.post("/v1/pairings", json=READ)).json() for _ in range(2)]
        async with httpx.AsyncClient(base_url=site.url) as headset:
            assert (await headset.post("/v1/pairings/claim", json={"code": claimed["code"]})).status_code == 200
            deeper = (await headset.post("/v1/pairings", json=READ)).json()
            async with httpx.AsyncClient(base_url=site.url) as glasses:
                assert (await glasses.post("/v1/pairings/claim", json={"code": deeper["code"]})).status_code == 200
                await revoke(site, await own_key(site.ada))
                await asyncio.sleep(0.2)
                for device in (headset, glasses):
                    assert await code_of(await device.get("/v1/jobs")) == (401, "SESSION_ENDED")
        late = await site.anonymous.post("/v1/pairings/claim", json={"code": still_open["code"]})
        assert await code_of(late) == (404, "PAIRING_UNKNOWN")
        assert (await site.bob.get("/v1/jobs")).status_code == 200


@pytest.mark.usefixtures("asked_often")
async def test_a_devices_key_that_is_replaced_by_a_new_one_ends_with_that(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        pairing = (await site.ada.post("/v1/pairings", json=READ)).json()
        async with httpx.AsyncClient(base_url=site.url) as headset:
            await headset.post("/v1/pairings/claim", json={"code": pairing["code"]})
            rotated = await site.operator.post(f"/v1/api-keys/{await own_key(site.ada)}/rotate", json={"grace_days": 1})
            assert rotated.status_code == 201
            assert (await headset.get("/v1/jobs")).status_code == 200
            await revoke(site, rotated.json()["id"])
            await asyncio.sleep(0.2)
            assert await code_of(await headset.get("/v1/jobs")) == (401, "SESSION_ENDED")


@pytest.mark.slow
async def test_a_copied_cookie_ends_with_its_session_and_no_other_does(tmp_path: Path) -> None:
    secret = make_key(tmp_path / "gw", "ada")
    async with two_tenants(tmp_path, memory()) as site:
        async with httpx.AsyncClient(base_url=site.url) as browser, httpx.AsyncClient(base_url=site.url) as other:
            assert (await browser.post("/v1/session", json={"key": secret})).status_code == 200
            copied = {"Cookie": _as_header(browser)}
            await asyncio.sleep(1.1)  # a cookie's time is in whole seconds
            assert (await other.post("/v1/session", json={"key": secret})).status_code == 200
            assert (await browser.delete("/v1/session")).status_code == 204
            answer = await site.anonymous.get("/v1/jobs", headers=copied)
            assert await code_of(answer) == (401, "SESSION_ENDED")
            assert (await other.get("/v1/jobs")).status_code == 200
        assert (await site.anonymous.get("/v1/jobs", headers=bearer(secret))).status_code == 200


async def test_nobody_revokes_what_may_more(tmp_path: Path) -> None:
    operating = make_key(tmp_path / "gw", "ada")
    async with (
        two_tenants(tmp_path, memory()) as site,
        httpx.AsyncClient(base_url=site.url, headers=bearer(operating)) as owner,
    ):
        key = await own_key(owner)
        for way in ("revoke", "rotate"):
            answer = await site.ada.post(f"/v1/api-keys/{key}/{way}", json={})
            assert await code_of(answer) == (403, "SCOPE_MISSING")
        assert (await owner.get("/v1/jobs")).status_code == 200


@pytest.mark.usefixtures("asked_often")
@pytest.mark.parametrize("by", ["revoked", "logged out"])
async def test_a_stream_ends_with_the_key_or_the_session_that_follows_it(tmp_path: Path, by: str) -> None:
    secret = make_key(tmp_path / "gw", "ada")
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        job = await start(site.ada, capture(store_of_tenant(store, "ada")))
        async with httpx.AsyncClient(base_url=site.url, timeout=PATIENCE_S) as browser:
            await browser.post("/v1/session", json={"key": secret})
            key = await own_key(browser)
            async with browser.stream("GET", f"/v1/jobs/{job}/events") as answer, asyncio.timeout(PATIENCE_S):
                lines = answer.aiter_lines()
                await anext(lines)
                if by == "revoked":
                    await revoke(site, key)
                else:
                    await site.anonymous.delete("/v1/session", headers={"Cookie": _as_header(browser)})
                async for _ in lines:
                    pass
        assert (await site.ada.get(f"/v1/jobs/{job}")).json()["state"] == "QUEUED", "the stream did not end with it"


def _as_header(client: httpx.AsyncClient) -> str:
    return "; ".join(f"{name}={value}" for name, value in client.cookies.items())


@pytest.mark.usefixtures("asked_often")
async def test_an_upload_on_its_way_ends_with_its_key(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        key = await own_key(site.ada)

        async def body() -> AsyncIterator[bytes]:
            head = b'--x\r\nContent-Disposition: form-data; name="files"; filename="a.ply"\r\n\r\n'
            yield head
            await revoke(site, key)
            for _ in range(100):
                await asyncio.sleep(0.1)
                yield bytes(1000)

        kind = {"Content-Type": "multipart/form-data; boundary=x"}
        answer = await site.ada.post("/v1/captures", content=body(), headers=kind)
        assert await code_of(answer) == (401, "KEY_ENDED")
