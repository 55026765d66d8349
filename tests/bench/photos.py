"""Photos to points: seconds per stage, and distance from a surface that is known. Each case in a process of its own."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from services.edge.arrays import Floats
from services.edge.capture import read_capture
from services.edge.capture.nouns import Capture, Frame
from services.edge.mesh.registration import laid_over, measured
from services.edge.photos.align import align
from services.edge.photos.depths import depth_frames
from services.edge.photos.screen import screen
from services.edge.photos.to_depth import to_depth
from services.edge.points import to_points
from tests.bench.cell import ROOT
from tests.conftest import data_folder
from tests.edge.walkaround import render_walkaround

CASES = ("fruit, 20 photos of 600 x 400", "rendered shell, 25 of 1280 x 960", "rendered shell, 100 of 1280 x 960")
_SAMPLES = 200_000


def one(case: str) -> dict[str, Any]:
    """The figures of a case, measured in this process."""
    with tempfile.TemporaryDirectory() as folder:
        capture, cameras, truth = _fruit() if case.startswith("fruit") else _shell(Path(folder), int(case.split()[2]))
        seconds: dict[str, float] = {}
        with _timed(seconds, "screen"):
            photos, _ = screen(capture.photos, tick=lambda fraction: None)
        with _timed(seconds, "align"):
            aligned = align(photos)
        with _timed(seconds, "sweep"):
            depth_frames(aligned)
        depth = to_depth(capture)
        with _timed(seconds, "fuse"):
            points = to_points(depth, isolate=True)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {
        "placed": f"{len(depth.frames)} of {len(capture.photos)}",
        **seconds,
        "points": len(points),
        **_errors(points.xyz, depth.frames, cameras, truth),
        "peak MB": peak // 1024,
    }


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] = round(time.perf_counter() - began, 1)


def _fruit() -> tuple[Capture, dict[str, Floats], trimesh.Trimesh]:
    """The photos, and the cameras and the mesh that another program made from them at full size."""
    folder = data_folder() / "photos_fruit"
    poses = {
        f"{camera.get('label')}.JPG": np.array((camera.findtext("transform") or "").split(), float).reshape(4, 4)
        for camera in ElementTree.parse(folder / "camera.xml").getroot().iter("camera")
    }
    return read_capture(folder / "images"), poses, trimesh.load_mesh(folder / "foo.obj", process=False)


def _shell(folder: Path, views: int) -> tuple[Capture, dict[str, Floats], trimesh.Trimesh]:
    walk = render_walkaround(folder, views=views, size=(1280, 960))
    poses = {photo.name: pose for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True)}
    return read_capture(folder), poses, trimesh.Trimesh(walk.thing.vertices, walk.thing.faces, process=False)


def _errors(
    xyz: Floats, frames: tuple[Frame, ...], cameras: dict[str, Floats], truth: trimesh.Trimesh
) -> dict[str, float]:
    """Of the points on the thing, in percent of its size, after the best similarity; completeness within 1 %."""
    surface, face = trimesh.sample.sample_surface(truth, _SAMPLES, seed=0)
    ours = np.stack([frame.camera_to_world[:3, 3] for frame in frames])
    theirs = np.stack([cameras[frame.name][:3, 3] for frame in frames])
    laid, _, _ = trimesh.registration.procrustes(ours, theirs, reflection=False)
    normals = truth.face_normals[face]
    found = measured(laid_over(xyz, surface, normals, laid), surface, normals)
    return {
        "median %": round(100 * found.median, 3),
        "90th %": round(100 * found.p90, 3),
        "within 1 %": round(100 * found.complete, 1),
    }


def main(arguments: list[str]) -> None:
    """Print the table; a word among the arguments chooses the cases that have it."""
    chosen = [case for case in CASES if all(word in case for word in arguments)]
    for number, case in enumerate(chosen):
        command = [sys.executable, "-m", "tests.bench.photos", case]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        if done.returncode:
            raise SystemExit(done.stderr)
        figures = json.loads(done.stdout.splitlines()[-1])
        if not number:
            print(f"| capture | {' | '.join(figures)} |\n|{'---|' * (len(figures) + 1)}")
        print(f"| {case} | {' | '.join(map(str, figures.values()))} |", flush=True)


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1])))
