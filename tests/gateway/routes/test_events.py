"""Following a job: nothing missed, nothing twice, not late, and an end."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.in_process_gateway import Making, capture, ended, events, gateway, job_when, memory, start, worker
from tests.support.patience import CANCEL_S, PATIENCE_S


async def test_live_and_replay_tell_the_same_story(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store, steps=5, pause_s=0.05))
        live, also = await asyncio.gather(events(client, job), events(client, job))
        replay = await events(client, job)
    assert live == also == replay
    assert [number for number, _, _ in replay] == list(range(1, len(replay) + 1))
    fractions = [data["fraction"] for _, _, data in replay]
    assert fractions == sorted(fractions)
    assert replay[-1][2]["state"] == "SUCCEEDED"
    assert {"state", "stage", "fraction", "elapsed_s", "eta_s", "seq"} <= replay[0][2].keys()


async def test_a_reconnected_listener_hears_the_rest(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store))
        whole = await events(client, job)
        for last in range(len(whole) + 2):
            assert await events(client, job, **{"Last-Event-ID": str(last)}) == whole[last:]
        answer = await client.get(f"/v1/jobs/{job}/events", params={"after": 2})
        assert answer.text.count("event: ") == len(whole) - 2


async def test_a_listener_hears_across_a_restart_of_the_gateway(tmp_path: Path) -> None:
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port:
        async with gateway(tmp_path / "gw", store, port) as client:
            job = await start(client, capture(store, wait=True))
            await job_when(client, job, lambda found: found["fraction"] > 0.5)
            told = await client.get("/v1/jobs/" + job)
        async with gateway(tmp_path / "gw", store, port) as client:
            listening = asyncio.create_task(events(client, job))
            await asyncio.sleep(0.1)
            work.release.set()
            story = await listening
    assert story[-1][2]["state"] == "SUCCEEDED"
    assert story[-1][2]["elapsed_s"] >= told.json()["elapsed_s"]


async def test_a_stream_ends_although_the_last_event_is_lost(tmp_path: Path) -> None:
    """A restored database may lack rows that could not be read."""
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store))
        whole = await events(client, job)
        with closing(sqlite3.connect(tmp_path / "gw" / "gateway.db")) as db:
            db.execute("DELETE FROM events WHERE job = ? AND seq IN (2, ?)", (job, len(whole)))
            db.commit()
        async with asyncio.timeout(CANCEL_S):
            assert await events(client, job) == [whole[0], *whole[2:-1]]
            assert await events(client, job, **{"Last-Event-ID": str(len(whole) - 1)}) == []


async def test_an_unknown_job_has_no_events(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.get("/v1/jobs/job_none/events")
        assert (answer.status_code, answer.json()["code"]) == (404, "JOB_UNKNOWN")


@pytest.mark.parametrize("last", ["x", "-1", "1.5", "9" * 40])
async def test_a_number_that_is_none_is_refused(tmp_path: Path, last: str) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.get("/v1/jobs/job_none/events", headers={"Last-Event-ID": last})
    assert (answer.status_code, answer.json()["code"]) == (422, "REQUEST_INVALID")


async def test_listeners_that_leave_are_forgotten(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        job = await start(client, capture(store))
        for _ in range(5):
            async with client.stream("GET", f"/v1/jobs/{job}/events") as answer:
                async for line in answer.aiter_lines():
                    if line.startswith("data: "):
                        break
        async with asyncio.timeout(PATIENCE_S):
            while "capture2vr_event_listeners 0.0" not in (await client.get("/metrics")).text:
                await asyncio.sleep(0.05)


@pytest.mark.slow
async def test_news_arrive_while_they_are_news(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store, steps=4, pause_s=0.3))
        seen: list[float] = []
        async with client.stream("GET", f"/v1/jobs/{job}/events") as answer:
            async for line in answer.aiter_lines():
                if line.startswith("data: "):
                    seen.append(time.monotonic())
        assert (await ended(client, job))["state"] == "SUCCEEDED"
    # Not one burst at the end: buffering anywhere between database and socket would make it one.
    assert seen[-1] - seen[0] > 0.5


@pytest.mark.slow
async def test_losses_and_the_time_left_reach_those_who_listen(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        story = await events(client, await start(client, capture(store, steps=3, pause_s=0.4)))
    told = [data for _, kind, data in story if kind == "progress" and data["losses"]]
    assert told[-1]["losses"]["distance"] < told[0]["losses"]["distance"]
    assert max(data["eta_s"] for data in told) > 0
