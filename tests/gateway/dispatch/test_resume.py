"""A worker that leaves in the middle of a training, by SIGTERM and by kill -9: the job goes on from its checkpoint, on
another worker that shares the scratch folder, as an eviction in a cluster has it."""

from __future__ import annotations

import itertools
import re
import signal
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import httpx
import pytest

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.local import LocalStore
from tests.edge.jobs.test_reconstruct_job import hemisphere_ply
from tests.support import in_process_gateway
from tests.support.in_process_gateway import ended, events, gateway, start
from tests.support.patience import PATIENCE_S
from tests.support.service_processes import ServiceProcess

pytestmark = pytest.mark.slow

# Of some 7 s, for checkpoints are 0.5 s apart and four are waited for; light, for nothing is learned here.
_PRESET = """
resolution = 32
lod_faces = [2000]

[fit]
steps = 300
batch = 100
pool = 5000
"""


async def test_a_training_goes_on_elsewhere_where_it_was(
    tmp_path: Path, unused_tcp_port_factory: Callable[[], int]
) -> None:
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets" / "brief.toml").write_text(_PRESET)
    store = LocalStore(tmp_path / "objects")
    with zipfile.ZipFile(tmp_path / "capture.zip", "w") as packed:
        packed.writestr("dome.ply", hemisphere_ply())
    store.put("captures/cap_dome.zip", (tmp_path / "capture.zip").read_bytes(), content_type="application/zip")
    ports = unused_tcp_port_factory(), unused_tcp_port_factory()
    begin = partial(
        ServiceProcess,
        "tests.support.workers.hasty_worker",
        tmp_path / "edge.log",
        "edge",
        EDGE_SCRATCH=tmp_path / "scratch",
        EDGE_PRESETS=tmp_path / "presets",
        EDGE_DRAIN_S=0.1,
        STORAGE_ROOT=store.root,
        OMP_NUM_THREADS=1,
    )
    edges = {f"127.0.0.1:{port}": begin(EDGE_PORT=port) for port in ports}
    try:
        async with gateway(tmp_path / "gw", store, *ports, attach_for_s=2.0) as client:
            await in_process_gateway.until(partial(_answer, client, 2))
            job = await start(client, "cap_dome", "dome", preset="brief")
            kept = tmp_path / "scratch" / "checkpoints" / job
            left: list[str] = []
            for number in (signal.SIGTERM, signal.SIGKILL):
                for _ in range(2):  # a run loses no more than it did since the last one: less than half of it
                    await in_process_gateway.until(partial(_newer, kept, _written(kept)))
                assert read_entry(store, "dome").state == "preview"
                left.append(await _busy(client))
                edge = edges[left[-1]]
                edge.end(number)
                assert _written(kept), "the checkpoint has gone with the worker"
                await in_process_gateway.until(partial(_busy_elsewhere, client, left[-1]))
                edge.start()
            done = await ended(client, job, within_s=3 * PATIENCE_S)
            story = await events(client, job)
    finally:
        for edge in edges.values():
            edge.kill()
    assert (done["state"], done["error"]) == ("SUCCEEDED", None)
    assert len(set(left)) == 2, "the job went on at the other worker"
    assert done["attempts"] == 2, "being handed back is no attempt, being killed is one"
    firsts = [made for made in read_entry(store, "dome").versions if not made["last"]]
    assert [made["state"] for made in firsts] == ["preview"], "a run that goes on publishes no second first look"
    assert not kept.exists(), "a job that has ended leaves no checkpoint"

    runs = _steps_by_run(story)
    assert len(runs) == 3
    for former, latter in itertools.pairwise(runs):
        assert latter[0] >= former[-1] // 2, "the training began anew"
    assert runs[-1][-1] > 240, "the last words of a stage are not all told"


async def _answer(client: httpx.AsyncClient, workers: int) -> bool:
    return len((await client.get("/v1/service")).json()["workers"]) == workers


async def _busy(client: httpx.AsyncClient) -> str:
    """The address of the one worker that runs a job."""
    workers = (await client.get("/v1/service")).json()["workers"]
    (address,) = [each["address"] for each in workers if not each["free_slots"]]
    return str(address)


async def _busy_elsewhere(client: httpx.AsyncClient, left: str) -> bool:
    """Whether a job runs on another worker than the one that has left, which the gateway may still list."""
    workers = (await client.get("/v1/service")).json()["workers"]
    return any(not each["free_slots"] for each in workers if each["address"] != left)


async def _newer(folder: Path, before: float) -> bool:
    return _written(folder) > before


def _written(folder: Path) -> float:
    """When the job's newest checkpoint was written; 0 without one."""
    return max((path.stat().st_mtime for path in folder.glob("*.checkpoint")), default=0.0)


def _steps_by_run(story: list[tuple[int, str, dict[str, object]]]) -> list[list[int]]:
    """The numbers of the training steps that each run of the job told of."""
    runs: list[list[int]] = []
    for _, kind, data in story:
        if kind == "state" and data["state"] == "RUNNING":
            runs.append([])
        elif found := re.match(r"step ([\d,]+) of", str(data.get("message", ""))):
            runs[-1].append(int(found[1].replace(",", "")))
    return runs
