"""`capture2vr push`: upload a capture as a phone would and follow its job to the end."""

from __future__ import annotations

import json
import tempfile
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx

from services.cli.assets import check_collection
from services.cli.errors import BadInput, answer_of, told
from services.cli.http import client_of
from services.cli.progress import StageBar, console, warn
from services.storage.archives import is_zip, pack

_CHUNK_BYTES = 256 << 10
_TIMEOUT = httpx.Timeout(30.0, read=60.0)  # the gateway says something at least every 15 s while a job runs
_RECONNECT_S = 1.0
_GIVE_UP_S = 120.0  # without a word from the gateway; a restart takes seconds
_AWAY = {502, 503, 504}
_TERMINAL = {"SUCCEEDED", "FAILED", "CANCELLED"}


def push_capture(
    source: Path,
    gateway: str,
    *,
    key: str,
    label: str,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """Upload, start a job, follow it; the final job. Raises BadInput with the gateway's own reason.

    options: what else the job asks for, by the API's names; None: not told.
    """
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    if collection := options.get("collection"):
        check_collection(collection)  # before megabytes are sent
    try:
        with client_of(gateway, timeout=_TIMEOUT) as client, StageBar() as bar:
            capture = upload(client, source, bar)
            request = {"capture": capture["capture"], "asset_key": key, "label": label or key}
            request |= {name: value for name, value in options.items() if value is not None}
            # One key for the whole command: a retry after a lost answer finds the job instead of making a second one.
            job = answer_of(client.post("/v1/jobs", json=request, headers={"Idempotency-Key": uuid.uuid4().hex}))
            for state in follow(client, job["id"]):
                job = state
                bar.show(job["stage"] or job["state"], job["fraction"], job.get("message") or "", job.get("losses"))
                if (asset := job.get("asset")) and asset["state"] == "preview":  # only the event tells of it there
                    console.print(f"preview  {gateway}/view/{key}")
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    return _outcome(job, gateway)


def upload(client: httpx.Client, source: Path, bar: StageBar) -> Any:
    """POST the capture as one zip, made on the way where the source is not one already."""
    with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
        archive = source
        if not (source.is_file() and is_zip(source)):
            archive = Path(scratch) / "capture.zip"
            pack(source, archive)
        size = archive.stat().st_size
        headers = {"Content-Type": "application/zip", "Content-Length": str(size)}
        answer = client.post("/v1/captures", content=_chunks(archive, size, bar), headers=headers)
        return answer_of(answer, file=source.name)


def follow(client: httpx.Client, job: str) -> Iterator[dict[str, Any]]:
    """The job each time something happened to it, over server-sent events; reconnects where the connection breaks."""
    last, heard = "", time.monotonic()
    while True:
        try:
            headers = {"Last-Event-ID": last} if last else {}
            with client.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as response:
                _present(response)
                if not response.is_success:
                    response.read()
                    answer_of(response)
                for line in response.iter_lines():
                    heard = time.monotonic()
                    if line.startswith("id:"):
                        last = line[3:].strip()
                    elif line.startswith("data:") and line[5:].strip():
                        yield {"stage": "", "fraction": 0.0, "state": "RUNNING", **json.loads(line[5:])}
            state = answer_of(_present(client.get(f"/v1/jobs/{job}")))
            yield state
            if state["state"] in _TERMINAL:
                return
        except httpx.TransportError:
            if time.monotonic() - heard > _GIVE_UP_S:
                raise
        time.sleep(_RECONNECT_S)


def _present(response: httpx.Response) -> httpx.Response:
    """The answer; where a proxy answers for a gateway that is away, that is no connection."""
    if response.status_code in _AWAY:
        raise httpx.ConnectError(f"it answered {response.status_code}")
    return response


def _chunks(archive: Path, size: int, bar: StageBar) -> Iterator[bytes]:
    sent = 0
    bar.show("UPLOADING", 0.0, f"{size / 1e6:.1f} MB")
    with archive.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            yield chunk
            sent += len(chunk)
            bar.show("UPLOADING", sent / size, f"{sent / 1e6:.1f} of {size / 1e6:.1f} MB")


def _outcome(job: dict[str, Any], gateway: str) -> dict[str, Any]:
    if job["state"] != "SUCCEEDED":
        raise BadInput(told(job["error"]) if job.get("error") else f"the job ended as {job['state']}")
    for warning in job.get("warnings") or []:
        warn(warning)
    where = f", in collection {job['collection']}" if job["collection"] else ""
    console.print(f"done in {job['elapsed_s']:.1f} s: {gateway}/view/{job['asset_key']}{where}")
    return job
