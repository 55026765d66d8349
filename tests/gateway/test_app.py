"""The app as a whole: health, pages, metrics, cross-origin calls, one gateway per folder, and nothing heavy in it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.database.instance_lock import FolderInUse, lock_instance, lock_replica
from capture2vr.gateway.page_texts import WEB
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.process.strict_settings import SettingsError
from tests.support.in_process_gateway import Making, capture, ended, gateway, memory, start, worker
from tests.support.patience import PATIENCE_S


@pytest.mark.slow
async def test_ready_means_that_a_job_would_be_done(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, 9) as client:
        assert (await client.get("/livez")).status_code == 200
        answer = await client.get("/readyz")
        assert answer.status_code == 503
        checks = answer.json()["checks"]
        assert {name: check["ok"] for name, check in checks.items()} == {
            "store": True,
            "database": True,
            "disk": True,
            "workers": False,
        }
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        assert (await client.get("/readyz")).json()["ready"] is True


async def test_checks_can_be_left_out_of_readiness(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory(), 9) as client:
        answer = await client.get("/readyz?exclude=workers")
        assert (answer.status_code, answer.json()["ready"]) == (200, True)
        assert answer.json()["checks"]["workers"]["ok"] is False
        assert (await client.get("/readyz?exclude=workrs")).status_code == 422


@pytest.mark.slow
async def test_presets_are_those_of_the_workers(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, presets=("fast", "best")) as client:
        assert await _presets(client) == (["fast", "best"], "fast")
        assert (await client.get(f"/v1/jobs/{await start(client, capture(store))}")).json()["preset"] == "fast"
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "other", store, port) as client:
        assert await _presets(client) == (["draft", "fine"], "draft")
        told = (await client.get("/v1/presets")).json()["presets"][0]
        assert told == {
            "name": "draft",
            "summary": "quick",
            "trained": False,
            "memory_bytes": 7,
            "literature": False,
            "takes": "",
        }


async def _presets(client: httpx.AsyncClient) -> tuple[list[str], str]:
    told = (await client.get("/v1/presets")).json()
    return [preset["name"] for preset in told["presets"]], told["default"]


async def test_metrics_count_what_happened(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        await ended(client, await start(client, capture(store)))
        await client.get("/v1/jobs/job_none")
        page = (await client.get("/metrics")).text
    for line in (
        'capture2vr_http_requests_total{method="POST",route="/v1/jobs",status="202"} 1.0',
        'capture2vr_http_requests_total{method="GET",route="/v1/jobs/{job}",status="404"} 1.0',
        'capture2vr_jobs{state="SUCCEEDED"} 1.0',
        'capture2vr_job_seconds_count{state="SUCCEEDED"} 1.0',
        'capture2vr_stage_seconds_sum{stage="FITTING"} 0.5',
        "capture2vr_queue_depth 0.0",
    ):
        assert line in page


async def test_pages_run_only_what_is_ours(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        for address in ("/", "/view/dress"):
            answer = await client.get(address)
            assert answer.headers["content-type"].startswith("text/html")
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            scripts = policy.split("script-src")[1].split(";")[0]
            assert not {"'unsafe-inline'", "'unsafe-eval'"} & set(scripts.split())
        assert (await client.get("/view/-bad")).status_code == 404
        module = await client.get("/web/shared/api.js")
        assert module.headers["cache-control"] == "no-cache"
        known = {"If-None-Match": module.headers["etag"]}
        assert (await client.get("/web/shared/api.js", headers=known)).status_code == 304
        assert (await client.get("/web/shared/types.d.ts")).status_code == 404, "for the compiler alone"


async def test_one_worker_may_make_functions_of_text_and_nothing_else(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        worker = await client.get("/web/graphics/ktx2-worker.js")
        assert worker.headers["content-security-policy"] == "default-src 'none'; script-src 'self' 'unsafe-eval'"
        again = await client.get("/web/graphics/ktx2-worker.js", headers={"If-None-Match": worker.headers["etag"]})
        assert (again.status_code, "content-security-policy" in again.headers) == (304, True)
        transcoder = await client.get("/web/vendor/three-0.187.0.basis-transcoder.wasm")
        assert transcoder.headers["content-type"] == "application/wasm"  # else no browser compiles it as it comes
        assert "immutable" in transcoder.headers["cache-control"]


async def test_scripts_travel_small(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        address = "/web/vendor/three-0.187.0.core.js"
        for accepted, share in (("gzip", 0.3), ("identity", 1.0)):
            async with client.stream("GET", address, headers={"Accept-Encoding": accepted}) as answer:
                sent = sum([len(chunk) async for chunk in answer.aiter_raw()])
                assert answer.headers["vary"] == "Accept-Encoding"
            whole = (WEB.parent / address.lstrip("/")).stat().st_size
            assert share / 2 < sent / whole <= share


async def test_other_origins_call_only_when_they_are_named(tmp_path: Path) -> None:
    origin = {"Origin": "https://vr.example"}
    async with gateway(tmp_path / "gw", memory()) as client:
        assert "access-control-allow-origin" not in (await client.get("/v1/jobs", headers=origin)).headers
    async with gateway(tmp_path / "gw", memory(), cors_origins=("https://vr.example",)) as client:
        assert (await client.get("/v1/jobs", headers=origin)).headers["access-control-allow-origin"] == origin["Origin"]


def test_a_folder_has_one_gateway_and_keeps_its_name(tmp_path: Path) -> None:
    with lock_instance(tmp_path) as first, pytest.raises(FolderInUse, match="another gateway"), lock_instance(tmp_path):
        pass
    with lock_instance(tmp_path) as again:
        assert again == first


def test_replicas_with_one_data_folder_have_a_folder_each(tmp_path: Path) -> None:
    with lock_replica(tmp_path) as first:
        with lock_replica(tmp_path) as second, lock_replica(tmp_path) as third:
            assert first.folder == tmp_path
            assert (second.folder, third.folder) == (tmp_path / "replica-2", tmp_path / "replica-3")
            assert len({first.id, second.id, third.id}) == 3
        with lock_replica(tmp_path) as again:
            assert again == second


async def test_gateways_on_postgres_share_a_data_folder(tmp_path: Path, empty_postgres: str) -> None:
    store = memory()
    async with (
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, database_url=empty_postgres) as one,
        gateway(tmp_path / "gw", store, port, database_url=empty_postgres) as other,
    ):
        job = await start(one, capture(store))
        assert (await ended(other, job))["state"] == "SUCCEEDED"
    assert (tmp_path / "gw" / "replica-2" / "gateway.id").exists()


def test_settings_name_their_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATEWAY_WORKERS", "a:1, b:2")
    assert GatewaySettings().workers == ("a:1", "b:2")
    monkeypatch.setenv("GATEWAY_PROT", "1")
    with pytest.raises(SettingsError, match="GATEWAY_PORT"):
        GatewaySettings()


@pytest.mark.slow
def test_the_gateway_holds_no_geometry() -> None:
    heavy = "{'torch', 'numpy', 'scipy', 'trimesh', 'cv2', 'av'}"
    probe = f"import sys, capture2vr.gateway.app; print(sorted({heavy} & sys.modules.keys()))"
    found = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.essential
@pytest.mark.slow
def test_a_gateway_starts_and_stops_when_told(tmp_path: Path, unused_tcp_port: int) -> None:
    command = [sys.executable, "-m", "capture2vr.gateway"]
    settings = {"GATEWAY_PORT": str(unused_tcp_port), "GATEWAY_DATA_DIR": str(tmp_path / "gw")}
    environment = {**os.environ, **settings, "STORAGE_ROOT": str(tmp_path / "objects")}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        for line in running.stderr:
            if "listening on" in line:
                break
        assert httpx.get(f"http://127.0.0.1:{unused_tcp_port}/livez", timeout=PATIENCE_S).text == "ok\n"
        second = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (second.returncode, "another gateway" in second.stderr) == (1, True)
        running.terminate()
        assert running.wait(timeout=PATIENCE_S) == 0
