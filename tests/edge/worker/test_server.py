"""The worker on the wire: slots and queue, attach, cancel, failures, health."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.worker import event_log
from capture2vr.edge.worker import job_queue as runs_module
from capture2vr.edge.worker.checkpoint_files import CheckpointFiles
from capture2vr.edge.worker.job_request import RefusedError
from capture2vr.edge.worker.server import SERVICE
from tests.support.patience import CANCEL_S, PATIENCE_S
from tests.support.workers.edge_client import Client, Scripted, leftovers, until, upload, worker


def raising(error: BaseException) -> Callable[[], None]:
    def act() -> None:
        raise error

    return act


@pytest.fixture
def work() -> Scripted:
    return Scripted(
        empty=raising(CaptureError("CAPTURE_EMPTY", "no points", file="a.ply", hints=("send points",))),
        busy=raising(EdgeError("STORE_UNAVAILABLE", "no store", retryable=True)),
        memory=raising(MemoryError()),
        full=raising(OSError(28, "No space left on device")),
        bug=raising(KeyError("/secret/path")),
        half=raising(CaptureError("CAPTURE_EMPTY", "has no \ud800.png", file="\ud800.json", hints=("send \udfff",))),
        exit=raising(SystemExit(3)),
    )


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    return tmp_path / "scratch"


@pytest.fixture
async def client(work: Scripted, scratch: Path) -> AsyncIterator[Client]:
    async with worker(work, scratch, slots=1, queue=1) as client:
        yield client
        work.release.set()


async def status_of(call: AsyncIterator[pb.Event]) -> grpc.StatusCode:
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        async for _ in call:
            pass
    code: grpc.StatusCode = refused.value.code()
    return code


async def waiting(client: Client, job: str = "job_1", **header: object) -> grpc.aio.StreamStreamCall:
    """A job that holds its slot until released: its stream, past the first event."""
    call = client.reconstruct(b"wait", job, **header)
    await anext(aiter(call))
    return call


async def queued(client: Client, job: str) -> grpc.aio.StreamStreamCall:
    """A job that waits for a slot: its stream, past the event that says so."""
    call = client.reconstruct(b"ticks 1", job)
    assert "number 1 in the queue" in (await anext(aiter(call))).progress.message
    return call


async def test_a_job_runs_to_its_end(client: Client, work: Scripted, scratch: Path) -> None:
    events = await client.ended(b"ticks 3", preset="fine", cut="object", fence=7)
    assert [event.seq for event in events] == list(range(1, len(events) + 1))
    assert {event.job for event in events} == {"job_1"}
    assert [event.elapsed_s for event in events] == sorted(event.elapsed_s for event in events)
    assert [event.WhichOneof("what") for event in events] == ["progress"] * 3 + ["published", "finished"]
    assert events[-1].finished == pb.Finished(warnings=["one"], seconds={"FITTING": 1.5})
    seen = work.seen["job_1"]
    options = seen.options
    assert (options.preset, options.cut, seen.fence, options.names.label) == ("fine", "object", 7, "dress")
    assert leftovers(scratch) == []


@pytest.mark.parametrize(
    ("header", "cut", "longest_m"),
    [({}, "", None), ({"cut": "scene", "longest_m": 0.31}, "scene", 0.31)],
)
async def test_what_was_left_open_stays_open(
    client: Client, work: Scripted, header: dict[str, object], cut: str, longest_m: float | None
) -> None:
    await client.ended(b"ticks 1", **header)
    options = work.seen["job_1"].options
    assert (options.cut, options.longest_m) == (cut, longest_m)


async def test_the_fraction_never_goes_back(client: Client) -> None:
    events = await client.ended(b"fractions 0.2 0.1 nan 7 0.5 -1")
    assert [event.progress.fraction for event in events[:6]] == [0.2, 0.2, 0.2, 0.2, 0.5, 0.5]


async def test_the_time_left_follows_from_the_fraction(client: Client) -> None:
    events = await client.ended(b"fractions 0.01 0.5")
    assert events[0].progress.eta_s == 0
    assert 0 < events[1].progress.eta_s <= events[1].elapsed_s


@pytest.mark.parametrize(
    ("act", "code", "retryable"),
    [
        ("empty", "CAPTURE_EMPTY", False),
        ("busy", "STORE_UNAVAILABLE", True),
        ("memory", "OUT_OF_MEMORY", False),
        ("full", "SCRATCH_FULL", True),
        ("bug", "INTERNAL", False),
        ("exit", "INTERNAL", False),
    ],
)
async def test_every_failure_has_a_name(client: Client, scratch: Path, act: str, code: str, retryable: bool) -> None:
    ending = (await client.ended(act.encode()))[-1].failure
    assert (ending.code, ending.retryable) == (code, retryable)
    assert "/" not in ending.message
    assert leftovers(scratch) == []
    assert (await client.worker()).free_slots == 1


async def test_a_failure_says_where_and_what_to_do(client: Client) -> None:
    ending = (await client.ended(b"empty"))[-1].failure
    assert ending == pb.Failure(code="CAPTURE_EMPTY", message="no points", file="a.ply", hints=["send points"])


async def test_a_name_that_no_message_can_hold_is_told_as_far_as_possible(client: Client) -> None:
    """Half a surrogate pair, which JSON can encode: protobuf refuses it."""
    async with asyncio.timeout(PATIENCE_S):
        failed = (await client.ended(b"half"))[-1].failure
        inspected = (await client.stub.Inspect(upload(b"half"))).failure
    for each in (failed, inspected):
        assert (each.message, each.file, list(each.hints)) == ("has no ?.png", "?.json", ["send ?"])


async def test_a_run_ends_though_its_files_cannot_be_removed(
    client: Client, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(CheckpointFiles, "drop", refuse)
    async with asyncio.timeout(PATIENCE_S):
        assert (await client.ended(b"ticks 1"))[-1].HasField("finished")
    assert any(record.exc_info and "job_1" in record.getMessage() for record in caplog.records)
    monkeypatch.undo()
    assert (await client.ended(b"ticks 1", "next"))[-1].HasField("finished"), "its slot is free"


async def test_an_unforeseen_error_is_logged_with_its_traceback(
    client: Client, caplog: pytest.LogCaptureFixture
) -> None:
    await client.ended(b"bug")
    assert any(record.exc_info and "job_1" in record.getMessage() for record in caplog.records)


async def test_queue_full_is_resource_exhausted(client: Client, work: Scripted) -> None:
    running = await waiting(client, "running")
    second = await queued(client, "second")
    state = await client.worker()
    assert (state.free_slots, state.queued, list(state.jobs)) == (0, 1, ["running", "second"])
    assert await status_of(client.reconstruct(b"ticks 1", "third")) == grpc.StatusCode.RESOURCE_EXHAUSTED
    work.release.set()
    assert [event async for event in second][-1].HasField("finished")
    assert [event async for event in running][-1].HasField("finished")
    assert (await client.worker()).free_slots == 1


async def test_a_live_job_is_not_taken_twice(client: Client) -> None:
    await waiting(client, fence=1)
    assert await status_of(client.reconstruct(b"wait", fence=1)) == grpc.StatusCode.ALREADY_EXISTS
    assert await status_of(client.reconstruct(b"wait", fence=2)) == grpc.StatusCode.ALREADY_EXISTS


async def test_a_finished_job_is_not_taken_again(client: Client) -> None:
    await client.ended(b"ticks 1", fence=1)
    assert await status_of(client.reconstruct(b"ticks 1", fence=2)) == grpc.StatusCode.ALREADY_EXISTS


async def test_a_failed_job_may_be_tried_again_under_a_newer_lease_only(client: Client) -> None:
    await client.ended(b"busy", fence=1)
    assert await status_of(client.reconstruct(b"ticks 1", fence=1)) == grpc.StatusCode.ALREADY_EXISTS
    assert (await client.ended(b"ticks 1", fence=2))[-1].HasField("finished")
    assert (await client.attached())[-1].HasField("finished")


async def test_a_client_that_leaves_does_not_stop_its_job(client: Client, work: Scripted) -> None:
    call = await waiting(client)
    call.cancel()
    first, second = client.attach(), client.attach()
    assert (await anext(aiter(first))).seq == (await anext(aiter(second))).seq == 1
    work.release.set()
    endings = [[event async for event in call][-1] for call in (first, second)]
    assert endings[0] == endings[1]
    assert endings[0].HasField("finished")


async def test_attach_replays_what_was_said(client: Client) -> None:
    events = await client.ended(b"ticks 4")
    assert await client.attached() == events
    assert await client.attached(after_seq=2) == events[2:]
    assert await client.attached(after_seq=len(events)) == []
    assert await status_of(client.attach(after_seq=len(events) + 1)) == grpc.StatusCode.OUT_OF_RANGE
    assert await status_of(client.attach("other")) == grpc.StatusCode.NOT_FOUND


async def test_cancel_ends_a_running_job(client: Client, scratch: Path) -> None:
    call = await waiting(client)
    assert await client.cancel()
    ending = [event async for event in call][-1].failure
    assert (ending.code, ending.stage, ending.retryable) == ("CANCELLED", pb.FITTING, False)
    assert not await client.cancel()
    assert not await client.cancel("other")
    assert leftovers(scratch) == []
    assert (await client.ended(b"ticks 1", "next"))[-1].HasField("finished")


async def test_what_was_published_as_the_job_was_cancelled_is_told(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The version is in the catalogue, and the cancellation came too late for it."""
    monkeypatch.setattr(runs_module, "GIVE_UP_S", PATIENCE_S)
    call = client.reconstruct(f"until {tmp_path / 'stored'}".encode())
    await anext(aiter(call))
    assert await client.cancel()
    (tmp_path / "stored").touch()
    published, ending = [event async for event in call][-2:]
    assert published.published.asset_key == "dress"
    assert ending.failure.code == "CANCELLED"


