"""/v1/jobs: start a job, look at it, follow it, stop it. /v1/presets: what it may name."""

from __future__ import annotations

import asyncio
import hashlib
import json
import time
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from sse_starlette import EventSourceResponse, ServerSentEvent

from services.gateway.errors import Problem
from services.gateway.jobs.desk import Desk
from services.gateway.jobs.job import Event, Job, Order
from services.gateway.jobs.place import collection_for
from services.gateway.jobs.source import capture_bytes
from services.gateway.jobs.store import JOB_ID, JobStore
from services.gateway.jobs.transitions import cancel_requested
from services.gateway.metrics import Metrics
from services.gateway.routes.objects import in_thread, store_of
from services.gateway.schemas import JobPage, JobRequest, JobView, Presets, PresetView, problems
from services.gateway.workers import Preset
from services.storage.catalogue import valid_key

router = APIRouter(prefix="/v1", tags=["jobs"])

_HEARTBEAT_S = 10.0  # between words on an event stream: proxies cut silent connections after 30 to 60 s
_RECONNECT_MS = 1000  # what a browser waits before it reconnects
_SEND_TIMEOUT_S = 30.0  # a phone that reads nothing for so long is gone

IdempotencyKey = Annotated[
    str,
    Header(
        max_length=200,
        pattern=r"^[\x21-\x7e]*$",
        description="Makes a repeated request find the job that the first one made.",
    ),
]


@router.post("/jobs", status_code=202, response_model=JobView, responses=problems(400, 404, 409, 413, 415, 422, 503))
async def create(
    body: JobRequest, request: Request, response: Response, idempotency_key: IdempotencyKey = ""
) -> JobView:
    """Queue a reconstruction of a capture. It is on disk before this answers."""
    desk: Desk = request.app.state.desk
    body_sha256 = hashlib.sha256(body.model_dump_json().encode()).hexdigest()
    job = await desk.read(JobStore.by_key, idempotency_key, body_sha256)
    if job is None:
        order = await _checked(body, request)
        job = await desk.write(JobStore.create, order, key=idempotency_key, body_sha256=body_sha256)
        request.app.state.dispatcher.wake()
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return JobView.of(job, time.time())


@router.get("/jobs", response_model=JobPage, responses=problems(422))
async def page(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[
        str, Query(pattern=f"^({JOB_ID.pattern})?$", description="Only jobs older than this one: a page's `next`.")
    ] = "",
) -> JobPage:
    """Jobs, newest first."""
    now = time.time()
    found = await request.app.state.desk.read(JobStore.page, limit=limit + 1, after=after)
    jobs = [JobView.of(job, now) for job in found[:limit]]
    return JobPage(jobs=jobs, next=jobs[-1].id if len(found) > limit else None)


@router.get("/jobs/{job}", response_model=JobView, responses=problems(404))
async def look(job: str, request: Request) -> JobView:
    """Where a job stands."""
    return JobView.of(await request.app.state.desk.read(JobStore.get, job), time.time())


@router.post("/jobs/{job}/cancel", status_code=202, response_model=JobView, responses=problems(404))
async def cancel(job: str, request: Request) -> JobView:
    """Stop a job: at once while it waits, within seconds while it runs. Nothing happens to one that has ended."""
    changed: Job = await request.app.state.desk.change(job, partial(cancel_requested, now=time.time()))
    if not changed.ended:
        request.app.state.dispatcher.cancel(job)
    return JobView.of(changed, time.time())


