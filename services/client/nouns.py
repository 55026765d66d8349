"""What a gateway tells a `Client`, as frozen dataclasses: captures, jobs, and the progress of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from capture2vr.client.answers import understood

JobState = Literal["QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED"]


@dataclass(frozen=True, slots=True)
class UploadProgress:
    """Progress of an upload.

    stage     "UPLOADING", or "CHECKING" while the gateway has the capture inspected
    fraction  of the bytes that the gateway has, [0,1]
    message   for people, such as "12.3 of 96.0 MB"
    """

    stage: str
    fraction: float
    message: str = ""


@dataclass(frozen=True, slots=True)
class StoredCapture:
    """A capture that a gateway has stored.

    id        for `Client.start`
    kind      "points", "rgbd", "photos" or "image"; "", as format, frames and points, while no worker has read it
    bytes     size of the stored archive
    warnings  sentences for people, such as photos that will not be used
    files     verdict for each file: "ok", or why it was left out
    """

    id: str
    name: str
    kind: str
    format: str
    frames: int
    points: int
    bytes: int
    warnings: tuple[str, ...]
    files: Mapping[str, str]

    @classmethod
    def of(cls, receipt: Mapping[str, Any]) -> StoredCapture:
        """Convert a receipt of the API."""
        with understood("receipt of a capture"):
            return cls(
                id=str(receipt["capture"]),
                name=str(receipt["name"]),
                kind=str(receipt["kind"]),
                format=str(receipt["format"]),
                frames=int(receipt["frames"]),
                points=int(receipt["points"]),
                bytes=int(receipt["bytes"]),
                warnings=tuple(receipt["warnings"]),
                files={str(each["file"]): str(each["verdict"]) for each in receipt["files"]},
            )


@dataclass(frozen=True, slots=True)
class JobProgress:
    """One event of a job.

    state      of the job
    stage      "ALIGNING", "FITTING", …; "" before a worker has begun
    fraction   of the whole job, [0,1]; it never goes back
    message    for people; losses: of a training, by name
    elapsed_s  seconds since the job was created; eta_s: seconds that are left, 0 where that is not known
    published  "preview" or "refined" where a version of the asset was published just now, else ""
    """

    state: JobState
    stage: str
    fraction: float
    message: str = ""
    losses: Mapping[str, float] = field(default_factory=dict)
    elapsed_s: float = 0.0
    eta_s: float = 0.0
    published: str = ""

    @classmethod
    def of(cls, event: Mapping[str, Any]) -> JobProgress:
        """Convert an event of the API, or the job itself."""
        with understood("event of a job"):
            return cls(
                state=event["state"],
                stage=str(event["stage"]),
                fraction=float(event["fraction"]),
                message=str(event.get("message") or ""),
                losses=dict(event.get("losses") or {}),
                elapsed_s=float(event.get("elapsed_s") or 0.0),
                eta_s=float(event.get("eta_s") or 0.0),
                published="" if "links" in event else str((event.get("asset") or {}).get("state", "")),
            )


@dataclass(frozen=True, slots=True)
class RemoteJob:
    """A job of a gateway.

    asset_key   of the asset that it makes; capture: id of what it is made from
    fraction    of the whole job, [0,1]; stage: where it is
    elapsed_s   seconds since it was created, until it ended
    version     of the asset that it has published; 0: none yet
    error       one line for people, "" where it has not failed; error_code: for programs
    warnings    sentences for people
    grade       of that version: "good", "usable", "incomplete" or "shoot again"; "" where nothing could tell
    because     the grade's cause, advice: what to do; "" for a good one
    held        whether that version is held back, because it says to shoot again: no list has it until `Client.keep`
    """

    id: str
    state: JobState
    stage: str
    fraction: float
    elapsed_s: float
    preset: str
    asset_key: str
    collection: str
    capture: str
    version: int
    error: str
    error_code: str
    warnings: tuple[str, ...]
    grade: str = ""
    because: str = ""
    advice: str = ""
    held: bool = False

    @property
    def has_ended(self) -> bool:
        """Whether it has succeeded, failed or was cancelled."""
        return self.state in ("SUCCEEDED", "FAILED", "CANCELLED")

    @classmethod
    def of(cls, job: Mapping[str, Any]) -> RemoteJob:
        """Convert a job of the API."""
        with understood("job"):
            error, published = job["error"] or {}, job["asset"] or job["preview"] or {}
            grade = published.get("grade") or {}
            return cls(
                id=str(job["id"]),
                state=job["state"],
                stage=str(job["stage"]),
                fraction=float(job["fraction"]),
                elapsed_s=float(job["elapsed_s"]),
                preset=str(job["preset"]),
                asset_key=str(job["asset_key"]),
                collection=str(job["collection"]),
                capture=str(job["capture"]),
                version=int(published.get("version", 0)),
                error=str(error.get("detail", "")),
                error_code=str(error.get("code", "")),
                warnings=tuple(job["warnings"]),
                grade=str(grade.get("level", "")),
                because=str(grade.get("because", "")),
                advice=str(grade.get("advice", "")),
                held=bool(published.get("held", False)),
            )
