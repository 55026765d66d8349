"""Uploads a file to a gateway, and goes on after a lost connection, a restarted gateway, or its own end (tus 1.0).

Which upload a file belongs to is remembered in a small file of this machine's state, named by the file's content.
"""

from __future__ import annotations

import base64
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from capture2vr.client.answers import parse_answer
from capture2vr.client.report import Report
from capture2vr.client.seen_version import state_folder
from capture2vr.errors import BadInput
from capture2vr.process.atomic_write import atomic_write

_PIECE_BYTES = 16 << 20  # with a checksum of its own: what a lost connection costs at most
_CHUNK_BYTES = 256 << 10  # progress is reported with each
_PAUSE_S = (0.2, 0.5, 1.0, 2.0, 5.0)  # before attempts that follow each other
_GIVE_UP_S = 300.0  # without progress: a phone's tunnel, a gateway's update
CHECKING = httpx.Timeout(30.0, read=900.0)
"""While the gateway checks an upload, of gigabytes perhaps, and has it inspected: by each of several slow workers."""
_TUS = {"Tus-Resumable": "1.0.0"}
_AGAIN = {408, 409, 423, 425, 429, 460, 500, 502, 503, 504}  # answers after which the same may succeed
_REFUSED = {400, 409, 415, 422}  # of a capture, for what it is
_GONE = 404  # an upload that expired, or whose capture was deleted


class _Again(Exception):  # noqa: N818 - not a fault yet
    """An answer after which to try again; `wait_s` is what the gateway asks for."""

    def __init__(self, answer: httpx.Response) -> None:
        super().__init__(f"the gateway answered {answer.status_code}")
        after = answer.headers.get("Retry-After", "")
        self.answer = answer
        self.wait_s = min(60.0, float(after)) if after.isdigit() else 0.0


def upload_resumably(
    client: httpx.Client,
    archive: Path,
    report: Report,
    told: Mapping[str, str],
    params: Mapping[str, str],
    *,
    file: str,
    then: Callable[[Any], Any],
) -> Any:
    """Upload a file, make the capture of it, and return what `then` makes of the receipt.

    told    of the file: `filetype`, `filename`, …
    params  of the capture: `box`, `continues`
    file    its name, for errors that name none
    then    creates the job: where it raises, the upload is remembered, and the next command sends nothing again

    Raises BadInput with the gateway's words, httpx.TransportError where it has been away for minutes.
    """
    size = archive.stat().st_size
    memory = _Memory(client, archive, params)
    upload = _Attempts().run(lambda: _find(client, memory.upload) or _create(client, size, told))
    memory.remember(upload, report)
    _send(client, upload, archive, report)
    report.show("CHECKING", 1.0, f"{size / 1e6:.1f} MB")
    answer = _Attempts().run(lambda: _finish(client, upload, params))
    if answer.status_code in _REFUSED or answer.status_code == _GONE:
        memory.forget()
    done = then(parse_answer(answer, file=file))
    memory.forget()
    return done


def _find(client: httpx.Client, upload: str) -> str:
    """Return the upload if it can go on, else ""."""
    if not upload:
        return ""
    return upload if _checked(client.head(upload, headers=_TUS)).is_success else ""


def _create(client: httpx.Client, size: int, told: Mapping[str, str]) -> str:
    pairs = ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in told.items())
    headers = {**_TUS, "Upload-Length": str(size), "Upload-Metadata": pairs}
    answer = _checked(client.post("/v1/uploads", headers=headers))
    if not answer.is_success:
        parse_answer(answer)
    return str(answer.headers["Location"])


def _send(client: httpx.Client, upload: str, archive: Path, report: Report) -> None:
    """Send what the gateway does not have yet, piece by piece."""
    size, attempts = archive.stat().st_size, _Attempts()
    offset = attempts.run(lambda: _offset(client, upload))
    if offset:
        report.show("UPLOADING", offset / size, f"goes on at {offset / 1e6:.1f} of {size / 1e6:.1f} MB")
    with archive.open("rb") as file:
        while offset < size:
            file.seek(offset)
            piece = file.read(_PIECE_BYTES)
            try:
                offset = _send_piece(client, upload, offset, _chunks(piece, offset, size, report), piece)
                attempts = _Attempts()
            except (_Again, httpx.TransportError) as failure:
                attempts.wait(failure)
                offset = attempts.run(lambda: _offset(client, upload))


