"""The nouns of a job: what was asked, where it stands, who works on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

Json = Mapping[str, Any]


class State(StrEnum):
    """Where a job stands. The last three are terminal."""

    QUEUED = "QUEUED"
    RUNNING = "RUNNING"
    CANCELLING = "CANCELLING"
    SUCCEEDED = "SUCCEEDED"
    FAILED = "FAILED"
    CANCELLED = "CANCELLED"


TERMINAL = frozenset({State.SUCCEEDED, State.FAILED, State.CANCELLED})


@dataclass(frozen=True, slots=True)
class Order:
    """What a client asked for; never changes."""

    capture: str
    preset: str
    asset_key: str
    label: str = ""
    target: str = ""
    isolate: bool | None = None  # None: where photos were taken around one thing
    longest_m: float | None = None  # between the farthest points of the thing, where the person knows it
    collection: str = ""  # where the asset is listed; "": wherever the worker lists what nobody named one for


@dataclass(frozen=True, slots=True)
class Lease:
    """Who works on a job.

    holder      the gateway that speaks for the job; only the bearer of the current `fence` may write
    worker      address of the worker that runs it
    fence       grows with every lease
    attempts    runs begun, not counting those that a worker turned away
    until       seconds since the epoch: when others may take the job over
    not_before  seconds since the epoch: a job that waits for its next attempt
    run_seq     the last event of this run that is in our tables; a new connection asks for those after it
    cancel      somebody wants it stopped
    """

    holder: str = ""
    worker: str = ""
    fence: int = 0
    attempts: int = 0
    until: float = 0.0
    not_before: float = 0.0
    run_seq: int = 0
    cancel: bool = False


@dataclass(frozen=True, slots=True)
class Job:
    """A job as a client sees it, and its lease. Times are seconds since the epoch, durations seconds.

    fraction    of the whole job, [0,1], never goes back, not even when a run begins anew
    elapsed_s   since the job was accepted, as of `updated`; survives every restart because `created` does
    last_event  sequence number of its newest event
    """

    id: str
    order: Order
    created: float
    updated: float
    state: State = State.QUEUED
    stage: str = ""
    fraction: float = 0.0
    elapsed_s: float = 0.0
    eta_s: float = 0.0
    preview: Json | None = None
    asset: Json | None = None
    error: Json | None = None
    warnings: tuple[str, ...] = ()
    seconds: Json = field(default_factory=dict)
    last_event: int = 0
    lease: Lease = field(default_factory=Lease)

    @property
    def ended(self) -> bool:
        """Whether nothing will happen to it any more."""
        return self.state in TERMINAL

    def elapsed_at(self, now: float) -> float:
        """Seconds since it was accepted, standing still once it ended, whatever the wall clock does."""
        return self.elapsed_s if self.ended else max(self.elapsed_s, now - self.created)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened to a job: `seq` is 1, 2, 3, ...; `kind` is progress, published or state."""

    job: str
    seq: int
    kind: str
    at: float
    data: Json
