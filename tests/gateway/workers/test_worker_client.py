"""What the gateway asks of a worker, and what it makes of silence."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.cli.up import free_port
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.job import Job, Lease, Order
from capture2vr.gateway.jobs.reports import AnchorsFound, Report, RunFinished, RunHeartbeat, VersionPublished
from capture2vr.gateway.workers import worker_client
from capture2vr.gateway.workers.worker_client import WorkerPool, _header, _report
from capture2vr.gateway.workers.worker_types import RunKnown, RunUnknown, WorkerBusy, WorkerUnreachable
from capture2vr.order.edits import Edits
from capture2vr.order.job_options import JobOptions
from capture2vr.order.photo_box import PhotoBox
from tests.support.in_process_gateway import Making, memory, worker

_NOBODY = "127.0.0.1:9"


@asynccontextmanager
async def pool(tmp_path: Path, *others: str, **settings: int) -> AsyncIterator[tuple[WorkerPool, str, Making]]:
    """A pool of one worker (and addresses where nobody is); its address and its work."""
    work = Making(memory())
    async with AsyncExitStack() as stack:
        port = await stack.enter_async_context(worker(work, tmp_path / "edge", **settings))
        made = WorkerPool((*others, f"127.0.0.1:{port}"))
        stack.push_async_callback(made.close)
        yield made, f"127.0.0.1:{port}", work


def job(name: str = "job_1", preset: str = "draft") -> Job:
    return Job(name, Order("cap_1", "dress", JobOptions(preset)), created=0, updated=0, lease=Lease(fence=1))


async def chunks(archive: bytes, size: int = 7) -> AsyncIterator[bytes]:
    for start in range(0, len(archive), size):
        yield archive[start : start + size]


def written(tmp_path: Path, **script: object) -> Path:
    path = tmp_path / "capture.zip"
    path.write_bytes(json.dumps(script).encode())
    return path


async def test_a_verdict_comes_from_a_worker(tmp_path: Path) -> None:
    spent: list[float] = []
    async with pool(tmp_path, _NOBODY) as (workers, _, _):
        verdict = await workers.inspect(written(tmp_path, points=123), None, spent.append)
        assert (verdict.kind, verdict.format, verdict.points, verdict.warnings) == ("points", "ply", 123, ("sparse",))
        assert verdict.failure is None
        refused = await workers.inspect(written(tmp_path, fail="CAPTURE_DEGENERATE"), None, spent.append)
    assert len(spent) == 2
    assert refused.failure is not None
    assert refused.failure.document() == {
        "type": "urn:capture2vr:problem:CAPTURE_DEGENERATE",
        "title": "Unprocessable Entity",
        "status": 422,
        "detail": "as it was told",
        "code": "CAPTURE_DEGENERATE",
        "retryable": False,
        "stage": "VALIDATING",
        "file": "a.ply",
        "hints": ["hold still"],
    }


async def test_an_inspection_waits_for_a_worker_that_comes(tmp_path: Path) -> None:
    port = free_port()
    workers = WorkerPool((f"127.0.0.1:{port}",))
    inspecting = asyncio.create_task(workers.inspect(written(tmp_path, points=123), None, list[float]().append))
    await asyncio.sleep(0.2)
    async with worker(Making(memory()), tmp_path / "scratch", port=port):
        assert (await inspecting).points == 123
        await workers.close()


async def test_without_a_worker_an_inspection_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_client, "_INSPECTOR_S", 0.0)
    workers = WorkerPool((_NOBODY,))
    with pytest.raises(Problem, match="no worker") as caught:
        await workers.inspect(written(tmp_path), None, list[float]().append)
    assert (caught.value.status, caught.value.code) == (503, "INSPECTION_UNAVAILABLE")
    await workers.close()


async def test_workers_that_answer_are_known_with_their_presets(tmp_path: Path) -> None:
    async with pool(tmp_path, _NOBODY, slots=3) as (workers, address, _):
        (status,) = await workers.poll()
        assert (status.address, status.slots, status.free_slots, status.queued) == (address, 3, 3, 0)
        assert list(workers.presets) == ["draft", "fine"]
        assert "fine" in status.preset_names
        assert "scene" not in status.preset_names


async def test_a_run_is_reported_to_its_end_and_can_be_heard_again(tmp_path: Path) -> None:
    archive = json.dumps({"steps": 2}).encode()
    async with pool(tmp_path) as (workers, address, _):
        told = [report async for report in workers.reconstruct(address, job(), chunks(archive), len(archive))]
        assert isinstance(told[-1], RunFinished)
        assert [report.seq for report in told] == list(range(1, len(told) + 1))
        assert [report.state for report in told if isinstance(report, VersionPublished)] == ["preview", "refined"]
        assert [report async for report in workers.follow(address, job(), 2, 0.0)] == told[2:]
        with pytest.raises(RunKnown):
            _ = [report async for report in workers.reconstruct(address, job(), chunks(archive), len(archive))]
        assert await workers.cancel(address, job()) is False


class Hanging(edge_pb2_grpc.EdgeReconstructionServicer):
    """A worker whose first stream of events falls silent in its middle, as when its machine is moved."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    async def Attach(self, request: pb.AttachRequest, context: Any) -> AsyncIterator[pb.Event]:  # noqa: N802
        self.asked.append(request.after_seq)
        yield pb.Event(job=request.job, seq=request.after_seq + 1, heartbeat=pb.Heartbeat())
        if len(self.asked) == 1:
            await asyncio.sleep(600)
        yield pb.Event(job=request.job, seq=request.after_seq + 2, finished=pb.Finished())


