"""Assets whose grade says to shoot again, over HTTP: told with the grade, in no list, and published by one request."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx

from tests.gateway.routes.test_webhooks import create
from tests.support.in_process_gateway import capture, ended, gateway, memory, start, worker
from tests.support.network.receivers import receiver
from tests.support.workers.scripted_work import Making

LISTS = ("/v1/assets", "/v1/collections/default/assets")


async def listed(client: httpx.AsyncClient) -> list[list[tuple[str, str]]]:
    """Keys and grades of the assets of both lists."""
    pages = [(await client.get(path)).json()["assets"] for path in LISTS]
    return [[(each["key"], each["grade"]) for each in page] for page in pages]


async def test_it_is_held_back_until_somebody_keeps_it(tmp_path: Path) -> None:
    store = memory()
    async with (
        receiver() as got,
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, webhook_private=True) as client,
    ):
        await create(client, got.url)
        job = await ended(client, await start(client, capture(store, grade="shoot again")))
        asset = job["asset"]
        assert (asset["version"], asset["held"], asset["grade"]["level"]) == (2, True, "shoot again")
        assert asset["grade"]["because_i18n"]["code"] == "surface_is_ragged"
        german = (await client.get(f"/v1/jobs/{job['id']}", headers={"Accept-Language": "de"})).json()
        assert german["asset"]["grade"]["advice"].startswith("Beleuchte es")
        assert await listed(client) == [[], []]
        held = (await client.get("/v1/assets", params={"held": True})).json()["assets"]
        assert [(each["key"], each["grade"]) for each in held] == [("dress", "shoot again")]
        entry = (await client.get("/v1/assets/dress")).json()
        assert (entry["version"], entry["held"], entry["grade"]) == (2, True, "shoot again")

        await client.post("/v1/assets/dress/versions/2/restore")
        assert await listed(client) == [[("dress", "shoot again")]] * 2
        assert (await client.get("/v1/assets", params={"held": True})).json()["assets"] == []
        assert (await client.get("/v1/assets/dress/versions/2")).json()["held"]
        await got.wait(5)
        told: list[dict[str, Any]] = got.documents
        types = ["job.running", "asset.held", "asset.held", "job.succeeded", "asset.published"]
        assert [each["type"] for each in told] == types
        grades = [told[1]["data"]["grade"], told[3]["data"]["asset"]["grade"], told[4]["data"]["grade"]]
        assert {(each["level"], each["advice_i18n"]["code"]) for each in grades} == {("shoot again", "again_matt")}
        assert [told[1]["data"]["held"], told[4]["data"]["held"]] == [True, False]


async def test_who_asks_for_it_has_it_published_and_a_good_one_says_so(tmp_path: Path) -> None:
    store = memory()
    async with (
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port) as client,
    ):
        good = await ended(client, await start(client, capture(store, grade="good"), "hat"))
        assert (good["asset"]["grade"]["level"], good["asset"]["held"]) == ("good", False)
        bad = capture(store, "cap_2", grade="shoot again")
        job = await ended(client, await start(client, bad, publish_anyway=True))
        assert (job["asset"]["grade"]["level"], job["asset"]["held"]) == ("shoot again", False)
        again = await ended(client, await start(client, bad, "hat"))
        assert (again["asset"]["version"], again["asset"]["held"]) == (4, True)
        assert await listed(client) == [[("dress", "shoot again"), ("hat", "good")]] * 2
        assert (await client.get("/v1/assets/hat")).json()["version"] == 2
