"""Pretend workers for the bench `dispatch`: many gRPC servers of one slot each in one process; a run is a pause.

They speak the wire of real workers, and write down which job came to whom and when, and when its slot was free again.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, TextIO

import grpc

import capture2vr
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc

PRESET = "draft"
SHORT = "single"  # keys of jobs whose runs take no time begin so


class Pauses:
    """How long a run takes: about `mean_s` seconds, and none once `skip` was called."""

    def __init__(self, mean_s: float) -> None:
        self._mean_s = mean_s
        self._chance = random.Random(0)
        self._skipped = asyncio.Event()

    def skip(self) -> None:
        """End all runs now, and every later one at once."""
        self._skipped.set()

    async def take(self) -> None:
        """Wait for the end of a run."""
        try:
            await asyncio.wait_for(self._skipped.wait(), self._mean_s * self._chance.uniform(0.5, 1.5))
        except TimeoutError:
            return


class PretendWorker(edge_pb2_grpc.EdgeReconstructionServicer):
    """A worker of one slot."""

    def __init__(self, number: int, pauses: Pauses, log: TextIO) -> None:
        self._number, self._pauses, self._log = number, pauses, log
        self._job = ""

    async def GetWorker(self, _: pb.GetWorkerRequest, __: Any) -> pb.Worker:  # noqa: N802 - gRPC's name
        """What a worker says of itself."""
        jobs = [self._job] if self._job else []
        presets = [pb.Preset(name=PRESET)]
        free = 0 if jobs else 1
        return pb.Worker(version=capture2vr.__version__, presets=presets, slots=1, free_slots=free, jobs=jobs)

    async def Reconstruct(  # noqa: N802
        self, chunks: AsyncIterator[pb.Chunk], context: Any
    ) -> AsyncIterator[pb.Event]:
        """Take a job, pause, and say that it is done."""
        header = (await anext(aiter(chunks))).header
        began = time.time()
        if self._job:
            await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, "BUSY: the slot is taken")
        self._job = header.job
        try:
            await context.send_initial_metadata(())
            async for chunk in chunks:
                if chunk.HasField("trailer"):
                    break
            if not header.asset_key.startswith(SHORT):
                await self._pauses.take()
        finally:
            self._job = ""
            run = {"worker": self._number, "job": header.job, "began": began, "ended": time.time()}
            self._log.write(json.dumps(run) + "\n")
        published = pb.Published(asset_key=header.asset_key, version=1, state="refined", manifest="none")
        yield pb.Event(job=header.job, seq=1, published=published)
        yield pb.Event(job=header.job, seq=2, finished=pb.Finished())

    async def Attach(self, _: pb.AttachRequest, context: Any) -> AsyncIterator[pb.Event]:  # noqa: N802
        """No run is remembered."""
        await context.abort(grpc.StatusCode.NOT_FOUND, "UNKNOWN: there is no such job here")
        yield pb.Event()


async def serve(count: int, mean_s: float, log: Path) -> None:
    """Serve until SIGTERM; prints the ports. SIGUSR1 ends the pauses."""
    pauses, stop = Pauses(mean_s), asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGUSR1, pauses.skip)
    loop.add_signal_handler(signal.SIGTERM, stop.set)
    with log.open("w", buffering=1) as file:
        servers, ports = [], []
        for number in range(count):
            server = grpc.aio.server()
            edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(  # type: ignore[no-untyped-call]
                PretendWorker(number, pauses, file), server
            )
            ports.append(server.add_insecure_port("127.0.0.1:0"))
            await server.start()
            servers.append(server)
        print(json.dumps(ports), flush=True)
        await stop.wait()
        await asyncio.gather(*(server.stop(0) for server in servers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("mean_s", type=float)
    parser.add_argument("log", type=Path)
    options = parser.parse_args()
    asyncio.run(serve(options.count, options.mean_s, options.log))
