"""Upload a capture to a gateway as one zip; a large one goes on where it stopped."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx

from capture2vr.client.answers import parse_answer
from capture2vr.client.earlier_results import check_capture
from capture2vr.client.report import Report
from capture2vr.client.resumable_upload import CHECKING, upload_resumably
from capture2vr.errors import BadInput
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.archives import is_zip, pack

_CHUNK_BYTES = 256 << 10  # of the upload; progress is reported with each
_RESUMABLE_BYTES = 16 << 20  # of an upload that can go on; a smaller one is sent again within seconds


def require_capture(source: Path) -> None:
    """Raises BadInput where there is no such file or folder, or where a run's results lie in it."""
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    check_capture(source)


def upload(
    client: httpx.Client,
    source: Path,
    report: Report,
    *,
    box: PhotoBox | None = None,
    continues: str = "",
    then: Callable[[Any], Any] = lambda receipt: receipt,
) -> Any:
    """Upload the capture as one zip; zip the source first if it is not one. Returns what `then` makes of the receipt.

    A large one goes on where it stopped after a lost connection, or when the same is pushed again, also where `then`
    was refused.

    box        mark of the object in a photo, with which the worker inspects it
    continues  id of the stored capture whose photos the new one has too; "": none
    """
    with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
        archive = source
        if not (source.is_file() and is_zip(source)):
            archive = Path(scratch) / "capture.zip"
            pack(source, archive)
        size = archive.stat().st_size
        params = {"box": box.text} if box else {}
        params |= {"continues": continues} if continues else {}
        if size >= _RESUMABLE_BYTES:
            told = {"filetype": "application/zip"}
            return upload_resumably(client, archive, report, told, params, file=source.name, then=then)
        headers = {"Content-Type": "application/zip", "Content-Length": str(size)}
        content = _chunks(archive, size, report)
        answer = client.post("/v1/captures", params=params, content=content, headers=headers, timeout=CHECKING)
        return then(parse_answer(answer, file=source.name))


def _chunks(archive: Path, size: int, report: Report) -> Iterator[bytes]:
    sent = 0
    report.show("UPLOADING", 0.0, f"{size / 1e6:.1f} MB")
    with archive.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            yield chunk
            sent += len(chunk)
            report.show("UPLOADING", sent / size, f"{sent / 1e6:.1f} of {size / 1e6:.1f} MB")
