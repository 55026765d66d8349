"""Limits of tenants: told before an upload begins, with what is left and when to come back; others feel nothing."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.gateway.access import usage
from capture2vr.gateway.uploads.turns import _Budget
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import Making, capture, ended, memory, worker
from tests.support.network.away_store import AwayStore
from tests.support.tenants import TwoTenants, make_key, publish_for, two_tenants

_HEAD = b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"".join(b"property float %c\n" % axis for axis in b"xyz")
CLOUD = _HEAD + b"end_header\n1 2 3\n"


async def send(client: httpx.AsyncClient, content: bytes = CLOUD) -> httpx.Response:
    return await client.post("/v1/captures", files={"files": ("a.ply", content)})


async def outline(client: httpx.AsyncClient) -> httpx.Response:
    return await client.post("/v1/outlines", files={"files": ("a.ply", CLOUD)})


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


async def set_limits(site: TwoTenants, tenant: str, **limits: Any) -> None:
    answer = await site.operator.put(f"/v1/tenants/{tenant}/limits", json=limits)
    assert answer.status_code == 200, answer.text
    assert {name: answer.json()[name] for name in limits} == limits


@pytest.mark.parametrize("limit", [True, 3.5, -1, "many"])
async def test_a_limit_is_a_whole_number(tmp_path: Path, limit: object) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        before = (await site.operator.get("/v1/tenants/ada")).json()
        answer = await site.operator.put("/v1/tenants/ada/limits", json={"jobs_at_once": limit})
        assert answer.status_code == 422
        assert (await site.operator.get("/v1/tenants/ada")).json() == before


@pytest.mark.usefixtures("still_limits")
async def test_requests_a_minute(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        await set_limits(site, "ada", requests_per_minute=3)
        answers = [await site.ada.get("/v1/jobs") for _ in range(4)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
        assert answers[0].headers["ratelimit-policy"] == '"requests";q=3;w=60'
        assert answers[0].headers["ratelimit"].startswith('"requests";r=2;t=')
        assert code(answers[3]) == (429, "REQUESTS_LIMITED")
        assert 1 <= int(answers[3].headers["retry-after"]) <= 60
        assert answers[3].headers["ratelimit"].startswith('"requests";r=0;')
        refused = await send(site.ada)
        assert refused.status_code == 429
        assert (await site.bob.get("/v1/jobs")).status_code == 200


@pytest.mark.usefixtures("still_limits")
async def test_an_addresss_requests_are_counted_before_its_key_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture2vr.gateway.access.limits.is_own", lambda _: False)
    async with two_tenants(tmp_path, memory(), limit_address_requests_per_minute=3) as site:
        bad = {"Authorization": "Bearer c2v_ada_" + "x" * 43}
        answers = [await site.anonymous.get("/v1/jobs", headers=bad) for _ in range(5)]
        assert [answer.status_code for answer in answers] == [401, 401, 401, 429, 429]


@pytest.mark.slow
async def test_uploads_at_once(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        await set_limits(site, "ada", uploads_at_once=1)
        begun, go_on = asyncio.Event(), asyncio.Event()

        async def slow() -> AsyncIterator[bytes]:
            yield b"x"
            begun.set()
            await go_on.wait()

        first = asyncio.create_task(
            site.ada.post("/v1/captures", content=slow(), headers={"Content-Type": "application/zip"})
        )
        await begun.wait()
        await asyncio.sleep(0.2)
        assert code(refused := await send(site.ada)) == (429, "UPLOADS_LIMITED")
        assert int(refused.headers["retry-after"]) > 0
        assert (await send(site.bob)).status_code == 201
        assert code(await outline(site.ada)) == (429, "UPLOADS_LIMITED"), "it is checked and packed as an upload is"
        go_on.set()
        assert (await first).status_code in (400, 415, 422)
        assert (await send(site.ada)).status_code == 201, "the place is free again after a failure too"


async def test_processor_time_of_checks_and_inspections(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """test_turns.py has what is counted, and how."""
    monkeypatch.setattr(_Budget, "wait_s", lambda self, most_s, now: 120.0 if self.used_s and most_s == 7 else 0.0)
    async with two_tenants(tmp_path, memory()) as site:
        await set_limits(site, "ada", processor_s_per_minute=7)
        assert (await send(site.ada)).status_code == 201
        refused = await send(site.ada)
        assert code(refused) == (429, "PROCESSOR_LIMITED")
        assert refused.headers["retry-after"] == "120"
        assert "7 s" in refused.json()["detail"]
        assert code(await outline(site.ada)) == (429, "PROCESSOR_LIMITED")
        assert (await send(site.bob)).status_code == 201


class TestPresets:
    """What operators may name always, and others as far as their tenant's limits say."""

    async def test_the_methods_of_the_literature_are_for_operators(self, tmp_path: Path) -> None:
        store = memory()
        async with (
            worker(Offering(store), tmp_path / "edge") as port,
            two_tenants(tmp_path, store, port) as site,
        ):
            key = {"Authorization": f"Bearer {make_key(tmp_path / 'gw', 'ada')}"}
            capture(store_of_tenant(store, "ada"))
            assert await names(site.ada) == ["draft", "fine"]
            assert await names(site.ada, key) == ["draft", "fine", "paper"]
            assert code(await order(site.ada, "paper")) == (403, "PRESET_NOT_ALLOWED")
            assert code(await order(site.ada, "papier")) == (422, "PRESET_UNKNOWN")
            assert (await order(site.ada, "paper", key)).status_code == 202

    async def test_a_tenant_may_have_others(self, tmp_path: Path) -> None:
        store = memory()
        async with (
            worker(Offering(store), tmp_path / "edge") as port,
            two_tenants(tmp_path, store, port) as site,
        ):
            capture(store_of_tenant(store, "ada"))
            await set_limits(site, "ada", presets=["fine", "paper"])
            assert await names(site.ada) == ["fine", "paper"]
            assert (await order(site.ada, "paper")).status_code == 202
            assert (await order(site.ada)).json()["preset"] == "fine"
            refused = await order(site.ada, "draft")
            assert code(refused) == (403, "PRESET_NOT_ALLOWED")
            assert "fine, paper" in refused.json()["hints"][0]
            assert await names(site.bob) == ["draft", "fine"]

    async def test_a_recipe_and_a_repetition_may_not_name_it_either(self, tmp_path: Path) -> None:
        store = memory()
        async with (
            worker(Offering(store), tmp_path / "edge") as port,
            two_tenants(tmp_path, store, port) as site,
        ):
            capture(store_of_tenant(store, "ada"))
            edits = {"edits": {"preset": "paper"}}
            assert code(await site.ada.post("/v1/jobs", json={**ORDER, **edits})) == (403, "PRESET_NOT_ALLOWED")
            await set_limits(site, "ada", presets=["paper"])
            job = (await order(site.ada, "paper")).json()["id"]
            await set_limits(site, "ada")
            assert code(await site.ada.post(f"/v1/jobs/{job}/again", json={"cut": "scene"})) == (
                403,
                "PRESET_NOT_ALLOWED",
            )


