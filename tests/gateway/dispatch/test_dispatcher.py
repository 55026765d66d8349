"""Jobs and workers: a job is done once, wherever it ends up and whatever is lost on the way."""

from __future__ import annotations

import asyncio
import errno
import json
import socket
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.edge.worker import scratch
from capture2vr.gateway.database.database import create_engine
from capture2vr.gateway.dispatch import dispatcher
from capture2vr.gateway.jobs import state_machine
from capture2vr.gateway.jobs.tables import jobs
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.memory import MemoryStore
from tests.support.in_process_gateway import Making, capture, ended, events, gateway, job_when, memory, start, worker
from tests.support.network.away_store import AwayStore

pytestmark = pytest.mark.slow


@pytest.mark.essential
async def test_a_job_succeeds_and_tells_of_it(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store, steps=4), label="Dress", preset="fine")
        done = await ended(client, job)
        story = await events(client, job)
    assert done["state"] == "SUCCEEDED"
    assert (done["fraction"], done["attempts"], done["preset"], done["label"]) == (1.0, 1, "fine", "Dress")
    assert (done["preview"]["version"], done["asset"]["version"]) == (1, 2)
    assert done["warnings"] == ["looks odd"]
    assert done["seconds"] == {"FITTING": 0.5}
    assert read_entry(store, "dress").version == 2
    assert [kind for _, kind, _ in story if kind != "progress"] == ["state", "state", "published", "published", "state"]


async def test_a_failure_names_what_is_wrong(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        done = await ended(client, await start(client, capture(store, fail="CAPTURE_DEGENERATE")))
    assert done["state"] == "FAILED"
    assert (done["error"]["code"], done["error"]["file"], done["error"]["status"]) == (
        "CAPTURE_DEGENERATE",
        "a.ply",
        422,
    )


async def test_a_retryable_failure_is_tried_again_but_not_for_ever(tmp_path: Path) -> None:
    store, work = memory(), None
    work = Making(store)
    async with (
        worker(work, tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, max_attempts=3) as client,
    ):
        done = await ended(client, await start(client, capture(store, fail="STORE_UNAVAILABLE", retryable=True)))
    assert (done["state"], done["attempts"], len(work.runs)) == ("FAILED", 3, 3)


async def test_a_job_that_no_worker_has_room_for_is_tried_less_and_less_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scratch, "HEADROOM", 1 << 50)
    store, tries = memory(), 6
    async with (
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, retry_s=0.1) as client,
    ):
        job = await start(client, capture(store))
        began = await first_runs(client, job, tries)
        assert began[-1] - began[0] >= 0.1 * (2 ** (tries - 1) - 1)
        monkeypatch.setattr(scratch, "HEADROOM", 3)
        done = await ended(client, job)
    assert (done["state"], done["attempts"]) == ("SUCCEEDED", 1)


async def first_runs(client: httpx.AsyncClient, job: str, count: int) -> list[float]:
    """When the first runs of a job were begun, in seconds since it was created, as soon as there are so many."""
    began: list[float] = []
    async with client.stream("GET", f"/v1/jobs/{job}/events") as told:
        async for line in told.aiter_lines():
            said = json.loads(line.removeprefix("data: ")) if line.startswith("data: ") else {}
            if said.get("state") == "RUNNING":
                began.append(said["elapsed_s"])
            if len(began) == count:
                break
    return began


async def test_jobs_wait_for_a_store_that_is_away(tmp_path: Path, unused_tcp_port: int) -> None:
    store = AwayStore()
    async with gateway(tmp_path / "gw", store, unused_tcp_port, max_attempts=1) as client:
        job = await start(client, capture(store))
        store.is_away = True
        async with worker(Making(store), tmp_path / "edge", port=unused_tcp_port):
            await first_runs(client, job, 3)
            store.is_away = False
            done = await ended(client, job)
    assert (done["state"], done["attempts"]) == ("SUCCEEDED", 1)


async def test_a_capture_that_a_disk_cannot_read_fails_its_job(tmp_path: Path, unused_tcp_port: int) -> None:
    store = BrokenDisk()
    async with gateway(tmp_path / "gw", store, unused_tcp_port, max_attempts=2) as client:
        job = await start(client, capture(store))
        async with worker(Making(store), tmp_path / "edge", port=unused_tcp_port):
            done = await ended(client, job)
    assert (done["state"], done["attempts"], done["error"]["code"]) == ("FAILED", 2, "STORE_UNAVAILABLE")


