"""Make downloads of published assets, for gateways: beside the jobs, a few at once, and each only once at a time."""

from __future__ import annotations

import asyncio
import threading
from contextlib import suppress
from pathlib import Path

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.worker.failures import DRAINING, failure_of
from capture2vr.edge.worker.job_request import RefusedError, invalid
from capture2vr.edge.worker.job_run import Work
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.order.download_formats import FORMATS
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import is_sha256
from capture2vr.storage.catalogue.downloads import DownloadOrder
from capture2vr.storage.catalogue.entry import valid_key
from capture2vr.storage.tenant_store import DEFAULT_TENANT, valid_tenant

AT_ONCE = 2
"""Most downloads made at once, each a process of up to some gigabytes: more would slow down the jobs."""
MOST = 32
"""Most that are made or wait: those who ask beyond that ask another worker, or again."""


class DownloadMaker:
    """Makes downloads. Used on the event loop; each is made in a thread of its own, to its end."""

    def __init__(self, work: Work, scratch: Scratch) -> None:
        self._work = work
        self._scratch = scratch
        self._making: dict[tuple[str, DownloadOrder], asyncio.Task[pb.Download]] = {}
        self._places = asyncio.Semaphore(AT_ONCE)
        self._closed = threading.Event()

    async def make(self, request: pb.DownloadRequest) -> pb.Download:
        """Make a download, or wait for the one that is being made. Raises RefusedError."""
        tenant, order = _checked(request)
        if self._closed.is_set():
            raise RefusedError(grpc.StatusCode.UNAVAILABLE, "WORKER_DRAINING", say("this_worker_shutting_down"))
        task = self._making.get((tenant, order))
        if task is None:
            if len(self._making) >= MOST:
                status = grpc.StatusCode.RESOURCE_EXHAUSTED
                raise RefusedError(status, "DOWNLOADS_BUSY", say("downloads_being_made_already", count=MOST))
            task = asyncio.create_task(self._make(tenant, order))
            self._making[tenant, order] = task
            task.add_done_callback(lambda _: self._making.pop((tenant, order)))
        return await asyncio.shield(task)  # who hangs up does not stop it for the others

    def close(self) -> None:
        """Stop what is being made: the processes end within a fraction of a second."""
        self._closed.set()

    async def _make(self, tenant: str, order: DownloadOrder) -> pb.Download:
        async with self._places:
            folder = self._scratch.folder(0)
            loop = asyncio.get_running_loop()
            made: asyncio.Future[pb.Download] = loop.create_future()

            def work() -> None:
                answer = self._answer(tenant, order, folder)
                self._scratch.drop(folder)
                with suppress(RuntimeError):  # the loop is closed: the worker has shut down
                    loop.call_soon_threadsafe(_deliver, made, answer)

            threading.Thread(target=work, name="download", daemon=True).start()
            return await made

    def _answer(self, tenant: str, order: DownloadOrder, folder: Path) -> pb.Download:
        try:
            found = self._work.make_download(tenant, order, folder, self._tick)
            return pb.Download(name=found.name, bytes=found.size)
        except Cancelled:
            return pb.Download(failure=DRAINING)
        except BaseException as error:  # noqa: BLE001 - the caller must get an answer whatever happens here
            return pb.Download(
                failure=failure_of(error, job=f"of download {order.key} {order.format.name}", scratch=folder)
            )

    def _tick(self, _: float) -> None:
        if self._closed.is_set():
            raise Cancelled


def _deliver(made: asyncio.Future[pb.Download], answer: pb.Download) -> None:
    if not made.done():
        made.set_result(answer)


def _checked(request: pb.DownloadRequest) -> tuple[str, DownloadOrder]:
    """Return whose asset is wanted, and in which version and format. Raises RefusedError INVALID_ARGUMENT."""
    if request.tenant and not valid_tenant(request.tenant):
        raise invalid("TENANT_INVALID", "tenant must be 1 to 32 of a-z 0-9 - and begin with a letter or digit")
    if not valid_key(request.asset_key):
        raise invalid("KEY_INVALID", "asset_key must be 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit")
    if not is_sha256(request.manifest):
        raise invalid("MANIFEST_INVALID", "manifest must be a sha256 of 64 hex digits")
    if request.format not in FORMATS:
        raise invalid("FORMAT_UNKNOWN", f"format must be one of {', '.join(FORMATS)}")
    return request.tenant or DEFAULT_TENANT, DownloadOrder(request.asset_key, request.manifest, FORMATS[request.format])
