"""A worker process from its start to its end: SIGTERM, kill -9, and what it leaves behind."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from capture2vr.edge.worker.health import is_alive, is_serving
from tests.support.patience import HANG_S, PATIENCE_S
from tests.support.repository import ROOT
from tests.support.workers.edge_client import Client, leftovers, upload

pytestmark = pytest.mark.slow


class Process:
    """A started worker: its log so far and its address."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self.log = ""

    async def reads(self, pattern: str) -> re.Match[str]:
        """The next line of the log that matches."""
        assert self._process.stderr is not None
        async with asyncio.timeout(PATIENCE_S):
            while line := (await self._process.stderr.readline()).decode():
                self.log += line
                if found := re.search(pattern, line):
                    return found
        raise AssertionError(f"no line has {pattern!r} in:\n{self.log}")

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    async def status(self) -> int:
        assert self._process.stderr is not None
        async with asyncio.timeout(PATIENCE_S):
            self.log += (await self._process.stderr.read()).decode()
            return await self._process.wait()


@asynccontextmanager
async def process(scratch: Path, **settings: object) -> AsyncIterator[Process]:
    variables = {
        f"EDGE_{name.upper()}": str(value) for name, value in {"port": 0, "scratch": scratch, **settings}.items()
    }
    started = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "tests.support.workers.scripted_worker",
        cwd=ROOT,
        env={**os.environ, **variables},
        stderr=-1,
    )
    worker = Process(started)
    try:
        async with asyncio.timeout(HANG_S):
            yield worker
    except TimeoutError:
        raise AssertionError(f"the worker hangs; its log:\n{worker.log}") from None
    finally:
        if started.returncode is None:
            started.kill()
            await started.wait()


@asynccontextmanager
async def connected(worker: Process) -> AsyncIterator[Client]:
    port = (await worker.reads(r"listening on 127\.0\.0\.1:(\d+)"))[1]
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield Client(channel)


async def healthy(client: Client) -> bool:
    answer = await health_pb2_grpc.HealthStub(client.channel).Check(health_pb2.HealthCheckRequest())
    return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)


async def is_live(worker: Process) -> bool:
    (address,) = re.findall(r"listening on (127\.0\.0\.1:\d+)", worker.log)
    return await asyncio.to_thread(is_alive, address)


async def test_sigterm_lets_the_running_job_end_and_hands_the_rest_back(tmp_path: Path) -> None:
    done = tmp_path / "done"
    async with process(tmp_path / "scratch", drain_s=3600) as worker, connected(worker) as client:
        running = client.reconstruct(f"until {done}".encode(), "running")
        await anext(aiter(running))
        queued = client.reconstruct(b"ticks 1", "queued")
        await anext(aiter(queued))
        uploading = client.stub.Reconstruct()
        await uploading.write(next(upload(b"ticks 1", job="uploading")))
        await uploading.initial_metadata()

        worker.signal(signal.SIGTERM)
        handed_back = [event async for event in queued][-1].failure
        assert (handed_back.code, handed_back.retryable) == ("WORKER_DRAINING", True)
        assert await uploading.code() == grpc.StatusCode.UNAVAILABLE
        assert not await healthy(client)
        assert await is_live(worker), "or Kubernetes would kill what it has yet to end"
        assert (await client.worker()).draining
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await client.ended(b"ticks 1", "late")
        assert refused.value.code() == grpc.StatusCode.UNAVAILABLE
        done.touch()
        assert [event async for event in running][-1].HasField("finished")
        assert await worker.status() == 0
    assert leftovers(tmp_path / "scratch") == []
    assert list((tmp_path / "scratch" / "checkpoints").iterdir()) == []


async def test_a_job_that_outlives_the_drain_is_handed_back(tmp_path: Path) -> None:
    async with process(tmp_path, drain_s=0.2, slots=2) as worker, connected(worker) as client:
        calls = [client.reconstruct(b"wait", "willing"), client.reconstruct(b"deaf", "deaf")]
        for call in calls:
            await anext(aiter(call))
        worker.signal(signal.SIGTERM)
        for call in calls:
            ending = [event async for event in call][-1].failure
            assert (ending.code, ending.retryable) == ("WORKER_DRAINING", True)
        assert await worker.status() == 0


async def test_a_second_signal_ends_the_drain(tmp_path: Path) -> None:
    async with process(tmp_path, drain_s=3600) as worker, connected(worker) as client:
        call = client.reconstruct(b"wait")
        await anext(aiter(call))
        worker.signal(signal.SIGINT)
        await worker.reads("draining")
        worker.signal(signal.SIGINT)
        assert [event async for event in call][-1].failure.code == "WORKER_DRAINING"
        assert await worker.status() == 0


async def test_a_start_clears_what_a_kill_left(tmp_path: Path) -> None:
    async with process(tmp_path) as worker, connected(worker) as client:
        await anext(aiter(client.reconstruct(b"wait")))
        worker.signal(signal.SIGKILL)
        assert await worker.status() == -signal.SIGKILL
    assert len(leftovers(tmp_path)) == 1
    async with process(tmp_path) as worker, connected(worker):
        assert leftovers(tmp_path) == []


async def test_a_checkpoint_outlives_a_kill_and_a_drain(tmp_path: Path) -> None:
    kept = tmp_path / "checkpoints" / "job_1"
    for number, after in ((signal.SIGKILL, "1"), (signal.SIGTERM, "2")):
        async with process(tmp_path, drain_s=0) as worker, connected(worker) as client:
            await anext(aiter(client.reconstruct(b"wait", fence=int(after))))
            worker.signal(number)
            await worker.status()
        assert [path.name for path in kept.iterdir()] == [f"{after}.checkpoint"]


async def test_workers_may_share_a_scratch(tmp_path: Path) -> None:
    async with process(tmp_path) as first, connected(first) as client:
        await anext(aiter(client.reconstruct(b"wait")))
        async with process(tmp_path) as second, connected(second):
            assert len(leftovers(tmp_path)) == 1
            second.signal(signal.SIGTERM)
            assert await second.status() == 0
        assert len(leftovers(tmp_path)) == 1


async def test_two_workers_do_not_share_a_port(tmp_path: Path) -> None:
    async with process(tmp_path) as first:
        port = (await first.reads(r"listening on 127\.0\.0\.1:(\d+)"))[1]
        async with process(tmp_path, port=port) as second:
            assert await second.status() == 1
            assert f"cannot listen on 127.0.0.1:{port}: choose another EDGE_HOST or EDGE_PORT" in second.log


async def test_an_address_that_others_reach_needs_a_token_or_an_open_worker(tmp_path: Path) -> None:
    async with process(tmp_path, host="0.0.0.0") as worker:
        assert await worker.status() == 1
        assert "EDGE_HOST=0.0.0.0: everybody who reaches this address could run jobs" in worker.log
    async with process(tmp_path, host="0.0.0.0", open="true") as worker:
        await worker.reads("listening on")
        await worker.reads("EDGE_OPEN: everybody who reaches 0.0.0.0 may run jobs")


async def test_a_worker_listens_on_a_socket_of_the_file_system(tmp_path: Path) -> None:
    address = f"unix:{tmp_path / 'edge.sock'}"
    for _ in range(2):  # the first one's socket is left, as by a kill
        async with process(tmp_path, host=address) as worker:
            await worker.reads(f"listening on {address}")
            assert await asyncio.to_thread(is_serving, address)
