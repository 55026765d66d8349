"""One method on one cloud in a process of its own, so that its memory and its threads are its own."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import SurfaceSamples, sample
from capture2vr.edge.mesh.topology import component_count
from tests.bench.methods import Settings, Unavailable, make
from tests.bench.records import code_version
from tests.support.mesh_metrics import SAMPLES, Quality, compare, gaps_between, welded

ROOT = Path(__file__).parents[2]


def run_cell(points: Floats, truth: Mesh, settings: Settings, timeout_s: float) -> dict[str, Any]:
    """The figures of a cell, or {"failed": why}. Raises Unavailable where the method cannot run here at all."""
    with tempfile.TemporaryDirectory() as folder:
        task = Path(folder) / "task.npz"
        whole = welded(truth)
        np.savez(task, points=points, vertices=whole.vertices, faces=whole.faces, settings=json.dumps(asdict(settings)))
        command = [sys.executable, "-m", "tests.bench.cell", str(task)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, cwd=ROOT, check=False)
        except subprocess.TimeoutExpired:
            return {"failed": f"not done after {timeout_s:.0f} s"}
    if done.returncode:
        last = (done.stderr.strip() or f"ended with {done.returncode}").splitlines()[-1]
        return {"failed": last.replace(f"{ROOT}/", "")[:200]}
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    if "unavailable" in result:
        raise Unavailable(result["unavailable"])
    return result


def measure(task: Path) -> dict[str, Any]:
    """Run the task that `run_cell` wrote: its figures, and the version of the code that made them."""
    with np.load(task) as stored:
        points, truth = stored["points"], Mesh(stored["vertices"], stored["faces"])
        settings = Settings(**json.loads(str(stored["settings"])))
    # The sources may change while hours of cells run: what was imported here is what counts.
    return {"version": code_version(settings.method), **_measured(points, truth, settings)}


def _measured(points: Floats, truth: Mesh, settings: Settings) -> dict[str, Any]:
    try:
        made = make(points, settings)
        if len(made.mesh.faces) == 0:
            return {"failed": "no surface was found"}
        quality = figures_of(made.mesh, truth)
    except Unavailable as error:
        return {"unavailable": str(error)}
    except EdgeError as error:
        return {"failed": f"{error.code}: {error.message}"}
    figures = {
        **quality,
        "seconds": made.seconds,
        "peak_mb": made.peak_mb,
        "consistency": made.consistency,
        "threads": int(os.environ.get("OMP_NUM_THREADS", os.cpu_count() or 1)),
    }
    return {**{name: _plain(value) for name, value in figures.items()}, "remarks": made.remarks}


def figures_of(mesh: Mesh, truth: Mesh) -> dict[str, Any]:
    """All of `Quality`; against a truth without faces only what its points can tell, the rest None."""
    if len(truth.faces):
        return asdict(compare(mesh, truth))
    made = sample(mesh, SAMPLES, np.random.default_rng(0))
    gaps = gaps_between(made, SurfaceSamples(truth.vertices, np.zeros_like(truth.vertices)))
    edges = edges_of(mesh.faces)
    known = {
        "chamfer_l1": gaps.chamfer_l1,
        "chamfer_l2": gaps.chamfer_l2,
        "f_005": gaps.f_score(0.005),
        "f_010": gaps.f_score(0.010),
        "components": component_count(edges.ends),
        "boundary_loops": component_count(edges.border_ends),
        "non_manifold_edges": edges.crowded_count,
    }
    return {each.name: known.get(each.name) for each in fields(Quality)}


def _plain(value: float | int | None) -> float | int | str | None:
    """A number of five figures as JSON has it, which knows no infinity."""
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.5g}") if math.isfinite(value) else "inf"


if __name__ == "__main__":
    print(json.dumps(measure(Path(sys.argv[1]))))
