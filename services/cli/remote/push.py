"""`capture2vr push`: upload a capture to a gateway, start a job, and follow it until it has ended."""

from __future__ import annotations

import json
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx

from capture2vr.cli.errors import BadInput, parse_answer, problem_sentence
from capture2vr.cli.key_names import check_collection, check_key
from capture2vr.cli.local.earlier_results import check_capture
from capture2vr.cli.progress import StageBar, console, warn
from capture2vr.cli.remote.http import client_of
from capture2vr.cli.remote.resumable_upload import CHECKING, upload_resumably
from capture2vr.order.edits import Edits
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.archives import is_zip, pack

_CHUNK_BYTES = 256 << 10  # of the upload; the progress bar moves with each
_RESUMABLE_BYTES = 16 << 20  # of an upload that can go on; a smaller one is sent again within seconds
_TIMEOUT = httpx.Timeout(30.0, read=60.0)  # the gateway sends an event at least every 15 s while a job runs
_RECONNECT_S = 1.0  # pause before reconnecting
_GIVE_UP_S = 120.0  # without an answer of the gateway; a restart takes seconds
_NOT_NOW = {429, 502, 503, 504}  # 429: of other requests of the tenant there were too many
_TERMINAL = {"SUCCEEDED", "FAILED", "CANCELLED"}


def push_capture(
    source: Path,
    gateway: str,
    *,
    key: str,
    options: JobOptions = DEFAULT_OPTIONS,
) -> dict[str, Any]:
    """Upload a capture, start a job, follow it, and return the job when it has ended.

    Raises BadInput with the gateway's error message.
    """
    gateway = gateway.rstrip("/")
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    check_capture(source)
    check_key(key)  # before megabytes are uploaded
    if options.collection:
        check_collection(options.collection)
    request = {"asset_key": key, "label": key, **options.given}
    try:
        with client_of(gateway, timeout=_TIMEOUT) as client, StageBar() as bar:
            create = partial(_create_job, client, "/v1/jobs", request)
            job = upload(client, source, bar, box=options.box, then=create)
            job = _followed(client, job, bar, gateway)
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    return _outcome(job, gateway)


def continue_capture(source: Path, gateway: str, *, key: str, cut: str | None, edits: Edits | None) -> dict[str, Any]:
    """Add photos to the capture of an asset, make its next version, and return the job when it has ended.

    The asset's earlier job says all but `cut` and `edits`, and those too where they are None. Raises BadInput with the
    gateway's error message.
    """
    gateway = gateway.rstrip("/")
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    check_capture(source)
    request = ({} if cut is None else {"cut": cut}) | ({} if edits is None else {"edits": edits.as_json})
    try:
        with client_of(gateway, timeout=_TIMEOUT) as client, StageBar() as bar:
            earlier = _job_of(client, key)
            create = partial(_create_job, client, earlier["links"]["again"], request)
            job = upload(client, source, bar, continues=earlier["capture"], then=create)
            job = _followed(client, job, bar, gateway)
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    return _outcome(job, gateway)


def _job_of(client: httpx.Client, key: str) -> Any:
    """Return the job that made the newest version of an asset. Raises BadInput."""
    entry = parse_answer(client.get(f"/v1/assets/{quote(key, safe='')}"))
    made = [version for version in entry.get("versions") or [] if version.get("job")]
    if not made:
        raise BadInput(
            f"{key}: no job of this gateway has made it, so there is no capture to continue: push all photos"
        )
    return parse_answer(client.get(f"/v1/jobs/{max(made, key=lambda each: each['version'])['job']}"))


def _create_job(client: httpx.Client, path: str, request: Mapping[str, Any], capture: Mapping[str, Any]) -> Any:
    """Create a job of a capture that was uploaded. Raises BadInput, httpx.TransportError.

    One key for all attempts: the one after a lost answer finds the job, and creates no second one.
    """
    headers, began = {"Idempotency-Key": uuid.uuid4().hex}, time.monotonic()
    while True:
        try:
            return parse_answer(client.post(path, json={**request, "capture": capture["capture"]}, headers=headers))
        except httpx.TransportError:
            if time.monotonic() - began > _GIVE_UP_S:
                raise
        time.sleep(_RECONNECT_S)


