"""Reports of a worker about a run, as the gateway's own types (not protobuf)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

CANCELLED = "CANCELLED"
"""Error code of a run that was cancelled."""

DRAINING = "WORKER_DRAINING"
"""Error code of a run that its worker returned because the worker is shutting down."""

JOB_YIELDED = "JOB_YIELDED"
"""Error code of a run that made room for other jobs, and goes on from its checkpoint."""


@dataclass(frozen=True, slots=True)
class RunProgress:
    """Progress of the run. fraction: of the whole job, [0,1]; eta_s: seconds left, 0 if unknown"""

    seq: int
    stage: str
    fraction: float
    losses: Mapping[str, float] = field(default_factory=dict)
    eta_s: float = 0.0
    message: str = ""


@dataclass(frozen=True, slots=True)
class RunHeartbeat:
    """The run is alive; nothing new."""

    seq: int


@dataclass(frozen=True, slots=True)
class AnchorsFound:
    """The points are there; a few of them, to show until there is a mesh. xyz_m: flat, metres; rgb: flat, 0 to 255"""

    seq: int
    xyz_m: tuple[float, ...]
    rgb: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class VersionPublished:
    """A version of the asset was published.

    state       preview or refined; collection: the one that lists it
    grade       its level, because and advice; None: nothing could tell
    held        whether it is held back: its grade says to shoot again, so no list has it
    """

    seq: int
    key: str
    version: int
    state: str
    manifest: str
    collection: str = ""
    grade: Mapping[str, str] | None = None
    held: bool = False


@dataclass(frozen=True, slots=True)
class RunFailed:
    """The run has failed. ran_s: seconds since it began"""

    seq: int
    code: str
    message: str
    file: str = ""
    hints: tuple[str, ...] = ()
    retryable: bool = False
    stage: str = ""
    ran_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RunFinished:
    """The run has succeeded. seconds: by stage"""

    seq: int
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)


Report = RunProgress | RunHeartbeat | AnchorsFound | VersionPublished | RunFailed | RunFinished


def coalesce(reports: Iterable[Report]) -> list[Report]:
    """Drop outdated reports: keep only the latest progress of each stage, and no heartbeat before another report."""
    merged: list[Report] = []
    for report in reports:
        if merged and _supersedes(report, merged[-1]):
            merged[-1] = report
        else:
            merged.append(report)
    return merged


def _supersedes(new: Report, old: Report) -> bool:
    if isinstance(old, RunHeartbeat):
        return True
    return isinstance(new, RunProgress) and isinstance(old, RunProgress) and new.stage == old.stage
