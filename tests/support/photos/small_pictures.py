"""What makes jobs short whose pictures nobody looks at."""

from __future__ import annotations

import importlib
import os
from functools import partial

import pytest

from tests.support.repository import ROOT

TEXTURE_SIDE = 256


def compute_with(patch: pytest.MonkeyPatch, module: str) -> None:
    """Let the processes of the jobs that this process starts run the `work` of a module of the tests."""
    patch.setattr("capture2vr.edge.jobs.job_process._MODULE", module)
    found = os.environ.get("PYTHONPATH", "")
    patch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{found}" if found else str(ROOT))


def draw_small(patch: pytest.MonkeyPatch) -> None:
    """Small pictures of the assets that this process makes: at full size they take 90 % of a small job's seconds."""
    appearance = importlib.import_module("capture2vr.edge.asset.levels")  # here: most tests need none of the worker
    thumbnail = importlib.import_module("capture2vr.edge.render.thumbnail")
    textures = appearance.texture_levels
    patch.setattr(
        appearance,
        "texture_levels",
        lambda *told, most_px, **more: textures(*told, most_px=min(most_px, TEXTURE_SIDE), **more),
    )
    patch.setattr(appearance, "render_sheet", partial(appearance.render_sheet, size=32))
    for name, value in {"THUMBNAIL_SIDE": 32, "TURNING_SIDE": 32, "_SKY_RAYS": 10_000}.items():
        patch.setattr(thumbnail, name, value)
