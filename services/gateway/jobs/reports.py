"""What a worker reports of a run, in the gateway's own words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

CANCELLED = "CANCELLED"
"""Code of the failure that a cancelled run ends with."""


DRAINING = "WORKER_DRAINING"
"""Code of the failure with which a worker that shuts down hands its runs back."""


@dataclass(frozen=True, slots=True)
class Progressed:
    """How far the run is: `fraction` of the whole job in [0,1], `eta_s` seconds left (0: unknown)."""

    seq: int
    stage: str
    fraction: float
    losses: Mapping[str, float] = field(default_factory=dict)
    eta_s: float = 0.0
    message: str = ""


@dataclass(frozen=True, slots=True)
class Beat:
    """The run is alive and has nothing to say."""

    seq: int


@dataclass(frozen=True, slots=True)
class Published:
    """A version of the asset is on the store; `state` is preview or refined, `collection` where it is listed."""

    seq: int
    key: str
    version: int
    state: str
    manifest: str
    collection: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """The run ended without what was asked."""

    seq: int
    code: str
    message: str
    file: str = ""
    hints: tuple[str, ...] = ()
    retryable: bool = False
    stage: str = ""


@dataclass(frozen=True, slots=True)
class Finished:
    """The run ended well: `seconds` by stage."""

    seq: int
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)


Report = Progressed | Beat | Published | Failed | Finished
Last = Failed | Finished


def coalesced(reports: Iterable[Report]) -> list[Report]:
    """The same story in fewer words: of progress within one stage only the latest, and no beat that is followed."""
    told: list[Report] = []
    for report in reports:
        if told and _supersedes(report, told[-1]):
            told[-1] = report
        else:
            told.append(report)
    return told


def _supersedes(new: Report, old: Report) -> bool:
    if isinstance(old, Beat):
        return True
    return isinstance(new, Progressed) and isinstance(old, Progressed) and new.stage == old.stage
