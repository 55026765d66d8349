"""The process that watches a worker in its container: real processes and kills; only the counters are written here."""

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

from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT
from tests.support.workers.edge_client import Client, until, upload
from tests.support.workers.guarded_worker import children, count_kills

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="control groups are Linux's")]


class Guarded:
    """A guarded worker, and its log."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    @property
    def worker(self) -> int:
        """Process id of the worker itself."""
        (child,) = children(self.process.pid)
        return child

    async def reads(self, pattern: str) -> re.Match[str]:
        """The next line of the log that matches."""
        assert self.process.stderr is not None
        async with asyncio.timeout(PATIENCE_S):
            while line := (await self.process.stderr.readline()).decode():
                if found := re.search(pattern, line):
                    return found
        raise AssertionError(f"no line has {pattern!r}")

    async def port(self) -> int:
        return int((await self.reads(r"listening on 127\.0\.0\.1:(\d+)"))[1])

    async def status(self) -> int:
        async with asyncio.timeout(PATIENCE_S):
            assert self.process.stderr is not None
            await self.process.stderr.read()
            return await self.process.wait()


@asynccontextmanager
async def guarded(folder: Path) -> AsyncIterator[Guarded]:
    count_kills(folder, 3)
    variables = {**os.environ, "EDGE_PORT": "0", "EDGE_SCRATCH": str(folder / "scratch")}
    command = (sys.executable, "-m", "tests.support.workers.guarded_worker", str(folder))
    process = await asyncio.create_subprocess_exec(*command, cwd=ROOT, env=variables, stderr=asyncio.subprocess.PIPE)
    try:
        yield Guarded(process)
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def test_a_worker_that_the_kernel_killed_for_memory_starts_again_and_says_so(tmp_path: Path) -> None:
    async with guarded(tmp_path) as it:
        port = await it.port()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
            call = Client(channel).stub.Reconstruct(upload(b"wait"))
            await anext(aiter(call))
            first = it.worker
            count_kills(tmp_path, 4)
            os.kill(first, signal.SIGKILL)
            said = await it.reads("killed the worker")
            assert "1,073,741,824 bytes" in said.string
            assert "LIMIT_EDGE_MEMORY" in said.string
            with pytest.raises(grpc.aio.AioRpcError):
                await anext(aiter(call))
        async with grpc.aio.insecure_channel(f"127.0.0.1:{await it.port()}") as channel:
            assert it.worker != first
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await Client(channel).attached()
            assert refused.value.code() == grpc.StatusCode.NOT_FOUND
            assert str(refused.value.details()).startswith("OUT_OF_MEMORY: ")
        it.process.send_signal(signal.SIGTERM)
        assert await it.status() == 0


async def test_a_worker_that_somebody_else_killed_ends_with_its_guard(tmp_path: Path) -> None:
    async with guarded(tmp_path) as it:
        await it.port()
        os.kill(it.worker, signal.SIGKILL)
        assert await it.status() == 128 + signal.SIGKILL


@pytest.mark.essential
async def test_sigterm_drains_the_worker(tmp_path: Path) -> None:
    async with guarded(tmp_path) as it:
        await it.port()
        it.process.send_signal(signal.SIGTERM)
        await it.reads("draining")
        assert await it.status() == 0


async def test_a_worker_does_not_outlive_its_guard(tmp_path: Path) -> None:
    async with guarded(tmp_path) as it:
        await it.port()
        worker = it.worker
        it.process.kill()
        await it.process.wait()
        await until(lambda: not Path(f"/proc/{worker}").exists() or "\nState:\tZ" in _status(worker))


def _status(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return "\nState:\tZ"
