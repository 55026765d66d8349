"""The computing of jobs with small pictures, as `fork_server` runs it."""

from __future__ import annotations

import pytest

from capture2vr.edge.jobs import job_work
from tests.support.photos.small_pictures import draw_small

draw_small(pytest.MonkeyPatch())
work = job_work.work