@pytest.mark.slow
async def test_a_stream_that_falls_silent_is_opened_again_however_long_that_took_to_notice() -> None:
    server, hanging = grpc.aio.server(), Hanging()
    edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(hanging, server)
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    await server.start()
    workers = WorkerPool((address,), silence_s=3.0)
    try:
        told = [report async for report in workers.follow(address, job(), 0, 2.0)]
    finally:
        await workers.close()
        await server.stop(0)
    assert isinstance(told[-1], RunFinished)
    assert hanging.asked == [0, 1]


def anchors_of(xyz_m: list[float], rgb: bytes) -> Report:
    return _report(pb.Event(job="job_1", seq=3, anchors=pb.AnchorPoints(xyz_m=xyz_m, rgb=rgb)))


@given(st.lists(st.tuples(*[st.floats(-50, 50, width=32)] * 3, *[st.integers(0, 255)] * 3), min_size=1, max_size=30))
def test_anchor_points_arrive_to_a_tenth_of_a_millimetre(points: list[tuple[float, ...]]) -> None:
    told = anchors_of([value for each in points for value in each[:3]], bytes(c for each in points for c in each[3:]))  # type: ignore[misc]
    assert isinstance(told, AnchorsFound)
    assert told.rgb == tuple(c for each in points for c in each[3:])
    assert told.xyz_m == pytest.approx([value for each in points for value in each[:3]], abs=6e-5)


@pytest.mark.parametrize(
    ("xyz_m", "rgb"),
    [
        ([], b""),
        ([1.0, 2.0], b"\0\0"),
        ([1.0, 2.0, 3.0], b"\0"),
        ([1.0, float("nan"), 3.0], b"\0\0\0"),
        ([1.0, float("inf"), 3.0], b"\0\0\0"),
        ([0.0] * 3_003, b"\0" * 3_003),
    ],
)
def test_anchor_points_that_cannot_be_shown_are_left_out(xyz_m: list[float], rgb: bytes) -> None:
    assert anchors_of(xyz_m, rgb) == RunHeartbeat(3)


def test_the_header_has_what_was_ordered() -> None:
    def header(**options: object) -> pb.Header:
        return _header(replace(job(), order=Order("cap_1", "dress", JobOptions(**options))), 7)

    assert not header().HasField("box")
    box = header(box=PhotoBox(0.25, 0.125, 0.75, 1.0)).box
    assert (box.left, box.top, box.right, box.bottom) == (0.25, 0.125, 0.75, 1.0)
    assert header().edits == ""
    edits = Edits(up=(0.0, 0.0, 1.0), fill="none")
    assert Edits.parse(header(edits=edits).edits) == edits


async def test_refusals_have_names(tmp_path: Path) -> None:
    archive = json.dumps({"wait": 1}).encode()
    async with pool(tmp_path, queue=0) as (workers, address, work):
        with pytest.raises(RunUnknown):
            _ = [report async for report in workers.follow(address, replace(job(), id="job_9"), 0, 0.0)]
        with pytest.raises(Problem) as unknown:
            await anext(workers.reconstruct(address, job(preset="nope"), chunks(archive), len(archive)))
        assert unknown.value.code == "PRESET_UNKNOWN"
        with pytest.raises(WorkerUnreachable):
            await anext(workers.follow(_NOBODY, job(), 0, 0.0))
        running = workers.reconstruct(address, job(), chunks(archive), len(archive))
        await anext(running)
        with pytest.raises(WorkerBusy):
            await anext(workers.reconstruct(address, job("job_2"), chunks(archive), len(archive)))
        work.release.set()
        await running.aclose()


async def test_an_upload_that_cannot_be_read_says_so(tmp_path: Path) -> None:
    async def broken() -> AsyncIterator[bytes]:
        yield b"{"
        raise OSError("the store went away")

    async with pool(tmp_path) as (workers, address, work):
        with pytest.raises(OSError, match="went away"):
            _ = [report async for report in workers.reconstruct(address, job(), broken(), 10)]
        assert work.runs == []


async def test_a_large_archive_arrives_whole(tmp_path: Path) -> None:
    script = json.dumps({"steps": 1}).encode()
    archive = script + b" " * (9 << 20)  # more than one message may hold
    async with pool(tmp_path) as (workers, address, _):
        told = [
            report async for report in workers.reconstruct(address, job(), chunks(archive, 512 << 10), len(archive))
        ]
    assert isinstance(told[-1], RunFinished)
