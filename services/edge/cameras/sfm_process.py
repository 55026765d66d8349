"""Run structure from motion in a child process: types of the problem and of the result, and their files.

pycolmap runs in a child, because its native code may crash the process, cannot be interrupted and traps SIGTERM.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.cameras.features import Features
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.errors import EdgeError
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say

Distortion = tuple[float, float, float, float, float]

PROBLEM = "problem.npz"
ANSWER = "answer.npz"
_LOG = "log"
_SILENT_SECONDS = (
    600.0  # limit between two progress lines; the longest step, adjusting 300 photos, takes under a minute
)


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics and distortion of one of the capture's cameras.

    intrinsics  for the stored size, pixel centres at integers
    distortion  OpenCV's (k1, k2, p1, p2, k3)
    known       whether the focal length is from the file, not a first guess
    """

    intrinsics: Intrinsics
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    known: bool = False


@dataclass(frozen=True, slots=True)
class SfmProblem:
    """Input of structure from motion for N photos.

    lens_of  (N,) index of each photo's lens
    pairs    (M,2) photos to match
    pixel    side of one pixel of the features' pictures, in pixels of the stored photos
    poses    (N,4,4) camera_to_world in OpenCV axes if they are known, and then the lenses are too; else None
    learned  (T,4) further matches, which a network found, sorted: first photo, second photo, key point of each; or None
    thorough whether a global mapper tries as well where the incremental one leaves photos out
    """

    lenses: tuple[Lens, ...]
    lens_of: Ints
    features: tuple[Features, ...]
    pairs: Ints
    pixel: float
    poses: Floats | None = None
    learned: Ints | None = None
    thorough: bool = False


@dataclass(frozen=True, slots=True)
class SfmResult:
    """Result of structure from motion: the largest model, empty if there is none.

    lenses    of the V placed photos, as computed, or as given with the poses
    model_of  (N,) the model that placed each photo, 0 for the largest, which is the one here; -1 for none
    placed    (V,) the photos of that model, ascending
    poses     (V,4,4) their camera_to_world, OpenCV axes
    xyz       (P,3) float64 points
    seen_point, seen_view, seen_feature (T,)  per observation, indices of the point, of the view among the V, and of the
              view's key point
    """

    lenses: tuple[Lens, ...]
    model_of: Ints
    placed: Ints
    poses: Floats
    xyz: Floats
    seen_point: Ints
    seen_view: Ints
    seen_feature: Ints


def solve(problem: SfmProblem, tick: Tick = no_tick) -> SfmResult:
    """Solve the problem in a child process; its temporary files are always removed.

    Raises EdgeError ALIGN_FAILED when the child fails.
    """
    with tempfile.TemporaryDirectory(prefix="align-") as name:
        folder = Path(name)
        write_problem(problem, folder / PROBLEM)
        _run(folder, tick)
        return read_answer(folder / ANSWER)


def _run(folder: Path, tick: Tick) -> None:
    """Run the child process, which reads the problem in `folder` and writes the result there."""
    command = python_command("-m", "capture2vr.edge.cameras.sfm_child", str(folder))
    try:
        run_child(command, "the solver", folder / _LOG, tick, most_seconds=_SILENT_SECONDS, tells_progress=True)
    except ChildError as error:
        hints = (say("try_again_with_fewer_photos"), say("send_smaller_photos"))
        raise EdgeError("ALIGN_FAILED", str(error), hints=hints) from None


def write_problem(problem: SfmProblem, path: Path) -> None:
    """Write the problem as .npz."""
    arrays: dict[str, NDArray[Any]] = {
        "lenses": _lens_rows(problem.lenses),
        "lens_of": problem.lens_of,
        "counts": np.array([len(each.xy) for each in problem.features]),
        "described": np.array([len(each.descriptors) for each in problem.features]),
        "xy": np.concatenate([each.xy for each in problem.features]),
        "descriptors": np.concatenate([each.descriptors for each in problem.features]),
        "pairs": problem.pairs,
        "pixel": np.array(problem.pixel),
        "thorough": np.array(problem.thorough),
    }
    if problem.poses is not None:
        arrays["poses"] = problem.poses
    if problem.learned is not None:
        arrays["learned"] = problem.learned
    np.savez(path, **arrays)  # type: ignore[arg-type]


def read_problem(path: Path) -> SfmProblem:
    """Read what `write_problem` wrote."""
    with np.load(path) as file:
        arrays = dict(file)
    xy = np.split(arrays["xy"], np.cumsum(arrays["counts"])[:-1])
    descriptors = np.split(arrays["descriptors"], np.cumsum(arrays["described"])[:-1])
    return SfmProblem(
        _lenses(arrays["lenses"]),
        arrays["lens_of"],
        tuple(Features(*each) for each in zip(xy, descriptors, strict=True)),
        arrays["pairs"],
        float(arrays["pixel"]),
        arrays.get("poses"),
        arrays.get("learned"),
        bool(arrays["thorough"]),
    )


_ANSWER_ARRAYS = ("model_of", "placed", "poses", "xyz", "seen_point", "seen_view", "seen_feature")


def write_answer(answer: SfmResult, path: Path) -> None:
    """Write the result as .npz."""
    arrays = {name: getattr(answer, name) for name in _ANSWER_ARRAYS}
    np.savez(path, lenses=_lens_rows(answer.lenses), **arrays)


def read_answer(path: Path) -> SfmResult:
    """Read what `write_answer` wrote."""
    with np.load(path) as file:
        return SfmResult(_lenses(file["lenses"]), *(file[name] for name in _ANSWER_ARRAYS))


def _lens_rows(lenses: tuple[Lens, ...]) -> Floats:
    """Convert lenses to rows (L,12): fx, fy, cx, cy, width, height, the distortion, known."""
    rows = [
        (at.fx, at.fy, at.cx, at.cy, at.width, at.height, *lens.distortion, lens.known)
        for lens in lenses
        for at in [lens.intrinsics]
    ]
    return np.array(rows, np.float64).reshape(-1, 12)


def _lenses(rows: Floats) -> tuple[Lens, ...]:
    """Convert rows (L,12) back to lenses."""
    return tuple(
        Lens(Intrinsics(fx, fy, cx, cy, int(width), int(height)), (k1, k2, p1, p2, k3), bool(known))
        for fx, fy, cx, cy, width, height, k1, k2, p1, p2, k3, known in rows.tolist()
    )
