"""The computing of jobs with small pictures and checkpoints 0.5 s apart, not 5, as `fork_server` runs it."""

from __future__ import annotations

from capture2vr.edge.field import checkpoint
from tests.support.workers import small_job

checkpoint.SECONDS = 0.5
work = small_job.work
