"""A job again with another cut, or edited: the stored capture and every other option stay, and nothing is uploaded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.jobs.capture_objects import capture_name
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.store import JobStore
from tests.support.in_process_gateway import capture, gateway, memory

OPTIONS = {"label": "My dress", "preset": "draft", "longest_m": 0.31, "fill": "all", "target": "quest3"}


async def test_everything_but_the_cut_stays(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        body = {"capture": capture(store), "asset_key": "dress", **OPTIONS}
        first = (await client.post("/v1/jobs", json=body)).json()
        answer = await client.post(first["links"]["again"], json={"cut": "scene"})
        again = answer.json()
        assert answer.status_code == 202
        assert answer.headers["location"] == f"/v1/jobs/{again['id']}" != f"/v1/jobs/{first['id']}"
        assert (first["cut"], again["cut"]) == ("", "scene")
        same = ("capture", "asset_key", "label", "preset")
        assert [again[name] for name in same] == [first[name] for name in same]
    earlier, later = (stored_order(tmp_path / "gw", each["id"]) for each in (first, again))
    assert later == replace(earlier, options=replace(earlier.options, cut="scene"))
    options = earlier.options
    assert (options.longest_m, options.fill, options.target) == (0.31, "all", "quest3")


def stored_order(data_dir: Path, job: str) -> Order:
    """The order of a job as it is in the gateway's database."""
    engine = open_engine(f"sqlite:///{data_dir / 'gateway.db'}")
    try:
        return JobStore(engine).get("default", job).order
    finally:
        engine.dispose()


async def test_one_tap_twice_is_one_job(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await client.post("/v1/jobs", json={"capture": capture(store), "asset_key": "dress"})).json()
        tap = {"url": first["links"]["again"], "headers": {"Idempotency-Key": "tap"}}
        one, two = [await client.post(**tap, json={"cut": "scene"}) for _ in range(2)]
        assert one.json()["id"] == two.json()["id"]
        other = await client.post(**tap, json={"cut": "object"})
        assert (other.status_code, other.json()["code"]) == (409, "IDEMPOTENCY_CONFLICT")
        assert len((await client.get("/v1/jobs")).json()["jobs"]) == 2


@pytest.mark.parametrize("body", [{}, {"cut": "half"}, {"cut": "scene", "preset": "fine"}])
async def test_what_cannot_be_changed_is_refused(tmp_path: Path, body: dict[str, str]) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await client.post("/v1/jobs", json={"capture": capture(store), "asset_key": "dress"})).json()
        answer = await client.post(first["links"]["again"], json=body)
        assert (answer.status_code, answer.json()["code"]) == (422, "REQUEST_INVALID")


async def test_an_unknown_job_and_a_capture_that_is_gone_have_names(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        unknown = await client.post("/v1/jobs/job_0/again", json={"cut": "scene"})
        assert (unknown.status_code, unknown.json()["code"]) == (404, "JOB_UNKNOWN")
        first = (await client.post("/v1/jobs", json={"capture": capture(store), "asset_key": "dress"})).json()
        store.delete(capture_name(first["capture"]))
        gone = await client.post(first["links"]["again"], json={"cut": "scene"})
        assert (gone.status_code, gone.json()["code"]) == (404, "CAPTURE_UNKNOWN")


BOX = {"centre": [0.0, 0.0, 0.0], "size": [1.0, 1.0, 1.0]}


async def test_edits_are_a_job_on_the_same_capture(tmp_path: Path) -> None:
    """What the recipe says of fill, preset and target holds; what it leaves out stays, and is written into it."""
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (
            await client.post("/v1/jobs", json={"capture": capture(store), "asset_key": "dress", **OPTIONS})
        ).json()
        edits = {"capture": first["capture"], "crop": BOX, "fill": "none", "preset": "fine"}
        again = (await client.post(first["links"]["again"], json={"edits": edits})).json()
        recut = (await client.post(again["links"]["again"], json={"cut": "scene"})).json()
        bare = (await client.post(recut["links"]["again"], json={"edits": {}})).json()
    assert first["edits"] == {"schema": 1}
    assert again["edits"] == {"schema": 1, **edits, "target": "quest3"}
    assert recut["edits"] == {**again["edits"], "cut": "scene"}
    assert (bare["edits"], bare["cut"]) == ({"schema": 1}, "scene")
    options = stored_order(tmp_path / "gw", again["id"]).options
    assert (options.fill, options.preset, options.target, options.longest_m) == ("none", "fine", "quest3", 0.31)
    assert options.edits.as_json == again["edits"]


async def test_a_first_job_may_be_edited_too(tmp_path: Path) -> None:
    """What the job itself names comes first, and the recipe then says it."""
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        order = {"capture": capture(store), "asset_key": "dress", "fill": "all", "edits": {"crop": BOX, "fill": "none"}}
        job = (await client.post("/v1/jobs", json=order)).json()
        assert job["edits"]["fill"] == "all"
        plain = (await client.post("/v1/jobs", json={"capture": "cap_1", "asset_key": "coat"})).json()
        assert plain["edits"] == {"schema": 1}


async def test_edits_of_another_capture_are_refused(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        order = {"capture": capture(store), "asset_key": "dress"}
        first = (await client.post("/v1/jobs", json=order)).json()
        foreign = {"capture": "cap_2", "crop": BOX}
        for answer in (
            await client.post(first["links"]["again"], json={"edits": foreign}),
            await client.post("/v1/jobs", json={**order, "edits": foreign}),
        ):
            problem = answer.json()
            assert (answer.status_code, problem["code"]) == (422, "EDITS_OTHER_CAPTURE")
            assert "cap_2" in problem["detail"]
        unknown = await client.post(first["links"]["again"], json={"edits": {"preset": "nonesuch"}})
        assert (unknown.status_code, unknown.json()["code"]) == (422, "PRESET_UNKNOWN")


async def test_the_schema_of_edits_is_served(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.get("/v1/schemas/edits")
    assert answer.headers["content-type"] == "application/schema+json"
    assert "crop" in answer.json()["properties"]
