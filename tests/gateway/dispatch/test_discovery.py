"""Workers behind one name, as `docker compose up --scale edge=3` starts them: found, used alike, and left in peace."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import Callable
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from pydantic import SecretStr

import capture2vr
from tests.support.gateway_process import running
from tests.support.in_process_gateway import (
    Making,
    capture,
    ended,
    gateway,
    job_when,
    memory,
    start,
    until,
    worker,
)
from tests.support.network.tls_certificates import TOKEN, Authority
from tests.support.patience import PATIENCE_S


@contextmanager
def named(monkeypatch: pytest.MonkeyPatch, *addresses: str) -> Any:
    """Let the name "edge" resolve to these addresses, a list that may change meanwhile."""
    found = list(addresses)
    loop_lookup = asyncio.BaseEventLoop.getaddrinfo

    async def look_up(self: Any, host: str, port: Any, **rest: Any) -> Any:
        if host != "edge":
            return await loop_lookup(self, host, port, **rest)
        return [(0, 0, 0, "", (address, port)) for address in found]

    with monkeypatch.context() as patch:
        patch.setattr(asyncio.BaseEventLoop, "getaddrinfo", look_up)
        yield found


async def workers_seen(client: httpx.AsyncClient) -> list[str]:
    answer = (await client.get("/v1/service")).json()
    return [each["address"] for each in answer["workers"]]


async def test_jobs_are_shared_by_all_addresses_of_a_name(
    tmp_path: Path, unused_tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosts = ["127.0.0.2", "127.0.0.3", "127.0.0.4"]
    works = [Making(memory()) for _ in hosts]
    store = memory()
    async with AsyncExitStack() as stack:
        for host, work in zip(hosts, works, strict=True):
            await stack.enter_async_context(worker(work, tmp_path / host, host=host, port=unused_tcp_port, open=True))
        stack.enter_context(named(monkeypatch, *hosts))
        client = await stack.enter_async_context(
            gateway(tmp_path / "gw", store, workers=(f"dns:///edge:{unused_tcp_port}",))
        )
        jobs = [await start(client, capture(store, wait=1), f"key{number}") for number in range(3)]
        for job in jobs:
            await job_when(client, job, lambda found: found["stage"] == "FITTING")
        assert [len(work.runs) for work in works] == [1, 1, 1]
        for work in works:
            work.release.set()
        for job in jobs:
            assert (await ended(client, job))["state"] == "SUCCEEDED"


async def test_a_worker_that_leaves_its_name_ends_its_job_and_gets_no_other(
    tmp_path: Path, unused_tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = memory()
    old, new = Making(memory()), Making(memory())
    async with AsyncExitStack() as stack:
        where: dict[str, Any] = {"port": unused_tcp_port, "open": True}
        await stack.enter_async_context(worker(old, tmp_path / "old", host="127.0.0.2", **where))
        found = stack.enter_context(named(monkeypatch, "127.0.0.2"))
        client = await stack.enter_async_context(
            gateway(tmp_path / "gw", store, workers=(f"dns:///edge:{unused_tcp_port}",))
        )
        job = await start(client, capture(store, wait=1), "first")
        await job_when(client, job, lambda each: each["stage"] == "FITTING")
        await stack.enter_async_context(worker(new, tmp_path / "new", host="127.0.0.3", **where))
        found[:] = ["127.0.0.3"]

        async def moved() -> bool:
            return await workers_seen(client) == [f"edge/127.0.0.3:{unused_tcp_port}"]

        await until(moved)
        other = await start(client, capture(store, "cap_2"), "second")
        assert (await ended(client, other))["state"] == "SUCCEEDED"
        assert (await client.get(f"/v1/jobs/{job}")).json()["stage"] == "FITTING"
        old.release.set()
        done = await ended(client, job)
        assert (done["state"], done["attempts"]) == ("SUCCEEDED", 1)
        assert (len(old.runs), len(new.runs)) == (1, 1)


async def test_the_certificate_is_for_the_name(
    tmp_path: Path, unused_tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, authority = memory(), Authority(tmp_path)
    pair = authority.server(host="edge")
    security = {"tls_cert": pair.cert, "tls_key": pair.key, "token": SecretStr(TOKEN)}
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(
            worker(Making(store), tmp_path / "edge", host="127.0.0.2", port=unused_tcp_port, **security)
        )
        stack.enter_context(named(monkeypatch, "127.0.0.2"))
        way = {"edge_ca": authority.ca, "edge_token": SecretStr(TOKEN)}
        client = await stack.enter_async_context(
            gateway(tmp_path / "gw", store, workers=(f"dns:///edge:{unused_tcp_port}",), **way)
        )
        assert (await ended(client, await start(client, capture(store))))["state"] == "SUCCEEDED"


async def test_a_worker_of_another_version_gets_no_job_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    store = memory()
    work = Making(store)
    async with worker(work, tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        with monkeypatch.context() as patch:
            patch.setattr(capture2vr, "__version__", "0.2.0")  # the worker has read its own before
            job = await start(client, capture(store))
            ready = (await client.get("/readyz")).json()
            assert ready["ready"] is False
            assert ready["checks"]["workers"]["detail"].endswith(f"127.0.0.1:{port} is of version 0.1.0")
            (seen,) = (await client.get("/v1/service")).json()["workers"]
            assert (seen["compatible"], seen["version"]) == (False, "0.1.0")
            assert (await client.get(f"/v1/jobs/{job}")).json()["state"] == "QUEUED"
            assert not work.runs
        assert (await ended(client, job))["state"] == "SUCCEEDED"
    said = [record.getMessage() for record in caplog.records if record.getMessage().startswith("worker ")]
    assert said == [
        f"worker 127.0.0.1:{port} is of version 0.1.0, and this gateway of 0.2.0: it gets no jobs; update the older one"
    ]


def _may_mount() -> bool:
    unshare = shutil.which("unshare")
    return bool(unshare) and subprocess.run([str(unshare), "--mount", "true"], capture_output=True).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not _may_mount(), reason="only root may mount a file over /etc/hosts")
async def test_twelve_jobs_of_a_gateway_process_are_split_alike(
    tmp_path: Path, unused_tcp_port_factory: Callable[[], int]
) -> None:
    edge_port = unused_tcp_port_factory()
    hosts = tmp_path / "hosts"
    addresses = ["127.0.0.2", "127.0.0.3", "127.0.0.4"]
    hosts.write_text("127.0.0.2 edge\n")
    has_hosts = ("unshare", "--mount", "sh", "-c", 'mount --bind "$0" /etc/hosts && exec "$@"', str(hosts))
    async with AsyncExitStack() as stack:
        options = {"workers": f"dns:///edge:{edge_port}", "within": has_hosts, "GATEWAY_PRESETS": "draft,fine"}
        process = stack.enter_context(running(tmp_path, **options))
        store = process.store
        works = [Making(store) for _ in addresses]
        for address, work in zip(addresses, works, strict=True):
            await stack.enter_async_context(worker(work, tmp_path / address, host=address, port=edge_port, open=True))
        client = await stack.enter_async_context(httpx.AsyncClient(base_url=process.url, timeout=PATIENCE_S))

        async def sees(count: int) -> bool:
            return len(await workers_seen(client)) == count

        await until(lambda: sees(1))
        with hosts.open("w") as file:  # in place: a mounted file is not replaced
            file.writelines(f"{address} edge\n" for address in addresses)
        await until(lambda: sees(3))
        name = capture(store, steps=5, pause_s=0.4)
        jobs = [await start(client, name, f"key{number}") for number in range(12)]
        done = [await ended(client, job) for job in jobs]
        assert {job["state"] for job in done} == {"SUCCEEDED"}
    shares = [len(work.runs) for work in works]
    assert sum(shares) == 12
    assert min(shares) >= 3, "4 each; one more or less where the machine is crowded"
