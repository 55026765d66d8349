"""A worker for the bench `soak`: a real gRPC server, whose jobs publish bundles that were made before.

python -m tests.bench.load.soak_worker BUNDLES LOG, with EDGE_* and STORAGE_*
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.coded_messages import coded_published
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.edge.worker.server import serve
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.logs import configure
from capture2vr.storage.bundle import Bundle, State
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload
from capture2vr.storage.catalogue.job_versions import StaleFence
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.settings import StorageSettings, open_policy, open_store
from capture2vr.storage.store import Head, Store
from tests.bench.load.many_assets import WrittenBytes

PRESET = "draft"
STATES: tuple[State, State] = ("preview", "refined")


class CountingStore:
    """A store that counts the bytes written to it."""

    def __init__(self, inner: Store) -> None:
        self._inner, self.written = inner, WrittenBytes()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def put(self, name: str, data: bytes | Path, **how: Any) -> Head:
        """Write an object, and count its bytes."""
        head = self._inner.put(name, data, **how)
        self.written.add(name, head.size)
        return head


@dataclass
class Publishing:
    """Work that publishes a preview and a refined bundle for every job, always the same, and writes down each."""

    bundles: list[Bundle]
    store: CountingStore
    policy: PublishPolicy
    log: TextIO
    _one_line: threading.Lock = field(default_factory=threading.Lock)

    @property
    def offer(self) -> Capabilities:
        """One preset."""
        return Capabilities("cpu", (pb.Preset(name=PRESET, summary="published", memory_bytes=1),))

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Publish both."""
        for bundle in self.bundles:
            began = time.time()
            with _as_edge_error():
                made = publish(
                    bundle,
                    self.store,
                    key=request.asset_key,
                    job=request.job,
                    fence=request.fence,
                    collection=request.options.collection,
                    policy=self.policy,
                )
            self._write(request, began)
            report(coded_published(made, bundle.manifest, request.options.collection))
        return pb.Finished()

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        """Take any capture."""
        return pb.Inspection(kind="points", format="ply", points=1)

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        """Nobody asks for one."""
        raise EdgeError("EXPORT_FAILED", "this worker converts nothing")

    def _write(self, request: ReconstructionRequest, began: float) -> None:
        """Write a line of the log: the bytes are those of this process so far."""
        line = {"collection": request.options.collection, "ended": time.time(), "seconds": time.time() - began}
        line |= {"process": os.getpid(), "bytes": self.store.written.all, "catalogue": self.store.written.by_catalogue}
        with self._one_line:
            self.log.write(json.dumps(line) + "\n")


@contextmanager
def _as_edge_error() -> Iterator[None]:
    """Raise what a worker raises: the gateway repeats a job where the store failed."""
    try:
        yield
    except StaleFence as stale:
        raise EdgeError("FENCE_STALE", str(stale)) from None
    except OSError as error:
        raise EdgeError("STORE_UNAVAILABLE", str(error), retryable=True) from error


def write_bundles(folder: Path, bundles: list[Bundle]) -> None:
    """Write bundles for workers, one a folder: its files, and its manifest, `bundle.json`."""
    for bundle in bundles:
        (folder / bundle.state).mkdir(parents=True)
        for name, data in bundle.files.items():
            (folder / bundle.state / name).write_bytes(data)
        (folder / bundle.state / "bundle.json").write_text(json.dumps(bundle.manifest))


def _read_bundle(folder: Path, state: State) -> Bundle:
    files = {path.name: path.read_bytes() for path in sorted((folder / state).iterdir())}
    manifest = json.loads(files.pop("bundle.json"))
    return Bundle(state=state, files=files, manifest=manifest, last=state == STATES[-1])


if __name__ == "__main__":
    configure("WARNING")
    settings = StorageSettings()
    made = [_read_bundle(Path(sys.argv[1]), each) for each in STATES]
    with Path(sys.argv[2]).open("a", buffering=1) as lines:
        work = Publishing(made, CountingStore(open_store(settings)), open_policy(settings), lines)
        sys.exit(serve(EdgeSettings(), work))