@router.get(
    "/jobs/{job}/events",
    response_class=EventSourceResponse,
    responses={
        200: {
            "description": "Events `progress`, `published`, `state` and `heartbeat`; the data is JSON, the stream ends "
            "behind the job's last state",
            "content": {
                "text/event-stream": {
                    "schema": {"type": "string"},
                    "example": "id: 7\r\nevent: progress\r\n"
                    'data: {"state": "RUNNING", "stage": "FITTING", "fraction": 0.31, "elapsed_s": 4.2}\r\n\r\n',
                }
            },
        },
        **problems(404, 422),
    },
)
async def events(
    job: str,
    request: Request,
    after: Annotated[int | None, Query(ge=0, description="Only events beyond this number.")] = None,
    last_event_id: Annotated[
        str, Header(pattern=r"^[0-9]{0,15}$", description="What a browser sends when it reconnects.")
    ] = "",
) -> EventSourceResponse:
    """Follow a job: what happened so far, then what happens, until it has ended."""
    desk: Desk = request.app.state.desk
    await desk.read(JobStore.get, job)  # an unknown job is a 404, not an empty stream
    start = int(last_event_id) if last_event_id else after or 0
    return EventSourceResponse(
        _told(desk, request.app.state.metrics, job, start),
        ping=3600,  # ours carry the job's state and are events that a page can see
        send_timeout=_SEND_TIMEOUT_S,
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


@router.get("/presets", response_model=Presets)
async def presets(request: Request) -> Presets:
    """What the workers offer, and what it takes of them."""
    known = await _known_presets(request)
    return Presets(presets=[PresetView.of(preset) for preset in known.values()], default=next(iter(known)))


async def _told(desk: Desk, metrics: Metrics, job_id: str, seen: int) -> AsyncIterator[ServerSentEvent]:
    replaying = True
    with desk.hub.listen(job_id) as news:
        while True:
            news.clear()
            job, fresh = await desk.read(JobStore.since, job_id, seen)
            for event in fresh:
                yield _sse(event)
                if not replaying:
                    metrics.sent(time.time() - event.at)
                seen = event.seq
            if job.last_event > seen:
                continue
            if job.ended:
                return
            replaying = False
            if not await _within(news, _HEARTBEAT_S):
                yield _heartbeat(job)


async def _within(news: asyncio.Event, seconds: float) -> bool:
    try:
        return await asyncio.wait_for(news.wait(), seconds)
    except TimeoutError:
        return False


def _sse(event: Event) -> ServerSentEvent:
    data = {"seq": event.seq, **event.data}
    return ServerSentEvent(json.dumps(data), event=event.kind, id=str(event.seq), retry=_RECONNECT_MS)


def _heartbeat(job: Job) -> ServerSentEvent:
    data = {
        "state": job.state,
        "stage": job.stage,
        "fraction": job.fraction,
        "elapsed_s": round(job.elapsed_at(time.time()), 3),
        "eta_s": job.eta_s,
    }
    return ServerSentEvent(json.dumps(data), event="heartbeat")


async def _checked(body: JobRequest, request: Request) -> Order:
    """The job's order. Raises Problem for what cannot become a job."""
    if not valid_key(body.asset_key):
        raise Problem(
            422,
            "KEY_INVALID",
            "an asset key has 1 to 100 letters, digits, '.', '_' or '-', and begins with a letter or digit",
            hints=("put names for people into label",),
        )
    preset = await _known_preset(body.preset, request)
    store = store_of(request)
    try:
        await capture_bytes(store, body.capture)
    except (FileNotFoundError, ValueError):
        raise Problem(
            404,
            "CAPTURE_UNKNOWN",
            f"there is no capture '{body.capture}'",
            hints=("upload it with POST /v1/captures",),
        ) from None
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", "the store cannot be reached", retryable=True) from error
    asked = partial(collection_for, named=body.collection, capture=body.capture, key=body.asset_key)
    return body.order(preset, await in_thread(lambda: asked(store)))


async def _known_preset(preset: str, request: Request) -> str:
    """The preset, or the default for "". Raises Problem PRESET_UNKNOWN for one that no worker offers."""
    known = await _known_presets(request)
    if preset and preset not in known:
        known = await _known_presets(request, ask=True)  # a worker that started since may offer more
    if preset and preset not in known:
        names = ", ".join(known)
        detail = f"there is no preset '{preset}'; known are: {names}"
        raise Problem(422, "PRESET_UNKNOWN", detail, hints=(f"use one of: {names}",))
    return preset or next(iter(known))


async def _known_presets(request: Request, *, ask: bool = False) -> Mapping[str, Preset]:
    """What workers offer, by name, the default first; what the settings say while none has been heard of."""
    edge = request.app.state.edge
    if ask or not edge.presets:
        await edge.workers()
    return edge.presets or {name: Preset(name) for name in request.app.state.settings.presets}
