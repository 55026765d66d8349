"""Tasks of jobs' processes. Imported where no decoder may be, so it imports none."""

from __future__ import annotations

from pathlib import Path

from capture2vr.edge.jobs.job_task import JobTask, Machine
from capture2vr.edge.preset import load_preset
from capture2vr.order.job_options import JobOptions


def task_in(folder: Path, job: str = "job_1", archive: Path = Path("none.zip")) -> JobTask:
    """A draft of one job on the CPU, with a scratch folder of its own in a folder."""
    scratch = folder / job
    scratch.mkdir()
    return JobTask(
        job=job,
        tenant="ada",
        archive=archive,
        scratch=scratch,
        checkpoint=folder / "1.checkpoint",
        options=JobOptions(preset="draft"),
        preset=load_preset("draft"),
        machine=Machine("cpu", 1 << 40),
        trains=False,
        prepared=False,
        saves=False,
        whole=False,
        log_level=30,
    )
