"""`capture2vr push`: upload a capture to a gateway, start a job, and follow it until it has ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx

from capture2vr.cli.grade_line import grade_line, other_warnings
from capture2vr.cli.progress import StageBar, console, warn
from capture2vr.client.answers import understood
from capture2vr.client.http import open_gateway
from capture2vr.client.jobs import JOB_TIMEOUT, create_job, follow, newest_job, raise_unless_succeeded
from capture2vr.client.names import check_collection, check_key
from capture2vr.client.upload import require_capture, upload
from capture2vr.order.edits import Edits
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions


def push_capture(
    source: Path,
    gateway: str,
    *,
    key: str,
    options: JobOptions = DEFAULT_OPTIONS,
) -> dict[str, Any]:
    """Upload a capture, start a job, follow it, and return the job when it has ended.

    Raises GatewayError with the gateway's error message, BadInput.
    """
    gateway = gateway.rstrip("/")
    require_capture(source)
    check_key(key)  # before megabytes are uploaded
    if options.collection:
        check_collection(options.collection)
    request = {"asset_key": key, "label": key, **options.given}

    def create(receipt: Mapping[str, Any]) -> Any:
        return create_job(client, "/v1/jobs", request, receipt["capture"])

    with open_gateway(gateway, timeout=JOB_TIMEOUT) as client, StageBar() as bar:
        job = upload(client, source, bar, box=options.box, then=create)
        job = _followed(client, job, bar, gateway)
    with understood("job"):
        return _outcome(job, gateway)


def continue_capture(source: Path, gateway: str, *, key: str, cut: str | None, edits: Edits | None) -> dict[str, Any]:
    """Add photos to the capture of an asset, make its next version, and return the job when it has ended.

    The asset's earlier job says all but `cut` and `edits`, and those too where they are None. Raises BadInput, and
    GatewayError with the gateway's message.
    """
    gateway = gateway.rstrip("/")
    require_capture(source)
    request = ({} if cut is None else {"cut": cut}) | ({} if edits is None else {"edits": edits.as_json})

    def create(receipt: Mapping[str, Any]) -> Any:
        return create_job(client, earlier["links"]["again"], request, receipt["capture"])

    with open_gateway(gateway, timeout=JOB_TIMEOUT) as client, StageBar() as bar:
        earlier = newest_job(client, key)
        job = upload(client, source, bar, continues=earlier["capture"], then=create)
        job = _followed(client, job, bar, gateway)
    with understood("job"):
        return _outcome(job, gateway)


def _followed(client: httpx.Client, job: dict[str, Any], bar: StageBar, gateway: str) -> dict[str, Any]:
    """Show a job's progress until it has ended, and return it then."""
    key, is_shown = job["asset_key"], False
    for state in follow(client, job["id"]):
        job = state
        bar.show(job["stage"] or job["state"], job["fraction"], job.get("message") or "", job.get("losses"))
        asset = job.get("asset")
        is_preview = asset and asset["state"] == "preview" and not asset.get("held")
        if is_preview and not is_shown:  # of a draft it is the last state too
            console.print(f"preview  {gateway}/view/{key}")
            is_shown = True
    return job


def _outcome(job: dict[str, Any], gateway: str) -> dict[str, Any]:
    raise_unless_succeeded(job)
    key, asset = job["asset_key"], job["asset"]
    grade = asset.get("grade")
    if grade:
        console.print(grade_line(grade))
    for warning in other_warnings(grade, job.get("warnings") or [], job.get("questions") or []):
        warn(warning)
    if asset.get("held"):
        console.print(f"done in {job['elapsed_s']:.1f} s, and held back: no list has it; {gateway}/#job={job['id']}")
        console.print(f"`capture2vr keep {key} --version {asset['version']}` publishes it all the same")
        return job
    where = f", in collection {job['collection']}" if job["collection"] else ""
    console.print(f"done in {job['elapsed_s']:.1f} s: {gateway}/view/{key}{where}")
    return job