def _followed(client: httpx.Client, job: dict[str, Any], bar: StageBar, gateway: str) -> dict[str, Any]:
    """Show a job's progress until it has ended, and return it then."""
    key, is_shown = job["asset_key"], False
    for state in follow(client, job["id"]):
        job = state
        bar.show(job["stage"] or job["state"], job["fraction"], job.get("message") or "", job.get("losses"))
        asset = job.get("asset")
        if asset and asset["state"] == "preview" and not is_shown:  # of a draft it is the last state too
            console.print(f"preview  {gateway}/view/{key}")
            is_shown = True
    return job


def upload(
    client: httpx.Client,
    source: Path,
    bar: StageBar,
    *,
    box: PhotoBox | None = None,
    continues: str = "",
    then: Callable[[Any], Any] = lambda receipt: receipt,
) -> Any:
    """Upload the capture as one zip; zip the source first if it is not one. Returns what `then` makes of the receipt.

    A large one goes on where it stopped after a lost connection, or when the same is pushed again, also where `then`
    was refused.

    box        rectangle of the thing in a single photo, with which the worker inspects it
    continues  id of the stored capture whose photos the new one has too; "": none
    """
    with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
        archive = source
        if not (source.is_file() and is_zip(source)):
            archive = Path(scratch) / "capture.zip"
            pack(source, archive)
        size = archive.stat().st_size
        params = {"box": ",".join(map(str, box.values))} if box else {}
        params |= {"continues": continues} if continues else {}
        if size >= _RESUMABLE_BYTES:
            told = {"filetype": "application/zip"}
            return upload_resumably(client, archive, bar, told, params, file=source.name, then=then)
        headers = {"Content-Type": "application/zip", "Content-Length": str(size)}
        content = _chunks(archive, size, bar)
        answer = client.post("/v1/captures", params=params, content=content, headers=headers, timeout=CHECKING)
        return then(parse_answer(answer, file=source.name))


def follow(client: httpx.Client, job: str) -> Iterator[dict[str, Any]]:
    """Yield the job's state after each event (server-sent events) until it has ended; reconnects if necessary."""
    last_event, last_heard = "", time.monotonic()
    while True:
        try:
            headers = {"Last-Event-ID": last_event} if last_event else {}
            with client.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as response:
                _raise_if_not_now(response)
                if not response.is_success:
                    response.read()
                    parse_answer(response)
                for line in response.iter_lines():
                    last_heard = time.monotonic()
                    if line.startswith("id:"):
                        last_event = line[3:].strip()
                    elif line.startswith("data:") and line[5:].strip():
                        yield {"stage": "", "fraction": 0.0, "state": "RUNNING", **json.loads(line[5:])}
            state = parse_answer(_raise_if_not_now(client.get(f"/v1/jobs/{job}")))
            yield state
            if state["state"] in _TERMINAL:
                return
        except httpx.TransportError:
            if time.monotonic() - last_heard > _GIVE_UP_S:
                raise
        time.sleep(_RECONNECT_S)


def _raise_if_not_now(response: httpx.Response) -> httpx.Response:
    """Return the answer. Raises httpx.ConnectError where the gateway, or a proxy for it, has no answer now."""
    if response.status_code in _NOT_NOW:
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
        raise BadInput(problem_sentence(job["error"]) if job.get("error") else f"the job ended in state {job['state']}")
    for warning in job.get("warnings") or []:
        warn(warning)
    where = f", in collection {job['collection']}" if job["collection"] else ""
    console.print(f"done in {job['elapsed_s']:.1f} s: {gateway}/view/{job['asset_key']}{where}")
    return job
