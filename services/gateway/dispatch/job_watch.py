"""What dispatcher and run supervisors tell of jobs to whoever counts them."""

from __future__ import annotations

from typing import Protocol

from capture2vr.gateway.jobs.job import Job


class JobWatch(Protocol):
    """Hears of what this gateway does with jobs."""

    def leased(self, job: Job) -> None:
        """A job was leased to a worker."""

    def changed(self, before: Job, after: Job) -> None:
        """A job's run has changed it, or ended it."""

    def run_lost(self, job: Job) -> None:
        """A job's run was lost with its worker."""
