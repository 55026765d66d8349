"""A worker in this process and the calls that a gateway makes on it."""

from __future__ import annotations

import asyncio
import hashlib
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report, Work
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.server import EdgeServer
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.order.photo_box import PhotoBox
from tests.support.patience import PATIENCE_S

TICK_S = 0.02


class Scripted:
    """Work whose job is what the archive's bytes say: "ticks 3", "wait" (for `release`), "deaf" (hears nothing),
    "until /some/file" (is there), ...

    "keep x" leaves the checkpoint "x" and fails for now; `found` is the checkpoint that each job began with.
    """

    offer = Capabilities(
        "cpu, 2 cores",
        (
            pb.Preset(name="draft", summary="quick", memory_bytes=1 << 28),
            pb.Preset(name="fine", summary="slow", trained=True, memory_bytes=1 << 30),
        ),
        memory_bytes=1 << 30,
        withheld=(pb.Preset(name="scene", trained=True, memory_bytes=1 << 34),),
    )

    def __init__(self, **acts: Callable[[], object]) -> None:
        self.release = threading.Event()
        self.seen: dict[str, ReconstructionRequest] = {}
        self.found: dict[str, str] = {}
        self._acts = acts

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        self.seen[request.job] = request
        self.found[request.job] = checkpoint.read_text() if checkpoint.exists() else ""
        (scratch / "leftover.bin").write_bytes(b"x")
        word, *rest = archive.read_bytes().decode().split()
        match word:
            case "ticks":
                for done in range(int(rest[0])):
                    report(pb.Progress(stage=pb.POINT_CLOUD + done, fraction=done / int(rest[0])))
            case "fractions":
                for place, fraction in enumerate(rest):
                    report(pb.Progress(stage=pb.VALIDATING + place, fraction=float(fraction)))
            case "wait":
                checkpoint.write_text("waited")
                report(pb.Progress(stage=pb.FITTING, fraction=0.5, message="waiting"))
                while not self.release.wait(TICK_S):
                    report(pb.Progress(stage=pb.FITTING, fraction=0.5))
            case "keep":
                checkpoint.write_text(rest[0])
                raise EdgeError("STORE_UNAVAILABLE", "no store", retryable=True)
            case "until":
                report(pb.Progress(stage=pb.FITTING, fraction=0.5))
                while not Path(*rest).exists():
                    self.release.wait(TICK_S)
            case "deaf":
                report(pb.Progress(stage=pb.FITTING, fraction=0.5))
                self.release.wait(30)
            case act:
                self._acts[act]()
        report(pb.Published(asset_key=request.asset_key, version=1, state="preview", manifest="m"))
        return pb.Finished(warnings=["one"], seconds={"FITTING": 1.5})

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        if (text := archive.read_bytes().decode(errors="replace")) in self._acts:
            self._acts[text]()
        while text == "linger" and not self.release.wait(TICK_S):
            tick(0.0)
        return pb.Inspection(kind="points", format="ply", points=len(text))


class Client:
    """The gateway's side of the wire."""

    def __init__(self, channel: grpc.aio.Channel) -> None:
        self.stub = edge_pb2_grpc.EdgeReconstructionStub(channel)
        self.channel = channel

    def reconstruct(self, archive: bytes, job: str = "job_1", **header: object) -> grpc.aio.StreamStreamCall:
        return self.stub.Reconstruct(upload(archive, job=job, **header))

    async def ended(self, archive: bytes, job: str = "job_1", **header: object) -> list[pb.Event]:
        return [event async for event in self.reconstruct(archive, job, **header)]

    def attach(self, job: str = "job_1", after_seq: int = 0, token: str = "") -> grpc.aio.UnaryStreamCall:
        return self.stub.Attach(pb.AttachRequest(job=job, after_seq=after_seq, token=token))

    async def attached(self, job: str = "job_1", after_seq: int = 0) -> list[pb.Event]:
        return [event async for event in self.attach(job, after_seq)]

    async def cancel(self, job: str = "job_1", token: str = "") -> bool:
        return (await self.stub.Cancel(pb.CancelRequest(job=job, token=token))).was_running

    async def make_room(self, job: str = "job_1", token: str = "") -> bool:
        return (await self.stub.Yield(pb.YieldRequest(job=job, token=token))).yields

    async def worker(self) -> pb.Worker:
        return await self.stub.GetWorker(pb.GetWorkerRequest())


def upload(archive: bytes, *, sizes: Iterable[int] = (1 << 18,), **header: object) -> Iterator[pb.Chunk]:
    """A valid upload in chunks of `sizes`, the last of them repeated."""
    yield pb.Chunk(header=header_of(archive, **header))
    yield from data_of(archive, sizes)
    yield trailer_of(archive)


def header_of(archive: bytes, **fields: object) -> pb.Header:
    return pb.Header(**{"job": "job_1", "fence": 1, "asset_key": "dress", "capture_bytes": len(archive), **fields})


def data_of(archive: bytes, sizes: Iterable[int] = (1 << 18,)) -> Iterator[pb.Chunk]:
    offset, sizes, size = 0, iter(sizes), 1
    while offset < len(archive):
        size = next(sizes, size)
        yield pb.Chunk(data=pb.Data(offset=offset, data=archive[offset : offset + size]))
        offset += size


def trailer_of(archive: bytes) -> pb.Chunk:
    return pb.Chunk(trailer=pb.Trailer(sha256=hashlib.sha256(archive).digest()))


@asynccontextmanager
async def worker(work: Work, scratch: Path, **settings: object) -> AsyncIterator[Client]:
    """A listening worker, drained in a hurry at the end."""
    hurry = asyncio.Event()
    hurry.set()
    place = Scratch(scratch)
    with place.claim():
        server = EdgeServer(EdgeSettings(port=0, scratch=scratch, **settings), work, place)
        port = await server.start()
        try:
            async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
                yield Client(channel)
        finally:
            await server.drain(hurry)


def leftovers(scratch: Path) -> list[str]:
    """What lies in the scratch of all workers, except their locks."""
    return [path.name for path in scratch.glob("worker-*/*") if path.name != ".lock"]


async def until(holds: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
    """Wait for a condition; a test that waits in vain fails here."""
    async with asyncio.timeout(within_s):
        while not holds():
            await asyncio.sleep(0.01)
