"""GET /v1/service: queue, workers, disks and failures, as an operator sees them."""

from __future__ import annotations

import shutil
from pathlib import Path

from capture2vr.storage.local import LocalStore
from tests.support.in_process_gateway import Making, capture, ended, gateway, job_when, memory, start, worker


async def test_workers_queue_and_failures(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port, 9) as client:
        failed = await start(client, capture(store, "cap_bad", fail="CAPTURE_DEGENERATE"), "vase")
        await ended(client, failed)
        await ended(client, await start(client, capture(store, "cap_good"), "dress"))
        told = (await client.get("/v1/service")).json()
        ready = await client.get("/readyz")
    assert (told["ready"], told["checks"]) == (ready.json()["ready"], ready.json()["checks"])
    assert told["open"] is True
    assert (told["jobs"]["FAILED"], told["jobs"]["SUCCEEDED"], told["jobs"]["QUEUED"]) == (1, 1, 0)
    assert told["waiting_s"] == 0
    (one,) = told["workers"]
    assert (one["address"], one["draining"]) == (f"127.0.0.1:{port}", False)
    assert one["slots"] >= one["free_slots"] >= 1
    assert told["silent_workers"] == ["127.0.0.1:9"]
    (failure,) = told["failures"]
    assert (failure["job"], failure["tenant"], failure["asset_key"]) == (failed, "default", "vase")
    assert failure["code"] == "CAPTURE_DEGENERATE"
    assert failure["detail"]


async def test_the_length_of_the_queue(tmp_path: Path) -> None:
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        first = await start(client, capture(store, wait=1), "vase")
        await job_when(client, first, lambda job: job["stage"] == "FITTING")
        second = await start(client, capture(store, "cap_2"), "dress")
        told = (await client.get("/v1/queue")).json()
        assert (told["queued"], told["running"], told["unfinished"]) == (1, 1, 2)
        assert told["waiting_s"] > 0
        work.release.set()
        for job in (first, second):
            await ended(client, job)
        assert (await client.get("/v1/queue")).json() == {"queued": 0, "running": 0, "unfinished": 0, "waiting_s": 0.0}


async def test_a_job_that_no_worker_takes_waits(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "objects")
    async with gateway(tmp_path / "gw", store) as client:
        await start(client, capture(store))
        told = (await client.get("/v1/service")).json()
    assert told["jobs"]["QUEUED"] == 1
    assert told["waiting_s"] > 0
    (disk,) = told["disks"]
    assert disk["holds"] == "database, staging and objects"
    assert disk["total_bytes"] == shutil.disk_usage(tmp_path).total