async def test_a_job_is_shown_and_stopped_by_its_token_only(client: Client) -> None:
    call = await waiting(client, token="right")
    for wrong in ("", "wrong", "right "):
        assert await status_of(client.attach(token=wrong)) == grpc.StatusCode.NOT_FOUND
        assert not await client.cancel(token=wrong)
    assert (await anext(aiter(client.attach(token="right")))).seq == 1
    assert await client.cancel(token="right")
    assert [event async for event in call][-1].failure.code == "CANCELLED"


async def test_cancel_ends_a_queued_job(client: Client, scratch: Path) -> None:
    await waiting(client, "running")
    second = await queued(client, "second")
    assert await client.cancel("second")
    assert [event async for event in second][-1].failure.code == "CANCELLED"
    assert (await client.worker()).queued == 0
    assert len(leftovers(scratch)) == 1


@pytest.mark.slow
async def test_cancel_frees_the_slot_of_a_thread_that_does_not_listen(
    client: Client, work: Scripted, scratch: Path
) -> None:
    call = client.reconstruct(b"deaf", "deaf")
    await anext(aiter(call))
    assert await client.cancel("deaf")
    async with asyncio.timeout(CANCEL_S):
        ended = [event async for event in call]
        assert (await client.worker()).free_slots == 1
    assert [event.failure.code for event in ended] == ["CANCELLED"]
    assert (await client.ended(b"ticks 1", "next"))[-1].HasField("finished")
    work.release.set()
    await until(lambda: leftovers(scratch) == [])
    assert (await client.attached("deaf"))[-1] == ended[-1]  # what it published after its end was not heard


