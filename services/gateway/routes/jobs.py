"""/v1/jobs: create, repeat, read, follow (server-sent events), cancel. /v1/presets: the presets that jobs may name."""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from sqlalchemy.exc import SQLAlchemyError
from sse_starlette import EventSourceResponse, ServerSentEvent

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.limits import TenantLimits
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.capture_objects import capture_bytes, unknown_capture
from capture2vr.gateway.jobs.collection_choice import choose_collection
from capture2vr.gateway.jobs.job import Event, Job, Order
from capture2vr.gateway.jobs.state_machine import request_cancel
from capture2vr.gateway.jobs.store import JOB_ID, JobStore
from capture2vr.gateway.languages import for_reader
from capture2vr.gateway.metrics.metrics import Metrics
from capture2vr.gateway.photo_boxes import require_box
from capture2vr.gateway.routes.access_rules import ANYONE, caller_of, limits_of, needs
from capture2vr.gateway.routes.event_streams import (
    HEARTBEAT_S,
    RECONNECT_MS,
    LastEventId,
    known_event,
    stream_events,
)
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import JobAgain, JobPage, JobRequest, JobView, Presets, PresetView, problems
from capture2vr.gateway.waiting import happens_within
from capture2vr.gateway.workers.worker_types import WorkerPreset
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.edits import InvalidEdits, json_schema
from capture2vr.order.option_table import GENERATE
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.entry import read_entry, valid_key
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.store import Store

router = APIRouter(prefix="/v1", tags=["jobs"])

_log = logging.getLogger(__name__)

_FOLLOWS = needs(Scope.CAPTURE, Scope.READ, Scope.MANAGE)
_DATABASE_RETRY_S = 1.0  # between two looks of an event stream at a jobs database that is away

IdempotencyKey = Annotated[
    str,
    Header(
        max_length=200,
        pattern=r"^[\x21-\x7e]*$",
        description="A unique text per job: a repeated request with the same key returns the job of the first one.",
    ),
]


@router.post(
    "/jobs",
    status_code=202,
    response_model=JobView,
    dependencies=[needs(Scope.CAPTURE)],
    responses=problems(400, 404, 409, 413, 415, 422, 429, 503),
)
async def create_job(
    body: JobRequest, request: Request, response: Response, idempotency_key: IdempotencyKey = ""
) -> JobView:
    """Create a job that reconstructs a capture. The answer is sent after the job has been stored."""
    job = await _create_once(body.model_dump_json(), partial(_make_order, body, request), request, idempotency_key)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return JobView.of(job, time.time())


@router.post(
    "/jobs/{job}/again",
    status_code=202,
    response_model=JobView,
    dependencies=[needs(Scope.CAPTURE)],
    responses=problems(400, 404, 409, 413, 415, 422, 429, 503),
)
async def repeat_job(
    job: str,
    body: JobAgain,
    request: Request,
    gateway: GatewayOf,
    response: Response,
    idempotency_key: IdempotencyKey = "",
) -> JobView:
    """Create a job with the key and options of an earlier one, but another cut, edited, or of another capture.

    Nothing is uploaded: another capture is one that is stored already.
    """

    async def changed_order() -> Order:
        earlier = await gateway.job_store.read(JobStore.get, caller_of(request).tenant, job)
        await _require_capture(body.capture or earlier.order.capture, request)
        order = body.order(earlier.order)
        _require_edits(order)
        await _known_preset(order.options.preset, request)
        names = await in_thread(lambda: _names_of(store_of(request), earlier.order))
        return replace(order, options=replace(order.options, names=names))

    content = f"{job} {body.model_dump_json()}"
    repeated = await _create_once(content, changed_order, request, idempotency_key)
    response.headers["Location"] = f"/v1/jobs/{repeated.id}"
    return JobView.of(repeated, time.time())


@router.get("/jobs", response_model=JobPage, dependencies=[_FOLLOWS], responses=problems(422))
async def list_jobs(
    request: Request,
    gateway: GatewayOf,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[
        str, Query(pattern=f"^({JOB_ID.pattern})?$", description="`next` of the previous page: only older jobs.")
    ] = "",
) -> JobPage:
    """List jobs, newest first."""
    now, tenant = time.time(), caller_of(request).tenant
    found = await gateway.job_store.read(JobStore.page, tenant, limit=limit + 1, after=after)
    jobs = [JobView.of(job, now) for job in found[:limit]]
    return JobPage(jobs=jobs, next=jobs[-1].id if len(found) > limit else None)


