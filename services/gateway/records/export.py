"""Export of all that a tenant has, as a zip that is made while it is downloaded: captures, assets, catalogues, jobs."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any

from capture2vr.gateway.jobs.job import Job
from capture2vr.sentences.documents import with_codes
from capture2vr.storage.store import Head, Store, list_all
from capture2vr.storage.tenant_store import FOLDER

_READ_BYTES = 4 << 20  # per request to the store; a document that may be replaced meanwhile is one request
_JOBS_AT_ONCE = 200
_LEFT_OUT = (FOLDER, "uploads/")  # other tenants, whom the default tenant's store holds; parts of unfinished uploads


class _Pipe(io.RawIOBase):
    """A file that can only be written to; `take` returns what was written since the last call."""

    def __init__(self) -> None:
        self._written = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._written += data
        return len(data)

    def take(self) -> bytes:
        taken, self._written = bytes(self._written), bytearray()
        return taken


def export_blocks(store: Store, read_jobs: Callable[[str, int], list[Job]]) -> Iterator[bytes]:
    """Yield the zip of all objects of a tenant's store, under their names, and of `jobs.json`. Blocks.

    read_jobs  returns at most so many jobs older than a job's id ("": the newest)

    Files are stored as they are: captures and GLB files are compressed already. Raises OSError.
    """
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_STORED) as archive:
        for head in list_all(store, ""):
            if head.name.startswith(_LEFT_OUT):
                continue
            yield from _file(archive, pipe, store, head)
        archive.writestr(_info("jobs.json", datetime.now(UTC)), _jobs_document(read_jobs))
        yield pipe.take()
    yield pipe.take()


def _file(archive: zipfile.ZipFile, pipe: _Pipe, store: Store, head: Head) -> Iterator[bytes]:
    try:
        block = store.get(head.name, start=0, length=_READ_BYTES)
    except FileNotFoundError:
        return  # deleted since it was listed
    with archive.open(_info(head.name, head.modified), "w", force_zip64=True) as entry:
        start = 0
        while block:
            entry.write(block)
            yield pipe.take()
            start += len(block)
            block = store.get(head.name, start=start, length=_READ_BYTES) if start < head.size else b""


def _info(name: str, modified: datetime) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, modified.timetuple()[:6])
    info.external_attr = 0o600 << 16  # photos of people's rooms: for their owner
    return info


def _jobs_document(read_jobs: Callable[[str, int], list[Job]]) -> bytes:
    documents: list[dict[str, Any]] = []
    after = ""
    while jobs := read_jobs(after, _JOBS_AT_ONCE):
        documents += [with_codes(_job_document(job)) for job in jobs]
        after = jobs[-1].id
    return json.dumps({"jobs": documents}, ensure_ascii=False, indent=1).encode()


def _job_document(job: Job) -> dict[str, Any]:
    return {
        "id": job.id,
        "state": job.state,
        "created": datetime.fromtimestamp(job.created, UTC).isoformat(),
        "updated": datetime.fromtimestamp(job.updated, UTC).isoformat(),
        "order": job.order.as_json,
        "asset": job.asset,
        "error": job.error,
        "warnings": list(job.warnings),
        "seconds": dict(job.seconds),
    }
