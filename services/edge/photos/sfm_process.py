"""Cameras and sparse points from key points: the problem, its answer, and the child process that finds it.

pycolmap runs in a child, because its native code may end the process, cannot be interrupted and traps SIGTERM.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.capture.nouns import Intrinsics
from services.edge.errors import EdgeError
from services.edge.photos.features import Features

Distortion = tuple[float, float, float, float, float]

PROBLEM = "problem.npz"
ANSWER = "answer.npz"
_LOG = "log"
_POLL_SECONDS = 0.2  # between two ticks; with the child's death it keeps a cancelled job under a second
_SILENT_SECONDS = 600.0  # the longest step between two lines, an adjustment of 300 photos, takes under a minute
_LOG_LINES = 3  # of the child's log that go into the error


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera of the capture.

    intrinsics  at the stored size, pixel centres at integers
    distortion  OpenCV's (k1, k2, p1, p2, k3)
    known       whether the focal length comes from the camera, rather than being a first guess
    """

    intrinsics: Intrinsics
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    known: bool = False


@dataclass(frozen=True, slots=True)
class Problem:
    """What is known of N photos.

    lens_of  (N,) index of each photo's lens
    pairs    (M,2) photos to hold against each other
    pixel    side of one pixel of the features' pictures, in pixels of the stored photos
    poses    (N,4,4) camera_to_world in OpenCV axes where they are known, and then the lenses are too; else None
    """

    lenses: tuple[Lens, ...]
    lens_of: Ints
    features: tuple[Features, ...]
    pairs: Ints
    pixel: float
    poses: Floats | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """The largest model that explains the photos; empty where there is none.

    lenses    of the V photos placed, as solved, or as given with the poses
    model_of  (N,) the model that placed each photo, 0 the largest and the one told here, or -1 for none
    placed    (V,) the photos of that model, in rising order
    poses     (V,4,4) their camera_to_world, OpenCV axes
    xyz       (P,3) float64 points
    seen_point, seen_view, seen_feature (T,)  which point was seen in which of the V views, as which of its key points
    """

    lenses: tuple[Lens, ...]
    model_of: Ints
    placed: Ints
    poses: Floats
    xyz: Floats
    seen_point: Ints
    seen_view: Ints
    seen_feature: Ints


def solve(problem: Problem, tick: Tick = no_tick) -> Answer:
    """Let the child solve it; EdgeError ALIGN_FAILED when it dies. Nothing of it is left behind, whatever happens."""
    with tempfile.TemporaryDirectory(prefix="align-") as name:
        folder = Path(name)
        write_problem(problem, folder / PROBLEM)
        _run(folder, tick)
        return read_answer(folder / ANSWER)


def _run(folder: Path, tick: Tick) -> None:
    log = folder / _LOG
    with log.open("wb") as errors, _child(folder, errors) as child:
        _follow(child, tick)
        code = child.wait()
    if code != 0:
        last = " | ".join(log.read_text(errors="replace").strip().splitlines()[-_LOG_LINES:])
        raise _failed(f"the solver ended with status {code}: {last or 'it said nothing'}")


@contextmanager
def _child(folder: Path, errors: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The solver in a process group of its own, which is gone when this ends."""
    command = [sys.executable, "-m", "services.edge.photos.solve_child", str(folder)]
    child = subprocess.Popen(  # noqa: S603 - our own module
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, bufsize=0, start_new_session=True
    )
    with child:
        try:
            yield child
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)


def _follow(child: subprocess.Popen[bytes], tick: Tick) -> None:
    """Pass the child's progress on until it closes its output, and tick in between, so that a cancel is heard."""
    assert child.stdout is not None
    fraction, heard = 0.0, time.monotonic()
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        while time.monotonic() - heard < _SILENT_SECONDS:
            if selector.select(_POLL_SECONDS):
                line = child.stdout.readline()
                if not line:
                    return
                fraction, heard = float(json.loads(line)["fraction"]), time.monotonic()
            tick(fraction)
    raise _failed(f"the solver said nothing for {_SILENT_SECONDS:.0f} s")


def _failed(message: str) -> EdgeError:
    return EdgeError("ALIGN_FAILED", message, hints=("try again with fewer photos", "send smaller photos"))


def write_problem(problem: Problem, path: Path) -> None:
    arrays: dict[str, NDArray[Any]] = {
        "lenses": _rows(problem.lenses),
        "lens_of": problem.lens_of,
        "counts": np.array([len(each.xy) for each in problem.features]),
        "xy": np.concatenate([each.xy for each in problem.features]),
        "descriptors": np.concatenate([each.descriptors for each in problem.features]),
        "pairs": problem.pairs,
        "pixel": np.array(problem.pixel),
    }
    if problem.poses is not None:
        arrays["poses"] = problem.poses
    np.savez(path, **arrays)  # type: ignore[arg-type]


def read_problem(path: Path) -> Problem:
    with np.load(path) as file:
        arrays = dict(file)
    ends = np.cumsum(arrays["counts"])[:-1]
    parts = zip(np.split(arrays["xy"], ends), np.split(arrays["descriptors"], ends), strict=True)
    return Problem(
        _lenses(arrays["lenses"]),
        arrays["lens_of"],
        tuple(Features(xy, descriptors) for xy, descriptors in parts),
        arrays["pairs"],
        float(arrays["pixel"]),
        arrays.get("poses"),
    )


_ANSWER_ARRAYS = ("model_of", "placed", "poses", "xyz", "seen_point", "seen_view", "seen_feature")


def write_answer(answer: Answer, path: Path) -> None:
    arrays = {name: getattr(answer, name) for name in _ANSWER_ARRAYS}
    np.savez(path, lenses=_rows(answer.lenses), **arrays)


def read_answer(path: Path) -> Answer:
    with np.load(path) as file:
        return Answer(_lenses(file["lenses"]), *(file[name] for name in _ANSWER_ARRAYS))


def _rows(lenses: tuple[Lens, ...]) -> Floats:
    """(L,12): fx, fy, cx, cy, width, height, the distortion, known."""
    rows = [
        (at.fx, at.fy, at.cx, at.cy, at.width, at.height, *lens.distortion, lens.known)
        for lens in lenses
        for at in [lens.intrinsics]
    ]
    return np.array(rows, np.float64).reshape(-1, 12)


def _lenses(rows: Floats) -> tuple[Lens, ...]:
    return tuple(
        Lens(Intrinsics(fx, fy, cx, cy, int(width), int(height)), (k1, k2, p1, p2, k3), bool(known))
        for fx, fy, cx, cy, width, height, k1, k2, p1, p2, k3, known in rows.tolist()
    )
