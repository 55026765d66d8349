"""JSON models of the job and health routes, with examples. Unknown fields of a request are an error, to catch typos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from capture2vr.gateway.coded_views import AllCoded, Coded, QuestionView
from capture2vr.gateway.jobs.job import Job, Order, State
from capture2vr.gateway.languages import for_reader
from capture2vr.gateway.workers.worker_types import WorkerPreset
from capture2vr.order.asset_names import DESCRIPTION_CHARS, LABEL_CHARS, MOST_LABELS, check_description, check_labels
from capture2vr.order.edits import LEAST_M, MOST_M, NO_EDITS, Edits
from capture2vr.order.job_options import JobOptions, check_columns
from capture2vr.order.one_line import one_line
from capture2vr.order.option_table import OPTION_TABLE, CutName, FillName, VisibilityName
from capture2vr.order.questions import questions_of
from capture2vr.order.reading import UnitName
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import TENANT_PATTERN

_EXAMPLE_JOB = "job_019b2f7c8a3e5d1f0a9b8c7d6e5f4a3b"
_EXAMPLE_CAPTURE = "cap_7f3c9a1e5b2d4c68"


class StrictBody(BaseModel):
    """Base of request bodies: unknown fields are an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Label = Annotated[str, Field(max_length=LABEL_CHARS), AfterValidator(one_line)]
Description = Annotated[
    str,
    Field(max_length=DESCRIPTION_CHARS, description="Some lines about the asset, for people."),
    AfterValidator(check_description),
]
Labels = Annotated[
    tuple[str, ...],
    Field(
        max_length=MOST_LABELS,
        description="Tags of the asset, such as a season or a room; also labels in Unity's catalogues.",
        examples=[["summer", "wardrobe"]],
    ),
    AfterValidator(check_labels),
]
TenantName = Annotated[str, Field(pattern=f"^{TENANT_PATTERN}$", max_length=32)]


_Number = Annotated[float, Field(strict=True)]  # `true` is none


def _described(option: str, default: str = "", **limits: Any) -> Any:
    """A field with the help of the table of options; default: what the API does without it."""
    return Field(description=OPTION_TABLE[option].text(default), **limits)


class JobRequest(BaseModel):
    """A job: which capture to reconstruct, how, and as which asset."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={"example": {"capture": _EXAMPLE_CAPTURE, "asset_key": "dress", "label": "Dress"}},
    )

    capture: Annotated[str, Field(max_length=100, description="Id from POST /v1/captures.")]
    asset_key: Annotated[
        str, Field(max_length=200, description="Key by which VR clients find the asset: letters, digits and ._-")
    ]
    preset: Annotated[str, _described("preset", "the `default` of GET /v1/presets", max_length=100)] = ""
    label: Annotated[
        str,
        _described("label", "the asset key", max_length=LABEL_CHARS),
        AfterValidator(one_line),
    ] = ""
    description: Description = ""
    labels: Labels = ()
    target: Annotated[str, _described("target", "none", max_length=100)] = ""
    cut: Annotated[CutName, _described("cut")] = ""
    columns: Annotated[str, _described("columns"), AfterValidator(check_columns)] = ""
    unit: Annotated[UnitName, _described("unit")] = ""
    longest_m: Annotated[float | None, _described("longest_m", strict=True, ge=LEAST_M, le=MOST_M)] = None
    collection: Annotated[
        str, _described("collection", "the one that the upload named, or that has the asset", max_length=200)
    ] = ""
    fill: Annotated[FillName, _described("fill")] = ""
    box: Annotated[list[_Number | str] | None, _described("box", examples=[[0.2, 0.1, 0.8, 0.95]])] = None
    visibility: Annotated[Literal["", VisibilityName], _described("visibility")] = ""
    publish_anyway: Annotated[bool, _described("publish_anyway", strict=True)] = False
    edits: Annotated[Edits, _described("edits")] = NO_EDITS

    @property
    def options(self) -> JobOptions:
        """The options as they were sent."""
        return JobOptions.of({name: getattr(self, name) for name in OPTION_TABLE})

    def order(self, preset: str, collection: str) -> Order:
        """Convert to the job's order, with the preset and the collection that were chosen."""
        options = replace(self.options, preset=preset, collection=collection)
        return Order(self.capture, self.asset_key, options.completed())