class BrokenDisk(MemoryStore):
    """A store that has lost what is in its captures."""

    def get(self, name: str, **part: Any) -> bytes:
        if name.endswith(".zip"):
            raise OSError(errno.EIO, "Input/output error")
        return super().get(name, **part)


async def test_cancelling_a_running_job_frees_its_worker(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store, wait=True))
        await job_when(client, job, lambda found: found["fraction"] > 0)
        answer = await client.post(f"/v1/jobs/{job}/cancel")
        assert (answer.status_code, answer.json()["state"]) == (202, "CANCELLING")
        assert (await ended(client, job))["state"] == "CANCELLED"
        after = await start(client, capture(store, "cap_2"), "hat")
        assert (await ended(client, after))["state"] == "SUCCEEDED"
        assert (await client.post(f"/v1/jobs/{after}/cancel")).json()["state"] == "SUCCEEDED"


async def test_a_waiting_job_is_cancelled_at_once(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        job = await start(client, capture(store))
        assert (await client.post(f"/v1/jobs/{job}/cancel")).json()["state"] == "CANCELLED"


async def test_a_restarted_gateway_finds_its_runs_again(tmp_path: Path) -> None:
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port:
        async with gateway(tmp_path / "gw", store, port) as client:
            job = await start(client, capture(store, wait=True))
            before = await job_when(client, job, lambda found: found["fraction"] > 0)
        work.release.set()
        async with gateway(tmp_path / "gw", store, port) as client:
            done = await ended(client, job)
            story = await events(client, job)
    assert (done["state"], done["attempts"], work.runs) == ("SUCCEEDED", 1, [job])
    assert done["elapsed_s"] > before["elapsed_s"]
    assert [number for number, _, _ in story] == list(range(1, len(story) + 1))


async def test_a_worker_that_shuts_down_hands_its_jobs_to_another(tmp_path: Path) -> None:
    store = memory()
    first, second = Making(store), Making(store)
    async with AsyncExitStack() as stays:
        async with AsyncExitStack() as goes:
            port = await goes.enter_async_context(worker(first, tmp_path / "first"))
            other = await stays.enter_async_context(worker(second, tmp_path / "second", slots=1))
            client = await stays.enter_async_context(gateway(tmp_path / "gw", store, port, other))
            jobs = [await start(client, capture(store, f"cap_{n}", wait=True), f"key{n}") for n in range(2)]
            for job in jobs:
                await job_when(client, job, lambda found: found["fraction"] > 0)
            assert len(first.runs) == len(second.runs) == 1  # the one with the shorter queue
        second.release.set()
        done = [await ended(client, job) for job in jobs]
    assert [each["state"] for each in done] == ["SUCCEEDED", "SUCCEEDED"]
    assert [each["attempts"] for each in done] == [1, 1]  # being replaced is no failure of the job's
    assert set(second.runs) == set(jobs)


async def test_jobs_wait_until_there_is_a_worker(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        job = await start(client, capture(store))
        await asyncio.sleep(0.7)
        assert (await client.get(f"/v1/jobs/{job}")).json()["state"] == "QUEUED"
        async with worker(Making(store), tmp_path / "edge", port=unused_tcp_port):
            done = await ended(client, job)
    assert (done["state"], done["attempts"]) == ("SUCCEEDED", 1)


async def test_many_jobs_over_two_workers_are_each_done_once(tmp_path: Path) -> None:
    store = MemoryStore()
    works = Making(store), Making(store)
    async with (
        worker(works[0], tmp_path / "a", slots=2) as one,
        worker(works[1], tmp_path / "b", slots=1) as two,
        gateway(tmp_path / "gw", store, one, two) as client,
    ):
        name = capture(store, steps=2, pause_s=0.02)
        jobs = [await start(client, name, f"key{n}") for n in range(20)]
        done = [await ended(client, job) for job in jobs]
    assert {each["state"] for each in done} == {"SUCCEEDED"}
    assert sorted(works[0].runs + works[1].runs) == sorted(jobs)
    assert works[1].runs
    for job, number in zip(jobs, range(20), strict=True):
        assert [version["job"] for version in read_entry(store, f"key{number}").versions] == [job, job]


async def test_a_run_ends_though_the_next_job_cannot_be_read(tmp_path: Path, url: str) -> None:
    """A row of a newer gateway, say: it must not keep the run before it from ending."""
    store = memory()
    work = Making(store)
    async with (
        worker(work, tmp_path / "edge", slots=1) as port,
        gateway(tmp_path / "gw", store, port, database_url=url) as client,
    ):
        first = await start(client, capture(store, wait=True))
        await job_when(client, first, lambda found: found["fraction"] > 0)
        second = await start(client, capture(store, "cap_2"), "hat")
        engine = create_engine(url)
        with engine.begin() as db:
            order = {"capture": "cap_2", "preset": "draft", "asset_key": "hat", "no_such_field": 1}
            db.execute(jobs.update().where(jobs.c.id == second).values(order=order))
        work.release.set()
        assert (await ended(client, first))["state"] == "SUCCEEDED"
        with engine.begin() as db:
            del order["no_such_field"]
            db.execute(jobs.update().where(jobs.c.id == second).values(order=order))
        engine.dispose()
        assert (await ended(client, second))["state"] == "SUCCEEDED"


async def test_a_worker_that_does_not_answer_holds_up_no_other(tmp_path: Path) -> None:
    """It accepts connections and says nothing, so that every call to it takes its whole deadline."""
    store = memory()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        away = silent.getsockname()[1]
        async with (
            worker(Making(store), tmp_path / "edge", slots=1) as port,
            gateway(tmp_path / "gw", store, away, port) as client,
        ):
            name = capture(store, steps=1)
            jobs = [await start(client, name, f"key{n}") for n in range(6)]
            done = [await ended(client, job) for job in jobs]
    assert [(each["state"], each["attempts"]) for each in done] == [("SUCCEEDED", 1)] * 6


async def test_a_capture_that_vanished_fails_the_job(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        job = await start(client, capture(store))
        store.delete("captures/cap_1.zip")
        async with worker(Making(store), tmp_path / "edge", port=unused_tcp_port):
            done = await ended(client, job)
    assert (done["state"], done["error"]["code"]) == ("FAILED", "CAPTURE_UNKNOWN")


async def test_two_gateways_share_a_database_and_one_takes_over_from_the_other(tmp_path: Path, url: str) -> None:
    store = memory()
    work = Making(store)
    shared = {"database_url": url}
    async with (
        worker(work, tmp_path / "edge") as port,
        gateway(tmp_path / "survivor", store, port, **shared) as survivor,
    ):
        async with gateway(tmp_path / "victim", store, port, **shared) as victim:
            job = await start(victim, capture(store, wait=True))
            await job_when(survivor, job, lambda found: found["fraction"] > 0.5)
        listening = asyncio.create_task(events(survivor, job))
        work.release.set()
        done = await ended(survivor, job)
        story = await listening
    assert (done["state"], done["attempts"], work.runs) == ("SUCCEEDED", 1, [job])
    assert [kind for _, kind, _ in story].count("published") == 2


async def test_a_cancellation_reaches_the_gateway_that_runs_the_job(tmp_path: Path, url: str) -> None:
    store = memory()
    shared = {"database_url": url}
    async with (
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "runs", store, port, **shared) as runs,
    ):
        job = await start(runs, capture(store, wait=True))
        await job_when(runs, job, lambda found: found["fraction"] > 0.5)
        async with gateway(tmp_path / "asks", store, port, **shared) as asks:
            await asks.post(f"/v1/jobs/{job}/cancel")
            assert (await ended(asks, job))["state"] == "CANCELLED"


async def test_a_job_goes_to_a_worker_that_offers_its_preset(tmp_path: Path) -> None:
    store = memory()
    quick, thorough = Making(store, "draft"), Making(store, "draft", "scene")
    async with (
        worker(quick, tmp_path / "a", slots=4) as one,
        worker(thorough, tmp_path / "b", slots=1) as two,
        gateway(tmp_path / "gw", store, one, two) as client,
    ):
        name = capture(store, steps=1)
        scenes = [await start(client, name, f"scene{n}", preset="scene") for n in range(3)]
        drafts = [await start(client, name, f"draft{n}", preset="draft") for n in range(3)]
        done = [await ended(client, job) for job in (*scenes, *drafts)]
        refused = await client.post("/v1/jobs", json={"capture": name, "asset_key": "x", "preset": "best"})
    assert {each["state"] for each in done} == {"SUCCEEDED"}
    assert {each["attempts"] for each in done} == {1}
    assert set(scenes) <= set(thorough.runs)
    assert (refused.status_code, refused.json()["code"]) == (422, "PRESET_UNKNOWN")
    assert refused.json()["hints"] == ["use one of: draft, scene"]


async def test_a_preset_whose_worker_is_busy_does_not_hold_up_the_others(tmp_path: Path) -> None:
    store = memory()
    quick, thorough = Making(store, "draft"), Making(store, "scene")
    async with (
        worker(quick, tmp_path / "a", slots=1) as one,
        worker(thorough, tmp_path / "b", slots=1, queue=0) as two,
        gateway(tmp_path / "gw", store, one, two) as client,
    ):
        running = await start(client, capture(store, "cap_wait", wait=True), "first", preset="scene")
        await job_when(client, running, lambda found: found["fraction"] > 0)
        waiting = await start(client, capture(store), "second", preset="scene")
        passing = await start(client, capture(store), "third", preset="draft")
        assert (await ended(client, passing))["state"] == "SUCCEEDED"
        assert (await client.get(f"/v1/jobs/{waiting}")).json()["state"] == "QUEUED"
        thorough.release.set()
        assert (await ended(client, waiting))["state"] == "SUCCEEDED"


async def test_a_long_job_yields_to_one_that_waits_and_goes_on_behind_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatcher, "_SLICE_S", 0.0)
    monkeypatch.setattr(dispatcher, "_WORKERS_S", 0.1)
    monkeypatch.setattr(state_machine, "_YIELD_PAUSE_S", 1.0)
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        long = await start(client, capture(store, "long", wait=1, checkpoint=1), "long")
        await job_when(client, long, lambda job: job["stage"] == "FITTING")
        short = await start(client, capture(store, "short"), "short")
        assert (await ended(client, short))["state"] == "SUCCEEDED"
        await job_when(client, long, lambda job: job["state"] == "RUNNING")
        work.release.set()
        found = await ended(client, long)
        assert (found["state"], found["attempts"]) == ("SUCCEEDED", 1)
        assert work.runs == [long, short, long]


async def test_a_long_job_does_not_yield_to_one_that_has_yielded_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatcher, "_SLICE_S", 0.0)
    monkeypatch.setattr(dispatcher, "_WORKERS_S", 0.1)
    monkeypatch.setattr(state_machine, "_YIELD_PAUSE_S", 0.1)
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        script = {"wait": 1, "checkpoint": 1}
        first = await start(client, capture(store, "first", **script), "first")
        await job_when(client, first, lambda job: job["stage"] == "FITTING")
        second = await start(client, capture(store, "second", **script), "second")
        await job_when(client, second, lambda job: job["stage"] == "FITTING")
        await asyncio.sleep(0.5)  # a few looks at the queue
        assert work.runs == [first, second]
        work.release.set()
        assert [(await ended(client, job))["state"] for job in (first, second)] == ["SUCCEEDED"] * 2


async def test_a_preset_of_a_worker_that_is_away_is_still_known(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store, "draft"), tmp_path / "a") as stays:
        async with worker(Making(store, "scene"), tmp_path / "b") as goes:
            pool = gateway(tmp_path / "gw", store, stays, goes)
            client = await pool.__aenter__()
            await client.get("/v1/presets")
        job = await start(client, capture(store), preset="scene")
        await asyncio.sleep(0.7)
        assert (await client.get(f"/v1/jobs/{job}")).json()["state"] == "QUEUED"
        await pool.__aexit__(None, None, None)


async def test_a_failure_behind_the_preview_says_that_it_stays(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        done = await ended(client, await start(client, capture(store, fail_refining="GPU_OOM")))
        asset = (await client.get("/v1/assets/dress")).json()
    assert (done["state"], done["error"]["code"]) == ("FAILED", "GPU_OOM")
    assert done["error"]["hints"] == ["use a coarser preset", "the preview stays available as version 1"]
    assert (done["preview"]["version"], done["asset"]) == (1, None)
    assert (asset["version"], asset["state"]) == (1, "preview")
