"""Data classes of a job: the client's order, its state, its lease, its events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.storage.tenant_store import DEFAULT_TENANT

Json = Mapping[str, Any]


class State(StrEnum):
    """State of a job. The last three are final."""

    QUEUED = "QUEUED"
    RUNNING = "RUNNING"
    CANCELLING = "CANCELLING"
    SUCCEEDED = "SUCCEEDED"
    FAILED = "FAILED"
    CANCELLED = "CANCELLED"


_NO_OPTIONS = frozenset({"capture", "asset_key", "most_seconds", "isolate"})  # of a stored order
YIELDED = "YIELDED"
"""The name among a job's `seconds` of what its runs took that made room for other jobs."""

TERMINAL = frozenset({State.SUCCEEDED, State.FAILED, State.CANCELLED})


@dataclass(frozen=True, slots=True)
class Order:
    """What the client ordered: a capture, the key of the asset, and how to make it; it never changes.

    most_seconds  that the job may compute; 0: the workers' own limit alone
    """

    capture: str
    asset_key: str
    options: JobOptions = DEFAULT_OPTIONS
    most_seconds: int = 0

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Order:
        """Convert a JSON document of `as_json`; one of before `cut` has `isolate`: true, false, or null for "auto"."""
        options = {name: value for name, value in document.items() if name not in _NO_OPTIONS}
        isolate = document.get("isolate")
        cut = "" if isolate is None else "object" if isolate else "scene"
        return cls(
            document["capture"],
            document["asset_key"],
            JobOptions.of({"cut": cut, **options}),
            document.get("most_seconds", 0),
        )

    @property
    def as_json(self) -> dict[str, Any]:
        """As the database and exports have it."""
        options = self.options.as_json
        own = {"capture": self.capture, "asset_key": self.asset_key, "most_seconds": self.most_seconds}
        return {**own, "preset": options["preset"], **options}


@dataclass(frozen=True, slots=True)
class Lease:
    """Lease of a job: which gateway supervises it, on which worker, until when.

    holder      id of the gateway that supervises the job; only the owner of the current `fence` may write
    worker      address of the worker that runs it
    fence       fencing token: grows with every lease
    attempts    runs started, not counting those that a worker refused
    until       seconds since the epoch: afterwards other gateways may take the job over
    not_before  seconds since the epoch: earliest start of the next attempt
    run_seq     number of the run's last event in our tables; a new connection asks for those after it
    cancel      whether cancellation was requested
    """

    holder: str = ""
    worker: str = ""
    fence: int = 0
    attempts: int = 0
    until: float = 0.0
    not_before: float = 0.0
    run_seq: int = 0
    cancel: bool = False

    @property
    def refusals(self) -> int:
        """Leases that were no attempt: workers refused the job, or handed it back, or its run was taken over."""
        return self.fence - self.attempts


@dataclass(frozen=True, slots=True)
class Job:
    """A job and its lease. Times are seconds since the epoch, durations are seconds.

    fraction    progress of the whole job, [0,1]; never decreases, not even when a run is repeated
    elapsed_s   since the job was accepted, as of `updated`; survives every restart because `created` does
    last_event  sequence number of its newest event
    tenant      whose job it is: capture, asset key and collection are the tenant's
    token       secret that gateways and workers share, without which a worker neither shows nor stops the run
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
    tenant: str = DEFAULT_TENANT
    token: str = ""
    lease: Lease = field(default_factory=Lease)

    @property
    def ended(self) -> bool:
        """Whether the job has reached a final state."""
        return self.state in TERMINAL

    @property
    def seconds_left(self) -> float:
        """Seconds that its next run may compute; 0: no limit of its own."""
        most = self.order.most_seconds
        return max(1.0, most - self.seconds.get(YIELDED, 0.0)) if most else 0.0

    def elapsed_at(self, now: float) -> float:
        """Return the seconds since the job was accepted; constant once it has ended, whatever the wall clock does."""
        return self.elapsed_s if self.ended else max(self.elapsed_s, now - self.created)


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a job. seq: 1, 2, 3, ...; kind: progress, anchors, published or state; at: seconds since the epoch"""

    job: str
    seq: int
    kind: str
    at: float
    data: Json
