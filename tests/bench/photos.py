"""Photos to points: seconds per stage, and distance from a surface that is known. Each case in a process of its own."""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.ndimage
import trimesh

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.cameras.screening import screen
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.mesh.align_to_reference import align_to_surface, measure_overlay
from capture2vr.edge.photos.depth_maps import depth_frames
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.read_capture import read_capture
from tests.bench.paper.case_table import print_cases
from tests.bench.photo_sets import PhotoSet, film, fruit, shell

CASES = (
    "fruit, 20 photos of 600 x 400",
    "fruit with given cameras, 20 of 600 x 400",
    "rendered shell, 25 of 1280 x 960",
    "rendered shell, film of 12 s, 1280 x 720",
    "rendered shell, 100 of 1280 x 960",
)
_SAMPLES = 200_000
SEEN_BY = 3
"""Photos that must see a part of a reference, as many as have to agree about a point."""

_PIXELS = 160  # of the picture in which it is told what hides what: 200,000 samples leave no holes in it
_BEHIND = 0.03  # of the thing's size: nearer behind a surface is itself, seen aslant


def one(case: str) -> dict[str, Any]:
    """The figures of a case, measured in this process."""
    with tempfile.TemporaryDirectory() as folder:
        photo_set = _photo_set(case, Path(folder))
        seconds: dict[str, float] = {}
        with _timed(seconds, "read"):
            capture = read_capture(photo_set.source)
        with _timed(seconds, "screen"):
            photos, _ = screen(capture.photos, tick=lambda fraction: None)
        with _timed(seconds, "align"):
            aligned = align(photos)
        with _timed(seconds, "sweep"):
            depth_frames(aligned)
        depth = to_depth(capture)
        with _timed(seconds, "fuse"):
            points = to_points(depth, cut="object")
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {
        "placed": f"{len(depth.frames)} of {len(capture.photos)}",
        **seconds,
        "points": len(points),
        **_errors(points.xyz, depth.frames, photo_set),
        "peak MB": peak // 1024,
    }


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] = round(time.perf_counter() - began, 1)


def _photo_set(case: str, folder: Path) -> PhotoSet:
    """Make the photos of a case, in a folder where they are not there yet."""
    if case.startswith("fruit"):
        return fruit(folder if "given" in case else None)
    return film(folder) if "film" in case else shell(folder, int(case.split()[2].rstrip(",")))


def _errors(xyz: Floats, frames: tuple[Frame, ...], photo_set: PhotoSet) -> dict[str, float]:
    """Of the points on the thing, in percent of its size, after the best similarity; completeness within 1 %, of all of
    the surface and of what three photos or more see: the underside of a thing on a table is in none."""
    truth, camera = photo_set.truth, photo_set.camera
    assert truth is not None
    surface, face = trimesh.sample.sample_surface(truth, _SAMPLES, seed=0)
    ours = np.stack([frame.camera_to_world[:3, 3] for frame in frames])
    theirs = np.stack([camera(frame.name)[:3, 3] for frame in frames])
    laid, _, _ = trimesh.registration.procrustes(ours, theirs, reflection=False)
    normals = truth.face_normals[face]
    over = align_to_surface(xyz, surface, normals, laid)
    found = measure_overlay(over, surface, normals)
    # In our cameras' frame, because theirs have another lens.
    back, _, _ = trimesh.registration.procrustes(over, xyz, reflection=False)
    shown_to = surface @ back[:3, :3].T + back[:3, 3]
    seen = sum(is_seen(frame.camera_to_world, frame.intrinsics, shown_to) for frame in frames) >= SEEN_BY
    shown = measure_overlay(over, surface[seen], normals[seen])
    return {
        "median %": round(100 * found.median, 3),
        "90th %": round(100 * found.p90, 3),
        "within 1 %": round(100 * found.complete, 1),
        "seen %": round(100 * seen.mean(), 1),
        "of it within 1 %": round(100 * shown.complete, 1),
    }


def is_seen(pose: Floats, camera: Intrinsics, surface: Floats) -> Bools:
    """(M,) which samples are nothing's back: no other lies before them in their pixel or beside it."""
    camera = camera.scaled_to(_PIXELS, round(_PIXELS * camera.height / camera.width))
    x, y, z = np.linalg.inv(pose)[:3] @ np.vstack([surface.T, np.ones(len(surface))])
    ahead = np.where(z > 0, z, np.inf)
    u = np.rint(camera.fx * x / ahead + camera.cx).astype(int)
    v = np.rint(camera.fy * y / ahead + camera.cy).astype(int)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (v[inside], u[inside]), z[inside])
    nearest = scipy.ndimage.minimum_filter(nearest, 3)
    seen = np.zeros(len(surface), bool)
    seen[inside] = z[inside] < nearest[v[inside], u[inside]] + _BEHIND * np.ptp(surface, axis=0).max()
    return seen


def main(arguments: list[str]) -> None:
    """Print the table; a word among the arguments chooses the cases that have it."""
    print_cases("tests.bench.photos", CASES, arguments)


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1])))
