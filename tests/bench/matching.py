"""Photos that are hard to place: how many are, and how exactly, by SIFT alone and with the network's matches.

Each case in a process of its own, on the CPU. Errors are of the cameras' centres, in percent of the walk's extent.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from capture2vr.edge.cameras.learned_matches import is_installed
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.procrustes import procrustes
from capture2vr.edge.read_capture import read_capture
from tests.bench.paper.case_table import print_cases
from tests.bench.photo_sets import PhotoSet, fruit, shell
from tests.bench.texture import cpu_seconds

_PHONE = {"noise": 4.0, "blur": 1.0, "jpeg": 85}
"""Of the rendered photos: a phone's indoors."""

CASES: Mapping[str, Callable[[Path], PhotoSet]] = {
    "stone on stone, 24 photos": lambda folder: shell(folder, 24, **_PHONE),
    "stone on stone, 45 degrees apart, 8 photos": lambda folder: shell(folder, 8, **_PHONE),
    "plain clay on a plain table, 24 photos": lambda folder: shell(folder, 24, contrast=0.08, **_PHONE),
    "clay, 30 degrees apart, 12 photos": lambda folder: shell(folder, 12, contrast=0.15, **_PHONE),
    "plain clay on a cloth that repeats every 25 cm, 20 photos": lambda folder: shell(
        folder, 20, contrast=0.1, repeat_m=0.25, **_PHONE
    ),
    "clay on a cloth that repeats every 15 cm, 16 photos": lambda folder: shell(
        folder, 16, contrast=0.15, repeat_m=0.15, **_PHONE
    ),
    "fruit, every third photo, 7 photos": lambda folder: fruit(),
    "stone on stone, three times around, 300 photos": lambda folder: shell(folder, 300, arc=1080.0, **_PHONE),
}


def one(case: str) -> dict[str, Any]:
    """The figures of a case, measured in this process."""
    with tempfile.TemporaryDirectory() as folder:
        known = CASES[case](Path(folder))
        photos = read_capture(known.source).photos[:: 3 if "every third" in case else 1]
        with patch("capture2vr.edge.cameras.placement_attempts.is_installed", return_value=False):
            alone = _figures(photos, known)
        both = _figures(photos, known) if is_installed() and alone["placed"] < len(photos) else {}
    columns = {"photos": len(photos), **{f"SIFT: {name}": value for name, value in alone.items()}}
    return {**columns, **{f"and network: {name}": both.get(name, "") for name in alone}}


def _figures(photos: tuple[Photo, ...], known: PhotoSet) -> dict[str, Any]:
    """Photos placed, errors of the cameras' centres, and what it took."""
    began, busy = time.perf_counter(), cpu_seconds()
    try:
        views = align(photos).views
    except CaptureError:
        views = ()
    figures = {"placed": len(views), "median %": "", "largest %": ""}
    if views:
        ours = np.array([view.camera_to_world[:3, 3] for view in views])
        true = np.array([known.camera(view.photo.name)[:3, 3] for view in views])
        to_true = procrustes(ours, true, scale=True)
        assert to_true is not None
        off = np.linalg.norm(ours @ to_true[:3, :3].T + to_true[:3, 3] - true, axis=1)
        off *= 100 / np.linalg.norm(np.ptp(np.array(list(known.cameras.values()))[:, :3, 3], axis=0))
        figures |= {"median %": round(float(np.median(off)), 2), "largest %": round(float(off.max()), 2)}
    seconds = {"seconds": round(time.perf_counter() - began), "CPU s": round(cpu_seconds() - busy)}
    return {**figures, **seconds, "peak MB": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024}


def main(arguments: list[str]) -> None:
    """Print the table; a word among the arguments chooses the cases that have it."""
    print_cases("tests.bench.matching", CASES, arguments)


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1])))
