"""The upload on the wire: only whole, unbroken archives with a valid header become jobs."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import shutil
from collections.abc import AsyncIterator, Iterable
from pathlib import Path
from types import ModuleType

import grpc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker import authentication
from capture2vr.edge.worker import upload as upload_module
from capture2vr.edge.worker.job_request import RefusedError
from capture2vr.edge.worker.upload import receive
from tests.support.repository import ROOT
from tests.support.workers.edge_client import (
    Client,
    Scripted,
    data_of,
    header_of,
    leftovers,
    trailer_of,
    until,
    upload,
    worker,
)

ARCHIVE = b"ticks 2"
LIMIT_BYTES = 1_000_000


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    return tmp_path / "scratch"


@pytest.fixture
async def client(scratch: Path) -> AsyncIterator[Client]:
    work = Scripted()
    async with worker(work, scratch, max_capture_bytes=LIMIT_BYTES, queue=0) as client:
        yield client
        work.release.set()


async def refusal(client: Client, chunks: Iterable[pb.Chunk]) -> grpc.aio.AioRpcError:
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        async for _ in client.stub.Reconstruct(iter(chunks)):
            pass
    return refused.value


def head(**fields: object) -> pb.Chunk:
    return pb.Chunk(header=header_of(ARCHIVE, **fields))


def data(offset: int, content: bytes) -> pb.Chunk:
    return pb.Chunk(data=pb.Data(offset=offset, data=content))


CORRUPT = {
    "a gap": [head(), data(0, ARCHIVE[:3]), data(4, ARCHIVE[4:]), trailer_of(ARCHIVE)],
    "an overlap": [head(), data(0, ARCHIVE[:3]), data(2, ARCHIVE[2:]), trailer_of(ARCHIVE)],
    "not from 0": [head(), data(1, ARCHIVE[1:]), trailer_of(ARCHIVE)],
    "out of order": [head(), data(3, ARCHIVE[3:]), data(0, ARCHIVE[:3]), trailer_of(ARCHIVE)],
    "too little": [head(), data(0, ARCHIVE[:-1]), trailer_of(ARCHIVE[:-1])],
    "too much": [head(), data(0, ARCHIVE + b"x"), trailer_of(ARCHIVE + b"x")],
    "another sha256": [head(), data(0, ARCHIVE), trailer_of(b"other")],
    "no sha256": [head(), data(0, ARCHIVE), pb.Chunk(trailer=pb.Trailer())],
    "no trailer": [head(), data(0, ARCHIVE)],
    "an offset past the end of integers": [head(), data(2**64 - 1, ARCHIVE), trailer_of(ARCHIVE)],
}

MALFORMED = {
    "nothing": [],
    "no header": list(data_of(ARCHIVE)),
    "an empty message": [pb.Chunk()],
    "two headers": [head(), head(), *data_of(ARCHIVE), trailer_of(ARCHIVE)],
    "an empty message inside": [head(), pb.Chunk(), *data_of(ARCHIVE), trailer_of(ARCHIVE)],
    "no job id": [head(job="")],
    "an over-long job id": [head(job="j" * 101)],
    "a job id with a path": [head(job="../../etc/passwd")],
    "a job id with a line break": [head(job="job_1\n")],
    "no key": [head(asset_key="")],
    "an over-long key": [head(asset_key="k" * 101)],
    "a hidden key": [head(asset_key=".dress")],
    "a key with a path": [head(asset_key="a/b")],
    "a key of other letters": [head(asset_key="плащ")],
    "a fill that does not exist": [head(fill="everything")],
    "a cut that does not exist": [head(cut="everything")],
    "a reversed box": [head(box=pb.Box(left=0.8, top=0.1, right=0.2, bottom=0.9))],
    "a box beyond the photo": [head(box=pb.Box(left=0.1, top=0.1, right=900, bottom=0.9))],
    "an empty box": [head(box=pb.Box(left=0.2, top=0.1, right=0.2, bottom=0.9))],
    "edits that are no JSON": [head(edits="{")],
    "edits with a box inside out": [head(edits='{"crop": {"centre": [0, 0, 0], "size": [1, -1, 1]}}')],
    "edits of another capture": [head(capture="cap_1", edits='{"capture": "cap_2"}')],
    "an over-long collection": [head(collection="c" * 300)],
    "a hidden collection": [head(collection=".ada")],
    "a collection above": [head(collection="..")],
    "a collection with a path": [head(collection="../ada")],
    "a collection of other letters": [head(collection="ада")],
    "a collection with a line break": [head(collection="ada\n")],
    "a target with a blank": [head(target="quest 3")],
    "a target that there is not": [head(target="quest9")],
    "a target whose encoder this worker has not": [head(target="quest3-ktx2")],
    "an over-long label": [head(label="l" * 201)],
    "a label with a line break": [head(label="a\nb")],
    "an unknown preset": [head(preset="nonesuch")],
    "an empty capture": [head(capture_bytes=0)],
    "a capture over the limit": [head(capture_bytes=LIMIT_BYTES + 1)],
}


@pytest.mark.parametrize("what", CORRUPT)
async def test_a_corrupt_upload_is_data_loss(client: Client, scratch: Path, what: str) -> None:
    assert (await refusal(client, CORRUPT[what])).code() == grpc.StatusCode.DATA_LOSS
    assert leftovers(scratch) == []
    assert (await client.worker()).free_slots == 1
    assert (await client.ended(ARCHIVE))[-1].HasField("finished"), "the same job may be sent again"


@pytest.mark.parametrize("what", MALFORMED)
async def test_a_malformed_upload_is_invalid(client: Client, scratch: Path, what: str) -> None:
    refused = await refusal(client, MALFORMED[what])
    assert refused.code() == grpc.StatusCode.INVALID_ARGUMENT
    code, _, sentence = (refused.details() or "").partition(": ")
    assert code.isupper()
    assert sentence
    assert leftovers(scratch) == []


@pytest.mark.parametrize("label", ["Grandma’s dress", "می‌خواهم", "👩‍👧 dress", "l" * 200])
async def test_a_label_is_in_anyones_words(client: Client, label: str) -> None:
    assert (await client.ended(ARCHIVE, label=label))[-1].HasField("finished")


async def test_inspect_checks_the_upload_too(client: Client, scratch: Path) -> None:
    for what, status in [("a gap", grpc.StatusCode.DATA_LOSS), ("no header", grpc.StatusCode.INVALID_ARGUMENT)]:
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await client.stub.Inspect(iter({**CORRUPT, **MALFORMED}[what]))
        assert refused.value.code() == status
    assert leftovers(scratch) == []


async def test_a_header_is_answered_before_the_data(client: Client) -> None:
    """A caller who waits for the initial metadata uploads nothing in vain."""
    call = client.stub.Reconstruct()
    await call.write(head())
    await call.initial_metadata()
    for chunk in (*data_of(ARCHIVE), trailer_of(ARCHIVE)):
        await call.write(chunk)
    assert [event async for event in _read(call)][-1].HasField("finished")


async def _read(call: grpc.aio.StreamStreamCall) -> AsyncIterator[pb.Event]:
    while (event := await call.read()) is not grpc.aio.EOF:
        yield event


async def test_a_refusal_reaches_a_caller_in_the_middle_of_its_upload(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        authentication, "DRAIN_NEXT_S", 5.0
    )  # this process both sends and hears, and may be kept waiting
    monkeypatch.setattr(authentication, "DRAIN_S", 60.0)
    holding = client.reconstruct(b"wait", "holding")
    await anext(aiter(holding))
    big = os.urandom(LIMIT_BYTES)
    for _ in range(5):
        refused = await refusal(client, upload(big, sizes=[4096]))
        assert refused.code() == grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_a_caller_who_leaves_during_the_upload_leaves_nothing(client: Client, scratch: Path) -> None:
    call = client.stub.Reconstruct()
    await call.write(head())
    await call.initial_metadata()
    state = await client.worker()
    assert (state.free_slots, list(state.jobs)) == (0, ["job_1"]), "a gateway counts what is not listed once more"
    call.cancel()
    await until(lambda: leftovers(scratch) == [])
    assert (await client.worker()).free_slots == 1
    with pytest.raises(grpc.aio.AioRpcError, match="JOB_UNKNOWN"):
        await client.attached()


async def test_a_job_is_known_the_moment_its_trailer_is_through(client: Client) -> None:
    call = client.stub.Reconstruct()
    for chunk in upload(b"wait"):
        await call.write(chunk)
    await call.read()
    call.cancel()
    assert list((await client.worker()).jobs) == ["job_1"]


async def test_a_newer_lease_takes_an_upload_over(client: Client) -> None:
    older = client.stub.Reconstruct()
    await older.write(head(fence=1))
    await older.initial_metadata()
    same = await refusal(client, upload(ARCHIVE, fence=1))
    assert same.code() == grpc.StatusCode.ALREADY_EXISTS
    assert (await client.ended(ARCHIVE, fence=2))[-1].HasField("finished")
    assert await older.code() == grpc.StatusCode.ABORTED


async def test_cancel_reaches_an_upload(client: Client, scratch: Path) -> None:
    call = client.stub.Reconstruct()
    await call.write(head())
    await call.initial_metadata()
    assert await client.cancel()
    assert await call.code() == grpc.StatusCode.CANCELLED
    assert leftovers(scratch) == []


async def test_an_upload_that_stands_still_is_given_up(
    client: Client, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(upload_module, "IDLE_S", 0.2)
    call = client.stub.Reconstruct()
    await call.write(head())
    assert await call.code() == grpc.StatusCode.DEADLINE_EXCEEDED
    assert leftovers(scratch) == []


async def test_a_disk_that_takes_no_more_is_resource_exhausted(client: Client, scratch: Path) -> None:
    shutil.rmtree(next(scratch.glob("worker-*")))
    for call in (client.stub.Reconstruct(upload(ARCHIVE)), client.stub.Inspect(upload(ARCHIVE))):
        assert await call.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
        assert str(scratch) not in await call.details()


async def test_a_message_over_8_mb_is_refused(client: Client) -> None:
    refused = await refusal(client, [head(capture_bytes=LIMIT_BYTES), data(0, bytes(9 << 20))])
    assert refused.code() == grpc.StatusCode.RESOURCE_EXHAUSTED


@given(archive=st.binary(min_size=1, max_size=3000), sizes=st.lists(st.integers(0, 700), max_size=20))
def test_any_chunking_gives_the_same_bytes(
    tmp_path_factory: pytest.TempPathFactory, archive: bytes, sizes: list[int]
) -> None:
    path = tmp_path_factory.mktemp("chunks") / "capture.zip"
    chunks = [*data_of(archive, [*sizes, 512]), trailer_of(archive)]
    asyncio.run(receive(_stream(chunks), path, expected_bytes=len(archive)))
    assert path.read_bytes() == archive


@given(archive=st.binary(min_size=1, max_size=300), place=st.integers(0), flip=st.integers(1, 255))
def test_any_flipped_byte_is_found(
    tmp_path_factory: pytest.TempPathFactory, archive: bytes, place: int, flip: int
) -> None:
    broken = bytearray(archive)
    broken[place % len(archive)] ^= flip
    path = tmp_path_factory.mktemp("chunks") / "capture.zip"
    chunks = [*data_of(bytes(broken), [64]), trailer_of(archive)]
    with pytest.raises(RefusedError) as refused:
        asyncio.run(receive(_stream(chunks), path, expected_bytes=len(archive)))
    assert refused.value.status == grpc.StatusCode.DATA_LOSS


async def _stream(chunks: Iterable[pb.Chunk]) -> AsyncIterator[pb.Chunk]:
    for chunk in chunks:
        yield chunk


NUMBERS = {
    "Header": "job fence preset asset_key target - capture_bytes label longest_m prepared collection fill box cut "
    "tenant token visibility capture description labels edits publish_anyway most_seconds columns unit",
    "AttachRequest": "job after_seq token",
    "CancelRequest": "job token",
    "Box": "left top right bottom photo",
    "Inspection": "kind format frames points warnings failure outline i18n processor_s",
    "YieldRequest": "job token",
    "Preset": "name summary trained memory_bytes literature takes i18n",
    "Worker": "version device - slots free_slots queued draining jobs presets memory_bytes points_version central",
    "Event": "job seq elapsed_s progress heartbeat published failure finished anchors",
    "Failure": "code message file hints retryable stage i18n",
    "Published": "asset_key version state manifest collection grade held",
    "Grade": "level because advice i18n",
    "Progress": "stage fraction losses eta_s message i18n",
}


@pytest.mark.parametrize("message", NUMBERS)
def test_fields_keep_their_numbers(message: str) -> None:
    """Gateways and workers of neighbouring versions talk to each other: a field may come, none may move."""
    fields = {field.number: field.name for field in pb.DESCRIPTOR.message_types_by_name[message].fields}
    assert [fields.get(number, "-") for number in range(1, 1 + max(fields))] == NUMBERS[message].split()


def test_what_an_older_caller_does_not_say_is_nothing_new() -> None:
    older = pb.Header(job="job_1", fence=1, asset_key="dress", capture_bytes=7).SerializeToString()
    assert not pb.Header.FromString(older).prepared
    assert pb.Header.FromString(older).collection == ""
    assert pb.Worker.FromString(pb.Worker(version="0.0.1").SerializeToString()).points_version == 0


def generator() -> ModuleType:
    """proto/ is no package, so its script is loaded by its path."""
    path = ROOT / "proto" / "generate.py"
    spec = importlib.util.spec_from_file_location("generate", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_generated_code_is_fresh() -> None:
    assert generator().stale() == []


def test_a_stale_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = generator()
    for name in module.NAMES:
        (tmp_path / name).write_bytes((module.API / name).read_bytes())
    (tmp_path / "edge_pb2.pyi").write_bytes(b"# older\n")
    (tmp_path / "edge_pb2_grpc.py").unlink()
    monkeypatch.setattr(module, "API", tmp_path)
    assert module.stale() == ["edge_pb2.pyi", "edge_pb2_grpc.py"]
