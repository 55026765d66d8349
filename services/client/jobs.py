"""Jobs of a gateway by HTTP: create one, and follow it through lost connections until it has ended."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Iterator, Mapping
from typing import Any, get_args
from urllib.parse import quote

import httpx

from capture2vr.client.answers import parse_answer, problem_error, understood
from capture2vr.client.nouns import JobState
from capture2vr.errors import BadInput, JobFailed

JOB_TIMEOUT = httpx.Timeout(30.0, read=60.0)
"""The gateway sends an event at least every 15 s while a job runs."""
_RECONNECT_S = 1.0  # pause before reconnecting
_GIVE_UP_S = 120.0  # without an answer of the gateway; a restart takes seconds
_NOT_NOW = {429, 502, 503, 504}  # 429: of other requests of the tenant there were too many
_TERMINAL = {"SUCCEEDED", "FAILED", "CANCELLED"}
_STATES = get_args(JobState)


def create_job(client: httpx.Client, path: str, request: Mapping[str, Any], capture: str) -> Any:
    """Create a job of a capture that was uploaded. Raises BadInput, httpx.TransportError.

    One key for all attempts: the one after a lost answer finds the job, and creates no second one.
    """
    headers, began = {"Idempotency-Key": uuid.uuid4().hex}, time.monotonic()
    while True:
        try:
            return parse_answer(client.post(path, json={**request, "capture": capture}, headers=headers))
        except httpx.TransportError:
            if time.monotonic() - began > _GIVE_UP_S:
                raise
        time.sleep(_RECONNECT_S)


def newest_job(client: httpx.Client, key: str) -> Any:
    """Return the job that made the newest version of an asset. Raises BadInput."""
    entry = parse_answer(client.get(f"/v1/assets/{quote(key, safe='')}"))
    with understood("list of versions"):
        made = [version for version in entry.get("versions") or [] if version.get("job")]
        newest = max(made, key=lambda each: int(each["version"]), default=None)
    if newest is None:
        raise BadInput(
            f"{key}: no job of this gateway has made it, so there is no capture to continue: push all photos"
        )
    return parse_answer(client.get(f"/v1/jobs/{quote(str(newest['job']), safe='')}"))


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
                        yield {"stage": "", "fraction": 0.0, "state": "RUNNING", **_event(line[5:])}
            state = parse_answer(_raise_if_not_now(client.get(f"/v1/jobs/{job}")))
            with understood("job"):
                _STATES.index(state["state"])  # of another one nobody knows whether the job has ended
            yield state
            if state["state"] in _TERMINAL:
                return
        except httpx.TransportError:
            if time.monotonic() - last_heard > _GIVE_UP_S:
                raise
        time.sleep(_RECONNECT_S)


def _event(text: str) -> dict[str, Any]:
    """Parse an event's data. Raises GatewayError."""
    with understood("event of a job"):
        return dict(json.loads(text))


def _raise_if_not_now(response: httpx.Response) -> httpx.Response:
    """Return the answer. Raises httpx.ConnectError where the gateway, or a proxy for it, has no answer now."""
    if response.status_code in _NOT_NOW:
        raise httpx.ConnectError(f"it answered {response.status_code}")
    return response


def raise_unless_succeeded(job: Mapping[str, Any]) -> None:
    """Raises JobFailed with the error of a job that has ended without an asset."""
    if job["state"] == "SUCCEEDED":
        return
    if job.get("error"):
        raise problem_error(job["error"], kind=JobFailed)
    raise JobFailed(f"the job ended in state {job['state']}")
