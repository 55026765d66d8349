"""What the gateway knows of workers, and the ways in which they disappoint."""

from __future__ import annotations

from dataclasses import dataclass


class WorkerBusy(Exception):  # noqa: N818 - it reads as what it is
    """The worker takes no more for now, its queue is full or it is draining: ask another, or later."""


class WorkerLost(Exception):  # noqa: N818 - it reads as what it is
    """The stream broke off, or the worker cannot be reached: look for it, then elsewhere."""


class WorkerUnreachable(WorkerLost):
    """There is no connection to the worker."""


class RunUnknown(Exception):  # noqa: N818 - it reads as what it is
    """The worker knows no such run: begin anew."""


class RunKnown(Exception):  # noqa: N818 - it reads as what it is
    """The worker has this run already: attach to it."""


@dataclass(frozen=True, slots=True)
class Preset:
    """What a job may name: `trained` when a refined version follows the preview; `memory_bytes` at most, of its fit."""

    name: str
    summary: str = ""
    trained: bool = False
    memory_bytes: int = 0


@dataclass(frozen=True, slots=True)
class WorkerStatus:
    """What a worker says of itself; `jobs` are those that have not ended there."""

    address: str
    version: str
    device: str
    presets: tuple[Preset, ...]
    slots: int
    free_slots: int
    queued: int
    draining: bool
    jobs: frozenset[str]

    def offers(self, preset: str) -> bool:
        """Whether it takes jobs of this preset."""
        return any(preset == each.name for each in self.presets)
