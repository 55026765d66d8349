"""The JSON of the job routes, with examples. Unknown fields of a request are an error: a typo must not be a default."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from services.gateway.jobs.job import Job, Order, State
from services.gateway.workers import Preset

_EXAMPLE_JOB = "job_019b2f7c8a3e5d1f0a9b8c7d6e5f4a3b"
_EXAMPLE_CAPTURE = "cap_7f3c9a1e5b2d4c68"


class JobRequest(BaseModel):
    """What to make of a capture."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={"example": {"capture": _EXAMPLE_CAPTURE, "asset_key": "dress", "label": "Dress"}},
    )

    capture: Annotated[str, Field(max_length=100, description="Id from POST /v1/captures.")]
    asset_key: Annotated[
        str, Field(max_length=200, description="The VR client finds the asset by this: letters, digits and ._-")
    ]
    preset: Annotated[str, Field(max_length=100, description="A name from GET /v1/presets; empty: the default.")] = ""
    label: Annotated[str, Field(max_length=200, description="A name for people; empty: the asset key.")] = ""
    target: Annotated[str, Field(max_length=100, description="Device class whose budget must be met; empty: none.")] = (
        ""
    )
    isolate: Annotated[
        bool | None,
        Field(description="Remove the supporting plane and clutter; null: where photos were taken around one thing."),
    ] = None
    longest_m: Annotated[
        float | None,
        Field(ge=0.001, le=1_000, description="Metres between the farthest points of the thing, where it is known."),
    ] = None

    collection: Annotated[
        str,
        Field(max_length=200, description="Where the asset is listed; empty: what the upload named, or where it is."),
    ] = ""

    def order(self, preset: str, collection: str) -> Order:
        """As the jobs know it, with the preset and the collection that were chosen."""
        return Order(
            capture=self.capture,
            preset=preset,
            asset_key=self.asset_key,
            label=self.label,
            target=self.target,
            isolate=self.isolate,
            longest_m=self.longest_m,
            collection=collection,
        )


class ProblemView(BaseModel):
    """A problem document (RFC 9457)."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "urn:capture2vr:problem:CAPTURE_UNKNOWN",
                "title": "Not Found",
                "status": 404,
                "detail": f"there is no capture {_EXAMPLE_CAPTURE}",
                "code": "CAPTURE_UNKNOWN",
                "retryable": False,
                "hints": ["upload it with POST /v1/captures"],
            }
        }
    )

    type: str
    title: str
    status: int
    detail: str
    code: str
    retryable: bool
    stage: str = ""
    file: str = ""
    hints: list[str] = []


class PublishedView(BaseModel):
    """A version of the asset that is on the store; `collection`: where it is listed, "" if its worker does not say."""

    key: str
    version: int
    state: str
    manifest: str
    collection: str = ""


class Links(BaseModel):
    """Where to go from a job; `collection` and `place`, the asset's row in it, are "" until it is known which."""

    self: str
    events: str
    cancel: str
    asset: str
    view: str
    collection: str
    place: str


class JobView(BaseModel):
    """Where a job stands. The fraction never goes back; elapsed time counts from its acceptance, across restarts.

    `collection` is where the asset is listed; "" until a worker that nobody named one to has chosen.
    """

    id: str
    state: State
    stage: str
    fraction: float
    elapsed_s: float
    eta_s: float
    preset: str
    asset_key: str
    collection: str
    capture: str
    label: str
    attempts: int
    created: datetime
    updated: datetime
    preview: PublishedView | None
    asset: PublishedView | None
    error: ProblemView | None
    warnings: list[str]
    seconds: dict[str, float]
    links: Links

    @classmethod
    def of(cls, job: Job, now: float) -> JobView:
        """A job at the time `now`, seconds since the epoch."""
        return cls(
            id=job.id,
            state=job.state,
            stage=job.stage,
            fraction=job.fraction,
            elapsed_s=round(job.elapsed_at(now), 3),
            eta_s=job.eta_s,
            preset=job.order.preset,
            asset_key=job.order.asset_key,
            collection=_collection(job),
            capture=job.order.capture,
            label=job.order.label,
            attempts=job.lease.attempts,
            created=datetime.fromtimestamp(job.created, UTC),
            updated=datetime.fromtimestamp(job.updated, UTC),
            preview=_published(job.preview),
            asset=_published(job.asset),
            error=ProblemView.model_validate(job.error) if job.error else None,
            warnings=list(job.warnings),
            seconds=dict(job.seconds),
            links=_links(job),
        )


class JobPage(BaseModel):
    """Jobs, newest first; `next` is the `after` of the next page, or null."""

    jobs: list[JobView]
    next: str | None


class PresetView(BaseModel):
    """A preset; its job takes at most `memory_bytes` of a worker. A `trained` one refines the asset after a preview."""

    name: str
    summary: str
    trained: bool
    memory_bytes: int

    @classmethod
    def of(cls, preset: Preset) -> PresetView:
        """A worker's preset, for clients."""
        return cls(name=preset.name, summary=preset.summary, trained=preset.trained, memory_bytes=preset.memory_bytes)


class Presets(BaseModel):
    """What a job may name as its preset, and what is taken where it names none."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "presets": [{"name": "draft", "summary": "no training", "trained": False, "memory_bytes": 300000000}],
                "default": "draft",
            }
        }
    )

    presets: list[PresetView]
    default: str


class Check(BaseModel):
    """One thing that readiness depends on."""

    ok: bool
    detail: str


class Readiness(BaseModel):
    """Whether the gateway can take a job and have it done."""

    ready: bool
    checks: dict[str, Check]


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The `responses` of a route that may answer with problem documents of these statuses."""
    content = {"application/problem+json": {"schema": ProblemView.model_json_schema()}}
    return {status: {"description": "A problem document (RFC 9457)", "content": content} for status in statuses}


def _published(asset: Mapping[str, Any] | None) -> PublishedView | None:
    return PublishedView.model_validate(asset) if asset else None


def _collection(job: Job) -> str:
    """What was asked for, else where the worker has listed it."""
    published = job.asset or job.preview or {}
    return job.order.collection or str(published.get("collection", ""))


def _links(job: Job) -> Links:
    here, key = f"/v1/jobs/{job.id}", job.order.asset_key
    collection = f"/v1/collections/{name}" if (name := _collection(job)) else ""
    return Links(
        self=here,
        events=f"{here}/events",
        cancel=f"{here}/cancel",
        asset=f"/v1/assets/{key}",
        view=f"/view/{key}",
        collection=collection,
        place=f"{collection}/assets/{key}" if collection else "",
    )