class JobAgain(BaseModel):
    """What a repeated job does differently: another capture, cut, columns, unit or edits. The rest is as in the earlier
    job.

    Other edits take the place of the earlier ones; {} takes them away. Edits of one capture do not fit another: with
    another capture those of the earlier job are left out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": {"cut": "scene"}})

    capture: Annotated[
        str | None,
        Field(max_length=100, description="Another capture, such as one that `continues` the earlier job's."),
    ] = None
    cut: Annotated[CutName | None, _described("cut")] = None
    columns: Annotated[Annotated[str, AfterValidator(check_columns)] | None, _described("columns")] = None
    unit: Annotated[UnitName | None, _described("unit")] = None
    edits: Annotated[Edits | None, _described("edits")] = None

    @model_validator(mode="after")
    def _require_change(self) -> JobAgain:
        if not self.model_dump(exclude_none=True):
            raise ValueError(say("say_what_to_be_different"))
        return self

    def order(self, earlier: Order) -> Order:
        """Change the order of the earlier job."""
        options = earlier.options
        if self.capture not in (None, earlier.capture):  # another frame, and another first photo
            earlier = replace(earlier, capture=self.capture)
            named = options.box if options.box and options.box.photo else None
            options = replace(options, box=named, edits=NO_EDITS)
        if self.edits is not None:
            options = replace(options, edits=self.edits).following_recipe()
        if self.columns is not None:
            options = replace(options, columns=self.columns)
        if self.unit is not None:
            options = replace(options, unit=self.unit)
        return replace(earlier, options=options.choosing(cut=options.cut if self.cut is None else self.cut))


class ProblemView(BaseModel):
    """A problem document (RFC 9457). `code` is for programs; `detail` says what is wrong, `hints` what to do, in the
    language of the request's Accept-Language. `detail_i18n` and `hints_i18n` have the codes of these sentences.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "urn:capture2vr:problem:CAPTURE_UNKNOWN",
                "title": "Not Found",
                "status": 404,
                "detail": f"there is no capture {_EXAMPLE_CAPTURE}",
                "code": "CAPTURE_UNKNOWN",
                "retryable": False,
                "hints": [say("upload_first_with_post_v1")],
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
    detail_i18n: Coded = None
    hints_i18n: AllCoded = []


class GradeView(BaseModel):
    """How good a version is. `because` is the cause and `advice` what to do, both "" for a good one."""

    level: Literal["good", "usable", "incomplete", "shoot again"]
    because: str
    because_i18n: Coded = None
    advice: str
    advice_i18n: Coded = None


class PublishedView(BaseModel):
    """A published version of the asset. `collection` is the one that lists it, "" if the worker does not report it.
    `grade` is null where nothing could tell, as of point clouds. `held`: its grade says to shoot again, so it is held
    back: no list has it, and an earlier version goes on being served, until it is restored.
    """

    key: str
    version: int
    state: str
    manifest: str
    collection: str = ""
    grade: GradeView | None = None
    held: bool = False


class Links(BaseModel):
    """URLs of a job and its asset. `again` takes a POST with another capture, cut or edits. `collection` and `place`
    (the asset in its collection) are "" until it is chosen.
    """

    self: str
    events: str
    cancel: str
    again: str
    asset: str
    view: str
    collection: str
    place: str