def _send_piece(client: httpx.Client, upload: str, offset: int, chunks: Iterator[bytes], piece: bytes) -> int:
    proof = base64.b64encode(hashlib.sha256(piece).digest()).decode()
    headers = {
        **_TUS,
        "Content-Type": "application/offset+octet-stream",
        "Content-Length": str(len(piece)),
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {proof}",
    }
    answer = _checked(client.patch(upload, content=chunks, headers=headers))
    if not answer.is_success:
        parse_answer(answer)
    return int(answer.headers["Upload-Offset"])


def _offset(client: httpx.Client, upload: str) -> int:
    answer = _checked(client.head(upload, headers=_TUS))
    if not answer.is_success:
        raise BadInput(f"the gateway answered {answer.status_code} to an upload that was going on: push it again")
    return int(answer.headers["Upload-Offset"])


def _finish(client: httpx.Client, upload: str, params: Mapping[str, str]) -> httpx.Response:
    answer = client.post(f"{upload}/capture", params=dict(params), timeout=CHECKING)
    if answer.status_code in _REFUSED:
        client.delete(upload, headers=_TUS)
        return answer
    return _checked(answer)


def _checked(answer: httpx.Response) -> httpx.Response:
    """Return the answer. Raises _Again for one after which to try again."""
    if answer.status_code in _AGAIN:
        raise _Again(answer)
    return answer


def _chunks(piece: bytes, offset: int, size: int, report: Report) -> Iterator[bytes]:
    for start in range(0, len(piece), _CHUNK_BYTES):
        yield piece[start : start + _CHUNK_BYTES]
        sent = offset + min(start + _CHUNK_BYTES, len(piece))
        report.show("UPLOADING", sent / size, f"{sent / 1e6:.1f} of {size / 1e6:.1f} MB")


class _Attempts:
    """Repeats what fails for want of a connection, with pauses, for `_GIVE_UP_S` at most."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._failures = 0

    def run(self, work: Callable[[], Any]) -> Any:
        """Return what `work` returns. Raises BadInput, httpx.TransportError after the last attempt."""
        while True:
            try:
                return work()
            except (_Again, httpx.TransportError) as failure:
                self.wait(failure)

    def wait(self, failure: _Again | httpx.TransportError) -> None:
        """Pause before the next attempt. Raises the failure, or what it says, where there is none."""
        if time.monotonic() - self._began > _GIVE_UP_S:
            if isinstance(failure, _Again):
                parse_answer(failure.answer)
            raise failure
        pause = _PAUSE_S[min(self._failures, len(_PAUSE_S) - 1)]
        self._failures += 1
        time.sleep(max(pause, failure.wait_s if isinstance(failure, _Again) else 0.0))


class _Memory:
    """Remembers on this machine which upload a file's content belongs to at a gateway.

    params  of the capture: with others the same content is another capture
    """

    def __init__(self, client: httpx.Client, archive: Path, params: Mapping[str, str]) -> None:
        with archive.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
        identity = " ".join((str(client.base_url), content, *(f"{name}={params[name]}" for name in sorted(params))))
        self._name = hashlib.sha256(identity.encode()).hexdigest()[:32]

    @property
    def _path(self) -> Path:
        return state_folder() / "uploads" / f"{self._name}.json"

    @property
    def upload(self) -> str:
        """The upload's path; "" where none is known."""
        try:
            upload = json.loads(self._path.read_bytes())["upload"]
        except (OSError, ValueError, KeyError, TypeError):  # damaged, or not to be read: a new upload is as good
            return ""
        return upload if isinstance(upload, str) and upload.startswith("/v1/uploads/") else ""

    def remember(self, upload: str, report: Report) -> None:
        """Write the upload down, or warn: the upload itself needs no folder of the user's."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self._path) as part:
                part.write_text(json.dumps({"upload": upload}))
        except OSError as error:
            report.warn(f"if this push is cut off, the next one begins anew: {error}")

    def forget(self) -> None:
        """Forget the upload: it has become a capture, or never will."""
        with suppress(OSError):
            self._path.unlink()
