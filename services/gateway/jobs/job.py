"""Data classes of a job: the client's order, its state, its lease, its events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from capture2vr.order.edits import NO_EDITS, Edits
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


TERMINAL = frozenset({State.SUCCEEDED, State.FAILED, State.CANCELLED})


@dataclass(frozen=True, slots=True)
class Order:
    """What the client ordered; it never changes."""

    capture: str
    preset: str
    asset_key: str
    label: str = ""
    target: str = ""
    cut: str = ""  # what to keep: object or scene; "" or auto: the object if the photos were taken around one
    longest_m: float | None = None  # metres between the object's farthest points, where the user knows it
    collection: str = ""  # collection that lists the asset; "": the worker's default
    fill: str = ""  # holes of the mesh to fill: none, unseen or all; "": by the kind of capture
    box: tuple[float, ...] = ()  # left, top, right, bottom of the thing in a single photo, as shares; (): look for it
    description: str = ""
    labels: tuple[str, ...] = ()  # search words of the asset
    visibility: str = ""  # of the asset: private, unlisted or public; "": as it is, or as its collection
    edits: Edits = NO_EDITS  # recipe of what to cut away, what is up and the scale

    @property
    def as_json(self) -> dict[str, Any]:
        """Serialise the order as JSON, for the database and exports."""
        return {**{name: getattr(self, name) for name in self.__slots__}, "edits": self.edits.as_json}


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