class JobView(BaseModel):
    """State, progress and result of a job. `fraction` never decreases; `elapsed_s` counts from the job's creation, also
    across restarts. `edits`: the recipe. `collection` lists the asset; "" until the worker has chosen it, if nobody
    named one.
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
    cut: str
    edits: dict[str, Any]
    label: str
    attempts: int
    created: datetime
    updated: datetime
    preview: PublishedView | None
    asset: PublishedView | None
    error: ProblemView | None
    warnings: list[str]
    warnings_i18n: AllCoded = []
    questions: list[QuestionView]
    seconds: dict[str, float]
    links: Links

    @classmethod
    def of(cls, job: Job, now: float) -> JobView:
        """Convert a job. now: the present time, seconds since the epoch"""
        return cls(
            id=job.id,
            state=job.state,
            stage=job.stage,
            fraction=job.fraction,
            elapsed_s=round(job.elapsed_at(now), 3),
            eta_s=job.eta_s,
            preset=job.order.options.preset,
            asset_key=job.order.asset_key,
            collection=_collection(job),
            capture=job.order.capture,
            cut=job.order.options.cut,
            edits=job.order.options.edits.as_json,
            label=job.order.options.names.label,
            attempts=job.lease.attempts,
            created=datetime.fromtimestamp(job.created, UTC),
            updated=datetime.fromtimestamp(job.updated, UTC),
            preview=_published(job.preview),
            asset=_published(job.asset),
            error=ProblemView.model_validate(for_reader(job.error)) if job.error else None,
            **for_reader({"warnings": list(job.warnings), "questions": questions_of(job.warnings)}),
            seconds=dict(job.seconds),
            links=_links(job),
        )


class JobPage(BaseModel):
    """A page of jobs, newest first. `next` is the value of `after` for the next page; null on the last page."""

    jobs: list[JobView]
    next: str | None


class PresetView(BaseModel):
    """A preset. `memory_bytes` is the most memory that its job takes on a worker; `trained`: whether a refined version
    follows the preview; `literature`: whether it is a published method, to compare with, whose own mesh is published
    whatever the verdict; `takes`: the time that it takes, for people, empty where that is minutes or less.
    """

    name: str
    summary: str
    trained: bool
    memory_bytes: int
    literature: bool
    takes: str

    @classmethod
    def of(cls, preset: WorkerPreset) -> PresetView:
        """Convert a worker's preset."""
        return cls(
            name=preset.name,
            summary=for_reader(preset.summary),
            trained=preset.trained,
            memory_bytes=preset.memory_bytes,
            literature=preset.literature,
            takes=for_reader(preset.takes),
        )


class Presets(BaseModel):
    """The presets that a job may name, and the default for jobs that name none."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "presets": [
                    {
                        "name": "draft",
                        "summary": "no training",
                        "trained": False,
                        "memory_bytes": 300000000,
                        "literature": False,
                        "takes": "",
                    }
                ],
                "default": "draft",
            }
        }
    )

    presets: list[PresetView]
    default: str


class Check(BaseModel):
    """Result of one readiness check."""

    ok: bool
    detail: str


class Readiness(BaseModel):
    """Whether the gateway can accept and run jobs, and, for operators, the result of each check."""

    ready: bool
    checks: dict[str, Check]


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that may answer with problem documents of these statuses."""
    content = {"application/problem+json": {"schema": ProblemView.model_json_schema()}}
    return {status: {"description": "A problem document (RFC 9457)", "content": content} for status in statuses}


def _published(asset: Mapping[str, Any] | None) -> PublishedView | None:
    return PublishedView.model_validate(for_reader(asset)) if asset else None


def _collection(job: Job) -> str:
    """Return the collection that the job names, else the one that the worker has chosen, else ""."""
    published = job.asset or job.preview or {}
    return job.order.options.collection or str(published.get("collection", ""))


def _links(job: Job) -> Links:
    here, key = f"/v1/jobs/{job.id}", job.order.asset_key
    collection = f"/v1/collections/{name}" if (name := _collection(job)) else ""
    return Links(
        self=here,
        events=f"{here}/events",
        cancel=f"{here}/cancel",
        again=f"{here}/again",
        asset=f"/v1/assets/{key}",
        view=f"/view/{key}",
        collection=collection,
        place=f"{collection}/assets/{key}" if collection else "",
    )