async def test_what_a_job_may_compute_goes_to_its_worker_and_operators_have_no_limit(tmp_path: Path) -> None:
    store = memory()
    work = Offering(store)
    async with worker(work, tmp_path / "edge") as port, two_tenants(tmp_path, store, port) as site:
        key = {"Authorization": f"Bearer {make_key(tmp_path / 'gw', 'ada')}"}
        capture(store_of_tenant(store, "ada"))
        await set_limits(site, "ada", job_seconds=77)
        jobs = [(await order(site.ada)).json()["id"], (await order(site.ada, headers=key)).json()["id"]]
        for job in jobs:
            await ended(site.ada, job)
        assert work.most_seconds == dict(zip(jobs, (77.0, 0.0), strict=True))


ORDER = {"capture": "cap_1", "asset_key": "dress"}


class Offering(Making):
    """Work that also offers a method of the literature, and notes what its jobs may compute."""

    def __init__(self, store: Store) -> None:
        super().__init__(store)
        presets = (*self.offer.presets, pb.Preset(name="paper", literature=True))
        self.offer = replace(self.offer, presets=presets)
        self.most_seconds: dict[str, float] = {}

    def reconstruct(self, archive: Path, request: ReconstructionRequest, *others: Any) -> pb.Finished:
        self.most_seconds[request.job] = request.most_seconds
        return super().reconstruct(archive, request, *others)