async def test_a_refusal_while_the_upload_is_being_admitted_reaches_the_caller(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    received = runs_module._PendingUpload.received

    async def cancelled_meanwhile(upload: runs_module._PendingUpload) -> None:
        for _ in range(2):  # turns of the event loop: after them the initial metadata is on its way
            await asyncio.sleep(0)
        upload.refuse(RefusedError(grpc.StatusCode.ABORTED, "FENCE_STALE", "a newer lease uploads the job"))
        await received(upload)

    monkeypatch.setattr(runs_module._PendingUpload, "received", cancelled_meanwhile)
    async with asyncio.timeout(PATIENCE_S):
        assert await status_of(client.reconstruct(b"ticks 1")) == grpc.StatusCode.ABORTED


@pytest.mark.slow
async def test_silence_is_filled_with_heartbeats(client: Client) -> None:
    call = client.reconstruct(b"deaf")
    await anext(aiter(call))
    async with asyncio.timeout(PATIENCE_S):
        beat = await anext(aiter(call))
    assert beat.HasField("heartbeat")
    assert beat.seq == 2


async def test_ended_runs_are_kept_in_bounds(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs_module, "KEEP_ENDED", 2)
    for job in ("first", "second", "third"):
        await client.ended(b"ticks 1", job)
    assert await status_of(client.attach("first")) == grpc.StatusCode.NOT_FOUND
    assert (await client.attached("second"))[-1].HasField("finished")


async def test_ended_runs_are_forgotten_in_time(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs_module, "KEEP_ENDED_S", 0.05)
    await client.ended(b"ticks 1")
    await asyncio.sleep(0.2)
    assert await status_of(client.attach()) == grpc.StatusCode.NOT_FOUND


async def test_the_worker_is_healthy(client: Client) -> None:
    stub = health_pb2_grpc.HealthStub(client.channel)
    for name in ("", SERVICE):
        answer = await stub.Check(health_pb2.HealthCheckRequest(service=name))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING


async def test_reflection_only_behind_its_setting(client: Client, scratch: Path) -> None:
    from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

    asked = [reflection_pb2.ServerReflectionRequest(list_services="")]
    stub = reflection_pb2_grpc.ServerReflectionStub(client.channel)
    assert await status_of(stub.ServerReflectionInfo(iter(asked))) == grpc.StatusCode.UNIMPLEMENTED
    async with worker(Scripted(), scratch.with_name("other"), reflection=True) as open_client:
        stub = reflection_pb2_grpc.ServerReflectionStub(open_client.channel)
        answers = [answer async for answer in stub.ServerReflectionInfo(iter(asked))]
    assert SERVICE in {service.name for service in answers[0].list_services_response.service}


async def test_the_worker_describes_itself(client: Client) -> None:
    state = await client.worker()
    assert (state.slots, state.device, state.draining) == (1, "cpu, 2 cores", False)
    assert [(preset.name, preset.trained, preset.memory_bytes) for preset in state.presets] == [
        ("draft", False, 1 << 28),
        ("fine", True, 1 << 30),
    ]
    assert state.memory_bytes == 1 << 30
    assert state.version


async def test_inspect_gives_a_verdict(client: Client, scratch: Path) -> None:
    assert await client.stub.Inspect(upload(b"hello", job="")) == pb.Inspection(kind="points", format="ply", points=5)
    failure = (await client.stub.Inspect(upload(b"empty"))).failure
    assert (failure.code, failure.file, failure.stage) == ("CAPTURE_EMPTY", "a.ply", pb.VALIDATING)
    assert (await client.stub.Inspect(upload(b"bug"))).failure.code == "INTERNAL"
    assert leftovers(scratch) == []


async def test_whatever_callers_do_every_job_ends_once_and_leaves_nothing(scratch: Path) -> None:
    rng = random.Random(0)
    work = Scripted()

    async def caller(client: Client, job: str) -> None:
        call = client.reconstruct(f"pause {rng.uniform(0, 0.05)}".encode(), job)
        if rng.random() < 0.3:
            await asyncio.sleep(rng.uniform(0, 0.05))
            call.cancel()
        if rng.random() < 0.3:
            await client.cancel(job)
        with suppress(grpc.aio.AioRpcError, asyncio.CancelledError):
            async for _ in call:
                pass

    async with worker(work, scratch, slots=3, queue=60) as client:
        jobs = [f"job_{number}" for number in range(60)]
        await asyncio.gather(*(caller(client, job) for job in jobs))
        async with asyncio.timeout(PATIENCE_S):
            while (await client.worker()).free_slots < 3:
                await asyncio.sleep(0.01)
        ran = [job for job in jobs if job in work.seen]
        for job in ran:
            events = await client.attached(job)
            assert [event.seq for event in events] == list(range(1, len(events) + 1))
            assert [event.seq for event in events if event.HasField("failure") or event.HasField("finished")] == [
                len(events)
            ]
        await until(lambda: leftovers(scratch) == [])
    assert len(ran) > 30


async def test_the_first_preset_is_the_default(client: Client, work: Scripted) -> None:
    await client.ended(b"ticks 1")
    assert work.seen["job_1"].options.preset == "draft"


async def test_a_preset_that_never_fits_is_refused_before_the_upload(client: Client) -> None:
    said = r"MEMORY_EXCEEDED: preset scene .* use one of draft, fine"
    with pytest.raises(grpc.aio.AioRpcError, match=said) as refused:
        await client.ended(b"ticks 1", preset="scene")
    assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT


async def test_a_job_that_runs_again_finds_its_checkpoint(client: Client, work: Scripted, scratch: Path) -> None:
    await client.ended(b"keep half-way", fence=1)
    assert work.found["job_1"] == ""
    await client.ended(b"ticks 1", fence=2)
    assert work.found["job_1"] == "half-way"
    assert list((scratch / "checkpoints").iterdir()) == []


async def test_a_cancelled_job_leaves_no_checkpoint(client: Client, scratch: Path) -> None:
    call = await waiting(client)
    assert list(scratch.glob("checkpoints/job_1/*"))
    assert await client.cancel()
    assert [event async for event in call][-1].failure.code == "CANCELLED"
    await until(lambda: not list(scratch.glob("checkpoints/*")))


async def test_a_job_yields_its_slot_at_a_checkpoint_and_goes_on_from_it(client: Client, work: Scripted) -> None:
    call = await waiting(client, token="secret")
    behind = await queued(client, "job_2")
    assert not await client.make_room(token="guess")
    assert not await client.make_room("job_2", "secret"), "it waits itself"
    assert await client.make_room(token="secret")
    assert [event async for event in call][-1].failure.code == "JOB_YIELDED"
    work.release.set()
    assert [event async for event in behind][-1].HasField("finished")
    assert (await client.ended(b"wait", token="secret", fence=2))[-1].HasField("finished")
    assert work.found["job_1"] == "waited"


async def test_a_job_without_a_checkpoint_does_not_yield(client: Client, work: Scripted) -> None:
    call = client.reconstruct(b"deaf")
    async for event in call:
        if event.HasField("progress"):
            break
    assert not await client.make_room()
    work.release.set()
    assert (await client.attached())[-1].HasField("finished")


async def test_the_time_left_follows_the_recent_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(event_log.time, "monotonic", lambda: now[0])
    log = event_log.EventLog("job_1")
    said = []
    # A fit that jumps ahead to its checkpoint, and then does a hundredth a second.
    for step in range(31):
        log.add(pb.Progress(stage=pb.FITTING, fraction=0.5 + step / 100))
        now[0] += 1.0
    log.end(pb.Finished())
    async for event in log.follow():
        said.append(event.progress.eta_s)
    assert said[0] == 0.0 or said[0] < 1.0, "the jump promises the end"
    assert said[-2] == pytest.approx(20.0, abs=0.5)


async def test_an_inspection_ends_when_its_caller_leaves(client: Client, scratch: Path) -> None:
    call = client.stub.Inspect(upload(b"linger"))
    async with asyncio.timeout(PATIENCE_S):
        while not any(scratch.rglob("work")):
            await asyncio.sleep(0.02)
        call.cancel()
        while any(scratch.rglob("capture.zip")):
            await asyncio.sleep(0.02)