@router.get("/jobs/{job}", response_model=JobView, dependencies=[_FOLLOWS], responses=problems(404))
async def get_job(job: str, request: Request, gateway: GatewayOf) -> JobView:
    """Get a job's state, progress and result."""
    return JobView.of(await gateway.job_store.read(JobStore.get, caller_of(request).tenant, job), time.time())


@router.post(
    "/jobs/{job}/cancel",
    status_code=202,
    response_model=JobView,
    dependencies=[needs(Scope.CAPTURE)],
    responses=problems(404),
)
async def cancel_job(job: str, request: Request, gateway: GatewayOf) -> JobView:
    """Cancel a job: at once while it is queued, within seconds while it is running. No effect on one that has ended."""
    job_store = gateway.job_store
    await job_store.read(JobStore.get, caller_of(request).tenant, job)
    changed = await job_store.change(job, partial(request_cancel, now=time.time()))
    if not changed.ended:
        gateway.dispatcher.cancel(job)
    return JobView.of(changed, time.time())


@router.get(
    "/jobs/{job}/events",
    response_class=EventSourceResponse,
    dependencies=[_FOLLOWS],
    responses={
        200: {
            "description": "Server-sent events `progress`, `anchors` (a few points, before there is a mesh), "
            "`published`, `state` and `heartbeat` with JSON data; the "
            "stream ends after the job's final `state`",
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
async def follow_job(
    job: str,
    request: Request,
    gateway: GatewayOf,
    after: Annotated[int | None, Query(ge=0, description="Only events with a higher number (`id`).")] = None,
    last_event_id: LastEventId = "",
) -> EventSourceResponse:
    """Follow a job as server-sent events: first all events so far, then new ones, until the job has ended."""
    job_store = gateway.job_store
    tenant = caller_of(request).tenant
    await job_store.read(JobStore.get, tenant, job)  # an unknown job is a 404, not an empty stream
    start = known_event(after, last_event_id)
    return stream_events(_event_stream(job_store, gateway.metrics, tenant, job, start))


@router.get("/presets", response_model=Presets, dependencies=[needs(*Scope)])
async def list_presets(request: Request) -> Presets:
    """List the presets that the caller's jobs may name, the memory that each takes, and the default."""
    known = await _allowed_presets(request)
    return Presets(presets=[PresetView.of(preset) for preset in known.values()], default=next(iter(known)))


@router.get(
    "/schemas/edits",
    response_class=Response,
    dependencies=[ANYONE],
    responses={200: {"content": {"application/schema+json": {}}}},
)
async def edits_schema() -> Response:
    """Get the JSON Schema of `edits`: a recipe of what to cut away, which way is up and the true size."""
    return Response(json.dumps(json_schema()), media_type="application/schema+json")


async def _create_once(
    content: str, make_order: Callable[[], Awaitable[Order]], request: Request, idempotency_key: str
) -> Job:
    """Store a job and wake the dispatcher; for a known idempotency key, return its job.

    content  of the request: a key that comes with another one is refused. Raises Problem.
    """
    gateway = gateway_of(request)
    job_store = gateway.job_store
    sha256 = hashlib.sha256(content.encode()).hexdigest()
    tenant = caller_of(request).tenant
    job: Job | None = await job_store.read(JobStore.find_by_key, tenant, idempotency_key, sha256)
    if job is None:
        limits = await limits_of(request)
        order = replace(await make_order(), most_seconds=_most_seconds(request, limits))
        job = await job_store.write(
            JobStore.create,
            tenant,
            order,
            key=idempotency_key,
            body_sha256=sha256,
            at_once=limits.jobs_at_once,
            per_day=limits.jobs_per_day,
        )
        gateway.dispatcher.wake()
    return job


async def _event_stream(
    job_store: AsyncJobStore, metrics: Metrics, tenant: str, job_id: str, last_seq: int
) -> AsyncIterator[ServerSentEvent]:
    replaying = True
    with job_store.notifier.listen(job_id) as news:
        while True:
            news.clear()
            try:
                job, fresh = await job_store.read(JobStore.job_and_events, tenant, job_id, last_seq)
            except SQLAlchemyError as error:  # it may come back, and then the stream goes on
                _log.warning("the events of %s wait for the jobs database: %s", job_id, error.__cause__ or error)
                await asyncio.sleep(_DATABASE_RETRY_S)
                continue
            for event in fresh:
                yield _sse(event)
                if not replaying:
                    metrics.observe_event_lag(time.time() - event.at)
                last_seq = event.seq
            if fresh and job.last_event > last_seq:  # without any, the rows of the others are lost
                continue
            if job.ended:
                return
            replaying = False
            if not await happens_within(news, HEARTBEAT_S):
                yield _heartbeat(job)


def _sse(event: Event) -> ServerSentEvent:
    data = {"seq": event.seq, **for_reader(event.data)}
    return ServerSentEvent(json.dumps(data), event=event.kind, id=str(event.seq), retry=RECONNECT_MS)


def _heartbeat(job: Job) -> ServerSentEvent:
    data = {
        "state": job.state,
        "stage": job.stage,
        "fraction": job.fraction,
        "elapsed_s": round(job.elapsed_at(time.time()), 3),
        "eta_s": job.eta_s,
    }
    return ServerSentEvent(json.dumps(data), event="heartbeat")


async def _make_order(body: JobRequest, request: Request) -> Order:
    """Validate a job request and return the job's order. Raises Problem."""
    if not valid_key(body.asset_key):
        raise Problem(
            422,
            "KEY_INVALID",
            say("asset_key_must_have_1"),
            hints=(say("put_name_people_into_label"),),
        )
    require_box(body.box)
    preset = await _known_preset(body.preset or body.edits.preset, request)
    await _require_capture(body.capture, request)
    choose = partial(choose_collection, named=body.collection, capture=body.capture, key=body.asset_key)
    order = body.order(preset, await in_thread(lambda: choose(store_of(request))))
    _require_edits(order)
    return order


def _require_edits(order: Order) -> None:
    """Raises Problem EDITS_OTHER_CAPTURE for a recipe that was made for another capture."""
    try:
        order.options.edits.require_capture(order.capture)
    except InvalidEdits as error:
        hints = (say("frame_another_capture_another"), say("leave_capture_out_them"))
        raise Problem(422, "EDITS_OTHER_CAPTURE", say("edits_what", what=error), hints=hints) from None


def _names_of(store: Store, order: Order) -> AssetNames:
    """Return the names that the order's asset has now, which somebody may have changed; else those of the order."""
    try:
        return read_entry(store, order.asset_key).names
    except (FileNotFoundError, CatalogueFault):
        return order.options.names


async def _require_capture(capture: str, request: Request) -> None:
    """Raises Problem CAPTURE_UNKNOWN for a capture that is not stored."""
    try:
        await capture_bytes(store_of(request), capture)
    except (FileNotFoundError, ValueError):
        raise unknown_capture(capture) from None
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", say("store_cannot_be_reached"), retryable=True) from error


async def _known_preset(preset: str, request: Request) -> str:
    """Return the preset, or the default for "".

    Raises Problem PRESET_UNKNOWN for one that no worker offers, GENERATOR_ABSENT for the one that needs a generator,
    PRESET_NOT_ALLOWED for one that is not for the caller.
    """
    known = await _known_presets(request)
    if preset and preset not in known:
        known = await _known_presets(request, refresh=True)  # a worker that started since then may offer more
    if preset == GENERATE not in known:
        raise Problem(422, "GENERATOR_ABSENT", say("generator_absent"), hints=(say("set_edge_generator"),))
    if preset and preset not in known:
        names = ", ".join(known)
        detail = say("no_preset_presets", preset=preset, names=names)
        raise Problem(422, "PRESET_UNKNOWN", detail, hints=(say("use_one", names=names),))
    allowed = await _allowed_presets(request)
    if preset and preset not in allowed:
        hints = (say("use_one", names=", ".join(allowed)), say("ask_operator"))
        raise Problem(403, "PRESET_NOT_ALLOWED", say("preset_not_allowed", preset=preset), hints=hints)
    return preset or next(iter(allowed))


async def _allowed_presets(request: Request) -> Mapping[str, WorkerPreset]:
    """Return the presets that the caller's jobs may name, by name, the default first."""
    known = await _known_presets(request)
    if Scope.OPERATE in caller_of(request).scopes:
        return known
    named = (await limits_of(request)).presets
    allowed = {name: each for name, each in known.items() if (name in named if named else not each.literature)}
    return allowed or dict(islice(known.items(), 1))  # none of those that a tenant may name is on offer


def _most_seconds(request: Request, limits: TenantLimits) -> int:
    """Return how long a job of the caller may compute; 0: as long as a worker lets it."""
    return 0 if Scope.OPERATE in caller_of(request).scopes else limits.job_seconds


async def _known_presets(request: Request, *, refresh: bool = False) -> Mapping[str, WorkerPreset]:
    """Return the workers' presets by name, the default first; those in the settings until a worker has answered."""
    gateway = gateway_of(request)
    workers = gateway.workers
    if refresh or not workers.presets:
        await workers.poll()
    return workers.presets or {name: WorkerPreset(name) for name in gateway.settings.presets}
