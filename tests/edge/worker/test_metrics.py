"""A worker's metrics and log lines, as a process of its own gives them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

import capture2vr
from capture2vr.storage.local import LocalStore
from tests.support.in_process_gateway import capture, ended, gateway, job_when, start, until
from tests.support.service_processes import ServiceProcess, killed_at_the_end


def scraped(text: str) -> dict[str, float]:
    """Samples by name and labels, such as `jobs_total{code="OK"}`."""
    return {
        sample.name + json.dumps(sample.labels, sort_keys=True): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


@pytest.mark.slow
async def test_a_worker_tells_of_its_jobs(tmp_path: Path, unused_tcp_port_factory: Callable[[], int]) -> None:
    store = LocalStore(tmp_path / "objects")
    port, metrics_port = unused_tcp_port_factory(), unused_tcp_port_factory()
    edge = ServiceProcess(
        "tests.support.workers.scripted_work_worker",
        tmp_path / "edge.log",
        EDGE_PORT=port,
        EDGE_METRICS_PORT=metrics_port,
        EDGE_SCRATCH=tmp_path / "scratch",
        EDGE_SLOTS=2,
        STORAGE_ROOT=store.root,
    )
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{metrics_port}") as scraper:

        async def scrape() -> dict[str, float]:
            return scraped((await scraper.get("/metrics")).raise_for_status().text)

        with killed_at_the_end(edge):
            async with gateway(tmp_path / "gw", store, port) as client:
                good = await start(client, capture(store, "cap_1"), "dress")
                await ended(client, good)
                await ended(client, await start(client, capture(store, "cap_2", fail="CAPTURE_DEGENERATE"), "vase"))
                running = await start(client, capture(store, "cap_3", wait=1), "lamp")
                await job_when(client, running, lambda job: job["stage"] == "FITTING")
                found = await scrape()
                await client.post(f"/v1/jobs/{running}/cancel")

                async def is_idle() -> bool:
                    return (await scrape())["capture2vr_worker_busy_slots{}"] == 0

                await until(is_idle)
    assert found['capture2vr_worker_jobs_total{"code": "OK"}'] == 1
    assert found['capture2vr_worker_jobs_total{"code": "CAPTURE_DEGENERATE"}'] == 1
    assert (found["capture2vr_worker_slots{}"], found["capture2vr_worker_busy_slots{}"]) == (2, 1)
    assert found["capture2vr_worker_draining{}"] == 0
    assert found["process_resident_memory_bytes{}"] > 1e7
    assert found[f'capture2vr_worker_info{{"device": "cpu", "version": "{capture2vr.__version__}"}}'] == 1
    lines = [json.loads(line) for line in (tmp_path / "edge.log").read_text().splitlines() if line.startswith("{")]
    mine = [line["message"] for line in lines if line.get("job") == good]
    assert any("starts" in line for line in mine)
    assert any("ended" in line for line in mine)


@pytest.mark.slow
def test_a_port_that_is_taken_is_named(tmp_path: Path, unused_tcp_port: int) -> None:
    begin = partial(
        ServiceProcess,
        "tests.support.workers.scripted_work_worker",
        EDGE_PORT=0,
        EDGE_METRICS_PORT=unused_tcp_port,
        STORAGE_ROOT=tmp_path,
    )
    first = begin(tmp_path / "first.log", EDGE_SCRATCH=tmp_path / "first")
    with killed_at_the_end(first):
        while "metrics on" not in (tmp_path / "first.log").read_text():
            assert first.is_running, (tmp_path / "first.log").read_text()
        second = begin(tmp_path / "second.log", EDGE_SCRATCH=tmp_path / "second")
        with killed_at_the_end(second):
            assert second.wait() == 1
    said = (tmp_path / "second.log").read_text()
    assert re.search(
        rf"EDGE_METRICS_PORT: cannot listen on 127\.0\.0\.1:{unused_tcp_port}: Address already in use", said
    )
