"""Status of workers, and the exceptions that a call to a worker can raise."""

from __future__ import annotations

from dataclasses import dataclass

import capture2vr


class WorkerBusy(Exception):  # noqa: N818 - it reads as what it is
    """The worker accepts no jobs now: its queue is full, or it is shutting down. Ask another worker, or ask later."""


class WorkerLost(Exception):  # noqa: N818 - it reads as what it is
    """The stream broke off, or the worker cannot be reached: try to reattach to the run, then use another worker."""


class WorkerUnreachable(WorkerLost):
    """No connection to the worker can be made."""


class RunUnknown(Exception):  # noqa: N818 - it reads as what it is
    """The worker does not know this run: start it again."""


class RunOutOfMemory(RunUnknown):
    """The kernel has killed the worker with this run for want of memory. It was started again."""


class RunKnown(Exception):  # noqa: N818 - it reads as what it is
    """The worker has this run already: attach to it."""


@dataclass(frozen=True, slots=True)
class WorkerPreset:
    """A preset that a worker offers.

    trained       whether a refined version follows the preview
    memory_bytes  the most memory that its training takes
    literature    whether it is a published method, to compare with
    takes         time that it takes, for people
    """

    name: str
    summary: str = ""
    trained: bool = False
    memory_bytes: int = 0
    literature: bool = False
    takes: str = ""


@dataclass(frozen=True, slots=True)
class WorkerStatus:
    """Status that a worker reports.

    memory_bytes  what all its jobs together may take
    jobs          ids of its queued and running jobs
    """

    address: str
    version: str
    device: str
    presets: tuple[WorkerPreset, ...]
    slots: int
    free_slots: int
    queued: int
    draining: bool
    jobs: frozenset[str]
    memory_bytes: int = 0

    @property
    def is_compatible(self) -> bool:
        """Whether the worker is of this gateway's release series (major.minor), and understands all of a job.

        An older one could, say, publish openly what a job wants private, because it does not know the field.
        """
        return _series(self.version) == _series(capture2vr.__version__)

    @property
    def takes_jobs(self) -> bool:
        """Whether the worker gets jobs: it is compatible, and is not shutting down."""
        return self.is_compatible and not self.draining

    @property
    def preset_names(self) -> frozenset[str]:
        """Names of the presets that the worker offers."""
        return frozenset(preset.name for preset in self.presets)


def _series(version: str) -> list[str]:
    return version.split(".")[:2]