async def names(client: httpx.AsyncClient, headers: dict[str, str] | None = None) -> list[str]:
    answer = await client.get("/v1/presets", headers=headers)
    return [each["name"] for each in answer.json()["presets"]]


async def order(client: httpx.AsyncClient, preset: str = "", headers: dict[str, str] | None = None) -> httpx.Response:
    return await client.post("/v1/jobs", json={**ORDER, **({"preset": preset} if preset else {})}, headers=headers)


class TestBytes:
    async def test_a_capture_that_is_too_large_is_refused_before_it_is_sent(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            await set_limits(site, "ada", capture_bytes=10_000)
            head = "POST /v1/captures HTTP/1.1\r\nHost: gateway\r\nContent-Length: 1000000\r\n"
            head += f"Content-Type: application/zip\r\nAuthorization: {site.ada.headers['Authorization']}\r\n\r\n"
            reader, writer = await asyncio.open_connection(*site.url.removeprefix("http://").split(":"))
            writer.write(head.encode())  # and nothing of the body
            async with asyncio.timeout(10):
                answer = (await reader.readuntil(b"}")).decode()
            writer.close()
            assert answer.startswith("HTTP/1.1 413")
            assert "CAPTURE_BYTES_LIMITED" in answer
            assert (await send(site.ada)).status_code == 201

    async def test_what_is_stored_counts_and_what_is_deleted_does_not(self, tmp_path: Path) -> None:
        store = LocalStore(tmp_path / "store")
        async with two_tenants(tmp_path, store) as site:
            receipt = (await send(site.ada)).json()
            await set_limits(site, "ada", stored_bytes=2 * receipt["bytes"] + 2_000)
            used = (await site.ada.get("/v1/usage")).json()
            assert used["stored_bytes"] == usage.count_bytes(store, "ada") > receipt["bytes"]
            second = await send(site.ada)
            assert second.status_code == 201
            refused = await send(site.ada, CLOUD.replace(b"1 2 3", b"1 2 4" + b" " * 2_000))
            assert code(refused) == (413, "STORED_BYTES_LIMITED")
            assert "retry-after" not in refused.headers
            assert len((await site.ada.get("/v1/captures")).json()["captures"]) == 2, "nothing is half done"
            await site.ada.delete(f"/v1/captures/{receipt['capture']}")
            assert (await send(site.ada)).status_code == 201

    @pytest.mark.slow
    async def test_a_store_that_does_not_answer_while_it_is_counted_is_named(self, tmp_path: Path) -> None:
        store = AwayStore()
        async with two_tenants(tmp_path, store) as site:
            await set_limits(site, "ada", stored_bytes=2_000)
            store.is_away = True
            for answer in (await send(site.ada), await site.ada.get("/v1/usage")):
                assert code(answer) == (503, "STORE_UNAVAILABLE")

    async def test_one_that_is_too_much_only_when_packed_leaves_nothing(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            await set_limits(site, "ada", capture_bytes=50)
            assert code(await outline(site.ada)) == (413, "CAPTURE_BYTES_LIMITED")

            async def untold() -> AsyncIterator[bytes]:
                yield CLOUD

            answer = await site.ada.post("/v1/captures", content=untold(), params={})
            assert answer.status_code in (413, 415, 422)
            assert (await site.ada.get("/v1/captures")).json()["captures"] == []
            assert list((tmp_path / "gw" / "uploads").iterdir()) == []

    async def test_published_assets_count_at_the_next_count(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        store = memory()
        async with two_tenants(tmp_path, store) as site:
            before = (await site.ada.get("/v1/usage")).json()["stored_bytes"]
            publish_for(store, "ada", "dress")
            publish_for(store, "bob", "dress")
            monkeypatch.setattr(usage, "FRESH_S", -1.0)
            async with asyncio.timeout(10):
                while (now := (await site.ada.get("/v1/usage")).json()["stored_bytes"]) == before:
                    await asyncio.sleep(0.02)
            assert now == usage.count_bytes(store, "ada") == usage.count_bytes(store, "bob")
            assert usage.count_bytes(store, "default") == 0

    async def test_what_was_never_counted_is_not_subtracted_below_nothing(self, tmp_path: Path) -> None:
        store = memory()
        async with two_tenants(tmp_path, store) as site:
            assert (await site.ada.get("/v1/usage")).json()["stored_bytes"] == 0
            publish_for(store, "ada", "dress")
            assert (await site.ada.delete("/v1/assets/dress")).status_code == 200
            assert (await site.ada.get("/v1/usage")).json()["stored_bytes"] == 0


class TestJobs:
    async def test_at_once(self, tmp_path: Path) -> None:
        store = memory()
        async with two_tenants(tmp_path, store) as site:
            await set_limits(site, "ada", jobs_at_once=2)
            order = {"capture": capture(store_of_tenant(store, "ada")), "asset_key": "dress"}
            jobs = [await site.ada.post("/v1/jobs", json=order, headers={"Idempotency-Key": str(n)}) for n in range(2)]
            refused = await site.ada.post("/v1/jobs", json=order)
            assert code(refused) == (429, "JOBS_LIMITED")
            assert int(refused.headers["retry-after"]) > 0
            again = await site.ada.post("/v1/jobs", json=order, headers={"Idempotency-Key": "1"})
            assert again.json()["id"] == jobs[1].json()["id"], "a repeated request is no new job"
            await site.ada.post(f"/v1/jobs/{jobs[0].json()['id']}/cancel")
            assert (await site.ada.post("/v1/jobs", json=order)).status_code == 202

    async def test_a_day(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        store = memory()
        async with two_tenants(tmp_path, store) as site:
            await set_limits(site, "ada", jobs_per_day=1)
            order = {"capture": capture(store_of_tenant(store, "ada")), "asset_key": "dress"}
            job = (await site.ada.post("/v1/jobs", json=order)).json()
            await site.ada.post(f"/v1/jobs/{job['id']}/cancel")
            refused = await site.ada.post("/v1/jobs", json=order)
            assert code(refused) == (429, "JOBS_LIMITED")
            assert int(refused.headers["retry-after"]) == pytest.approx(86_400, abs=60)
            used = (await site.ada.get("/v1/usage")).json()
            assert (used["jobs"], used["jobs_today"], used["limits"]["jobs_per_day"]) == (0, 1, 1)
            later = time.time() + 86_500
            monkeypatch.setattr(time, "time", lambda: later)
            assert (await site.ada.post("/v1/jobs", json=order)).status_code == 202


async def test_limits_are_an_operators(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory(), limit_jobs_at_once=7) as site:
        for client, path in ((site.ada, "/v1/tenants/ada/limits"), (site.bob, "/v1/tenants/ada/limits")):
            assert code(await client.put(path, json={"jobs_at_once": 0})) == (403, "SCOPE_MISSING")
        assert code(await site.operator.put("/v1/tenants/eve/limits", json={})) == (404, "TENANT_UNKNOWN")
        for bad in ({"jobs_at_once": -1}, {"jobs": 1}, {"jobs_at_once": 1 << 61}):
            assert code(await site.operator.put("/v1/tenants/ada/limits", json=bad)) == (422, "REQUEST_INVALID")
        assert (await site.operator.get("/v1/tenants/ada/usage")).json()["limits"]["jobs_at_once"] == 7
        await set_limits(site, "ada", jobs_at_once=1)
        assert (await site.ada.get("/v1/usage")).json()["limits"]["jobs_at_once"] == 1
        assert (await site.bob.get("/v1/usage")).json()["limits"]["jobs_at_once"] == 7
        await set_limits(site, "ada")
        assert (await site.ada.get("/v1/usage")).json()["limits"]["jobs_at_once"] == 7
