"""kill -9 of worker and gateway by turns while 15 jobs run: in the end every job is done, and none twice."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.local import LocalStore
from tests.support import in_process_gateway
from tests.support.in_process_gateway import capture
from tests.support.patience import PATIENCE_S
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.workers.guarded_worker import children, count_kills

pytestmark = pytest.mark.slow

_JOBS = 15
_KILLS = 6
_WITHIN_S = 10 * PATIENCE_S


def test_no_job_is_lost_and_none_is_done_twice(tmp_path: Path, unused_tcp_port_factory: Callable[[], int]) -> None:
    store = LocalStore(tmp_path / "objects")
    edge_port, gateway_port = unused_tcp_port_factory(), unused_tcp_port_factory()
    shared = {"STORAGE_ROOT": store.root, "OMP_NUM_THREADS": 1}
    edge = ServiceProcess(
        "tests.support.workers.scripted_work_worker",
        tmp_path / "edge.log",
        EDGE_PORT=edge_port,
        EDGE_SLOTS=2,
        EDGE_SCRATCH=tmp_path / "scratch",
        **shared,
    )
    gateway = ServiceProcess(
        "capture2vr.gateway",
        tmp_path / "gateway.log",
        GATEWAY_PORT=gateway_port,
        GATEWAY_DATA_DIR=tmp_path / "gateway",
        GATEWAY_WORKERS=f"127.0.0.1:{edge_port}",
        GATEWAY_LEASE_S=2,
        GATEWAY_ATTACH_FOR_S=3,
        GATEWAY_RETRY_S=0.1,
        GATEWAY_MAX_ATTEMPTS=20,
        GATEWAY_PRESETS="draft,fine",
        **shared,
    )
    deadline = time.monotonic() + _WITHIN_S
    chance = random.Random(7)
    name = capture(store, steps=6, pause_s=0.1)
    with (
        killed_at_the_end(edge, gateway),
        httpx.Client(base_url=f"http://127.0.0.1:{gateway_port}", timeout=PATIENCE_S) as client,
    ):
        jobs = {f"key{n}": _start(client, name, f"key{n}", deadline) for n in range(_JOBS)}
        killed = 0.0
        for kill in range(_KILLS):
            _ask(client, partial(_somebody_works, since=killed), deadline)
            time.sleep(chance.uniform(0.0, 0.6))  # anywhere: between upload and work, in the work, in the publishing
            victim = (edge, gateway)[kill % 2]
            victim.kill()
            killed = time.time()
            victim.start()
        done = _ask(client, _all_ended, deadline)
        stories = {job: _told(client, job) for job in jobs.values()}

    assert {job["id"]: job["state"] for job in done} == dict.fromkeys(jobs.values(), "SUCCEEDED")
    for key, job in jobs.items():
        assert [(made["job"], made["state"]) for made in read_entry(store, key).versions] == [
            (job, "preview"),
            (job, "refined"),
        ]
        assert stories[job].count("SUCCEEDED") == 1
    assert max(job["attempts"] for job in done) > 1, "no kill hit a job: the test proves nothing"


async def test_a_job_that_kills_its_workers_fails_by_name(tmp_path: Path, unused_tcp_port: int) -> None:
    store = LocalStore(tmp_path / "objects")
    edge = ServiceProcess(
        "tests.support.workers.scripted_work_worker",
        tmp_path / "edge.log",
        EDGE_PORT=unused_tcp_port,
        EDGE_SCRATCH=tmp_path / "scratch",
        STORAGE_ROOT=store.root,
    )
    with killed_at_the_end(edge):
        async with in_process_gateway.gateway(tmp_path / "gw", store, unused_tcp_port, max_attempts=2) as client:
            job = await in_process_gateway.start(client, capture(store, wait=1))
            done, killed = {"state": "QUEUED"}, 0.0
            while done["state"] != "FAILED":
                done = await in_process_gateway.job_when(
                    client, job, partial(_fails_or_runs, since=killed), within_s=PATIENCE_S
                )
                await asyncio.sleep(0.5)  # for the run to be heard of: one that was not is no attempt
                edge.kill()
                killed = time.time()
                edge.start()
    assert (done["state"], done["attempts"], done["error"]["code"]) == ("FAILED", 2, "WORKER_LOST")
    assert done["error"]["retryable"]


async def test_a_job_whose_worker_ran_out_of_memory_says_so(tmp_path: Path, unused_tcp_port: int) -> None:
    """The guard is a real one; the test does what the kernel does: it counts the kill, and kills."""
    store = LocalStore(tmp_path / "objects")
    count_kills(tmp_path, 0)
    edge = ServiceProcess(
        "tests.support.workers.guarded_worker",
        tmp_path / "edge.log",
        str(tmp_path),
        EDGE_PORT=unused_tcp_port,
        EDGE_SCRATCH=tmp_path / "scratch",
        STORAGE_ROOT=store.root,
    )
    settings = {"max_attempts": 1, "attach_for_s": PATIENCE_S}
    with killed_at_the_end(edge):
        async with in_process_gateway.gateway(tmp_path / "gw", store, unused_tcp_port, **settings) as client:
            job = await in_process_gateway.start(client, capture(store, wait=1))
            within = {"within_s": PATIENCE_S}
            await in_process_gateway.job_when(client, job, partial(_fails_or_runs, since=0.0), **within)
            await asyncio.sleep(0.5)  # for the run to be heard of: one that was not is no attempt
            count_kills(tmp_path, 1)
            (child,) = children(edge.pid)
            os.kill(child, signal.SIGKILL)
            done = await in_process_gateway.job_when(client, job, lambda job: job["state"] == "FAILED", **within)
    assert done["error"]["code"] == "WORKER_LOST"
    assert "memory did not suffice" in done["error"]["detail"]
    assert any("give the worker more memory" in hint for hint in done["error"]["hints"])


def _fails_or_runs(job: dict[str, Any], since: float) -> bool:
    return job["state"] == "FAILED" or _somebody_works([job], since)


def _start(client: httpx.Client, name: str, key: str, deadline: float) -> str:
    """Start a job as a phone would: again under the same key until there is an answer."""
    while True:
        try:
            body = {"capture": name, "asset_key": key}
            answer = client.post("/v1/jobs", json=body, headers={"Idempotency-Key": key})
            assert answer.status_code == 202, answer.text
            return str(answer.json()["id"])
        except httpx.TransportError:
            assert time.monotonic() < deadline, "the gateway did not start"
            time.sleep(0.05)


def _ask(client: httpx.Client, holds: Callable[[list[dict[str, Any]]], bool], deadline: float) -> list[dict[str, Any]]:
    """All jobs, as soon as something holds of them."""
    jobs: list[dict[str, Any]] = []
    while time.monotonic() < deadline:
        try:
            jobs = client.get("/v1/jobs", params={"limit": 200}).json()["jobs"]
            if holds(jobs):
                return jobs
        except httpx.TransportError:
            pass
        time.sleep(0.05)
    raise AssertionError(f"not within {_WITHIN_S:g} s: {[(job['state'], job['attempts']) for job in jobs]}")


def _somebody_works(jobs: list[dict[str, Any]], since: float) -> bool:
    """Whether something happened to a run since the last kill: the next is to hit a job, not a service that starts."""
    return any(job["state"] == "RUNNING" and datetime.fromisoformat(job["updated"]).timestamp() > since for job in jobs)


def _all_ended(jobs: list[dict[str, Any]]) -> bool:
    return len(jobs) == _JOBS and all(job["state"] in {"SUCCEEDED", "FAILED", "CANCELLED"} for job in jobs)


def _told(client: httpx.Client, job: str) -> list[str]:
    """The states that the job's events tell of, in order; checks that no event is missing or told twice."""
    lines = client.get(f"/v1/jobs/{job}/events").text.splitlines()
    numbers = [int(line[4:]) for line in lines if line.startswith("id: ")]
    assert numbers == list(range(1, len(numbers) + 1))
    kinds = [line[7:] for line in lines if line.startswith("event: ")]
    states = [line.split('"state": "')[1].split('"')[0] for line in lines if line.startswith("data: ")]
    return [state for kind, state in zip(kinds, states, strict=True) if kind == "state"]
