"""Downloads on the wire: checked, each made once at a time, a few at once, and not stopped by a caller who leaves."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from pathlib import Path

import grpc
import pytest

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker import downloads as module
from capture2vr.edge.worker.job_request import RefusedError
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.order.download_formats import FORMATS
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload
from tests.support.workers.edge_client import Client, Scripted, leftovers, until, worker

SHA256 = "5" * 64


class Making(Scripted):
    """Work whose downloads wait until they are released."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()
        self.made: list[tuple[str, DownloadOrder]] = []

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        self.made.append((tenant, order))
        (scratch / "leftover").write_bytes(b"x")
        while not self.go.wait(0.02):
            tick(0.0)
        if order.key == "empty":
            raise EdgeError("DOWNLOAD_TOO_LARGE", "it is too large", hints=("take another",))
        if order.key == "odd":
            raise KeyError("/secret/path")
        return StoredDownload(f"assets/{order.key}/made.{SHA256}.zip", 7)


@pytest.fixture
def work() -> Making:
    return Making()


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    return tmp_path / "scratch"


@pytest.fixture
async def client(work: Making, scratch: Path) -> AsyncIterator[Client]:
    async with worker(work, scratch) as client:
        yield client
        work.go.set()


def request(key: str = "sheet", **fields: str) -> pb.DownloadRequest:
    return pb.DownloadRequest(**{"asset_key": key, "manifest": SHA256, "format": "obj", **fields})


async def test_a_file_is_made_and_told(client: Client, work: Making, scratch: Path) -> None:
    work.go.set()
    answer = await client.stub.MakeDownload(request(tenant="ada"))
    assert answer == pb.Download(name=f"assets/sheet/made.{SHA256}.zip", bytes=7)
    assert work.made == [("ada", DownloadOrder("sheet", SHA256, FORMATS["obj"]))]
    assert leftovers(scratch) == []


@pytest.fixture
def arrived(monkeypatch: pytest.MonkeyPatch) -> list[pb.DownloadRequest]:
    """The requests that the worker has read: one that comes after the file is made would have it made again."""
    read: list[pb.DownloadRequest] = []
    check = module._checked

    def counted(request: pb.DownloadRequest) -> tuple[str, DownloadOrder]:
        read.append(request)
        return check(request)

    monkeypatch.setattr(module, "_checked", counted)
    return read


async def test_two_who_want_the_same_get_the_same(
    client: Client, work: Making, arrived: list[pb.DownloadRequest]
) -> None:
    calls = [client.stub.MakeDownload(request()) for _ in range(5)]
    other = client.stub.MakeDownload(request(tenant="ada"))
    await until(lambda: len(arrived) == 6)
    work.go.set()
    assert len({answer.name for answer in await asyncio.gather(*calls)}) == 1
    await other
    assert len(work.made) == 2, "another tenant's asset of this key is another one"


async def test_a_caller_who_leaves_does_not_stop_it(
    client: Client, work: Making, arrived: list[pb.DownloadRequest]
) -> None:
    leaving, staying = client.stub.MakeDownload(request()), client.stub.MakeDownload(request())
    await until(lambda: len(arrived) == 2)
    leaving.cancel()
    work.go.set()
    assert (await staying).bytes == 7
    assert len(work.made) == 1


async def test_few_are_made_at_once_and_few_wait(client: Client, work: Making, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 3)
    calls = [asyncio.ensure_future(client.stub.MakeDownload(request(f"sheet{number}"))) for number in range(4)]
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await next(iter(asyncio.as_completed(calls)))
    assert refused.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    assert len(work.made) == module.AT_ONCE
    work.go.set()
    answers = await asyncio.gather(*calls, return_exceptions=True)
    assert sum(isinstance(answer, pb.Download) for answer in answers) == 3


@pytest.mark.parametrize(("key", "code"), [("empty", "DOWNLOAD_TOO_LARGE"), ("odd", "INTERNAL")])
async def test_what_cannot_be_made_is_told(client: Client, work: Making, scratch: Path, key: str, code: str) -> None:
    work.go.set()
    answer = await client.stub.MakeDownload(request(key))
    assert (answer.failure.code, answer.name) == (code, "")
    assert "/secret" not in answer.failure.message
    assert leftovers(scratch) == []


@pytest.mark.parametrize(
    "fields",
    [
        {"asset_key": ""},
        {"asset_key": "../ada"},
        {"asset_key": "a" * 101},
        {"tenant": "../ada"},
        {"tenant": "Ada"},
        {"manifest": ""},
        {"manifest": "../" + "0" * 61},
        {"format": ""},
        {"format": "exe"},
        {"format": "obj\n"},
    ],
)
async def test_a_malformed_request_is_invalid(client: Client, work: Making, fields: dict[str, str]) -> None:
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await client.stub.MakeDownload(request(**fields))
    assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert (refused.value.details() or "").partition(":")[0].isupper()
    assert work.made == []


async def test_a_worker_that_shuts_down_stops_it(work: Making, tmp_path: Path) -> None:
    scratch = Scratch(tmp_path)
    with scratch.claim():
        downloads = module.DownloadMaker(work, scratch)
        making = asyncio.ensure_future(downloads.make(request()))
        await until(lambda: len(work.made) == 1)
        downloads.close()
        answer = await making
        assert (answer.failure.code, answer.failure.retryable) == ("WORKER_DRAINING", True)
        with pytest.raises(RefusedError, match="WORKER_DRAINING"):
            await downloads.make(request())
        assert leftovers(tmp_path) == []
