"""RGB-D walks of 500 to 2,000 frames through a simulated flat: time, memory, and distance from the true surface.

A phone's depth camera is carried through every room of a flat and back (`tests/support/flat_walks.py`), 125 frames a
room. The folder is read and reconstructed by preset scene-tiles in a process of its own, and its finest tiles are
compared with the truth; so are the fused points alone, and the way of the camera where it is computed without the
poses, before and after loops are closed. What is finished is kept; `--show` only prints.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats, no_tick
from capture2vr.edge.capture.nouns import Frame
from tests.bench.data_files import PICTURES
from tests.bench.scenes import NEAR_M, compare, cpu_seconds, pictures
from tests.support.flat_walks import FlatWalk, flat_walk

KEPT = Path(__file__).with_name("rgbd_walk.json")
ROOMS = {500: 4, 2000: 16}
"""Rooms by the number of frames."""
_SAY_S = 10.0  # between two lines about the progress


@dataclass(frozen=True, slots=True)
class PointFigures:
    """What the points of a walk with poses took, and how good they are.

    points     fused, of which tiles are made; views: pictures that tiles choose from
    peak_mb    of resident memory
    mean_mm    mean distance of points from the true surface; off: share of them more than 2 cm away
    """

    frames: int
    points: int
    views: int
    cpu_s: float
    peak_mb: float
    mean_mm: float
    off: float


@dataclass(frozen=True, slots=True)
class TileFigures:
    """What a walk took from its folder to its tiles, and how good they are: as of bench scenes."""

    frames: int
    tiles: int
    triangles: int
    megabytes: float
    cpu_minutes: float
    wall_minutes: float
    peak_mb: float
    mean_mm: float
    off: float
    coverage: float


@dataclass(frozen=True, slots=True)
class DriftFigures:
    """How a walk without poses was tracked.

    tracked           frames with a pose; keys: key frames; loops: alignments that closed loops
    cpu_s, peak_mb    to the poses, loops included
    end_before_mm     how far the last frame is off, of the way as tracked; mean_before_mm: the mean of all frames
    end_mm, mean_mm   the same with the loops closed
    """

    frames: int
    tracked: int
    keys: int
    loops: int
    length_m: float
    cpu_s: float
    peak_mb: float
    end_before_mm: float
    mean_before_mm: float
    end_mm: float
    mean_mm: float


def main(arguments: list[str]) -> None:
    """Measure what is missing, and print the tables of all that is kept."""
    options = _parser().parse_args(arguments)
    if options.child:
        (what,) = options.what
        print(json.dumps(asdict(_MEASURES[what](options.child, options.state))))
        return
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    for what, frames in () if options.show else product(options.what, options.frames):
        if f"{what}-{frames}" not in kept or options.again:
            kept[f"{what}-{frames}"] = _in_child(what, frames, options.state)
            KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    print("\n\n".join("\n".join(_TABLES[what](_kept(kept, what))) for what in _TABLES))


def _kept(kept: dict[str, Any], what: str) -> list[Any]:
    """The figures that are kept of one kind, by their frames."""
    found = [_FIGURES[what](**figures) for name, figures in kept.items() if name.startswith(what)]
    return sorted(found, key=lambda each: each.frames)


def point_table(figures: Sequence[PointFigures]) -> Iterator[str]:
    """Yield the lines of the table of points."""
    yield "| frames | points | views for tiles | CPU s | peak MB | mean mm | off |"
    yield "|---" * 7 + "|"
    for each in figures:
        yield (
            f"| {each.frames:,} | {each.points:,} | {each.views:,} | {each.cpu_s:.0f} | {each.peak_mb:,.0f} "
            f"| {each.mean_mm:.2f} | {each.off:.2%} |"
        )


def tile_table(figures: Sequence[TileFigures]) -> Iterator[str]:
    """Yield the lines of the table of tiles."""
    yield "| frames | tiles | triangles | MB | CPU min | wall min | peak MB | mean mm | off | coverage |"
    yield "|---" * 10 + "|"
    for each in figures:
        yield (
            f"| {each.frames:,} | {each.tiles} | {each.triangles:,} | {each.megabytes:.1f} | {each.cpu_minutes:.1f} "
            f"| {each.wall_minutes:.1f} | {each.peak_mb:,.0f} | {each.mean_mm:.2f} | {each.off:.2%} "
            f"| {each.coverage:.2%} |"
        )


def drift_table(figures: Sequence[DriftFigures]) -> Iterator[str]:
    """Yield the lines of the table of walks without poses."""
    yield (
        "| frames | tracked | key frames | loops | way m | CPU s | peak MB | end mm, as tracked | mean mm "
        "| end mm, loops closed | mean mm |"
    )
    yield "|---" * 11 + "|"
    for each in figures:
        yield (
            f"| {each.frames:,} | {each.tracked:,} | {each.keys:,} | {each.loops:,} | {each.length_m:.0f} "
            f"| {each.cpu_s:.0f} | {each.peak_mb:,.0f} | {each.end_before_mm:.1f} | {each.mean_before_mm:.1f} "
            f"| {each.end_mm:.1f} | {each.mean_mm:.1f} |"
        )


def _in_child(what: str, frames: int, state: Path) -> dict[str, float]:
    """Measure in a process of its own, whose peak memory is nobody else's; the walk is rendered before."""
    _walk(frames, state)
    command = [sys.executable, "-m", "tests.bench", "rgbd-walk", "--child", str(frames), "--what", what]
    answer = subprocess.run([*command, "--state", str(state)], check=True, stdout=subprocess.PIPE, text=True)
    figures: dict[str, float] = json.loads(answer.stdout.strip().splitlines()[-1])
    return figures


def _walk(frames: int, state: Path) -> tuple[FlatWalk, Path]:
    """The walk, and its folder, which is written unless it is there."""
    walk, folder = flat_walk(ROOMS[frames], frames), state / f"walk-{frames}"
    if not folder.exists():
        partial = folder.with_suffix(".part")
        shutil.rmtree(partial, ignore_errors=True)
        walk.write(partial)
        partial.replace(folder)
    return walk, folder


def _measure_points(frames: int, state: Path) -> PointFigures:
    """Make the points of a walk with poses, and compare them with the truth."""
    from capture2vr.edge.capture_to_points import to_points
    from capture2vr.edge.read_capture import read_capture

    walk, folder = _walk(frames, state)
    before = cpu_seconds()
    points = to_points(read_capture(folder))
    cpu_s, peak_mb = cpu_seconds() - before, _peak_mb()
    assert points.whole is not None
    away = np.concatenate([walk.truth.distance(part.xyz[::10]) for part in points.whole.read()])
    return PointFigures(
        frames=frames,
        points=points.whole.count,
        views=len(points.scene_views),
        cpu_s=round(cpu_s, 1),
        peak_mb=round(peak_mb),
        mean_mm=round(1e3 * float(away.mean()), 3),
        off=round(float((away > NEAR_M).mean()), 5),
    )


def _measure_tiles(frames: int, state: Path) -> TileFigures:
    """Reconstruct a walk with poses, and compare its finest tiles with the truth."""
    from capture2vr.edge.job_resources import JobResources
    from capture2vr.edge.pipeline import reconstruct
    from capture2vr.edge.preset import load_preset
    from capture2vr.edge.progress import Progress
    from capture2vr.edge.read_capture import read_capture
    from capture2vr.edge.tiles.folder import tiles_folder
    from capture2vr.storage.bundle import Bundle

    walk, folder = _walk(frames, state)
    checkpoint, refined = state / f"{frames}.checkpoint", None
    before, began = cpu_seconds(), time.monotonic()
    said = began
    for step in reconstruct(
        read_capture(folder), load_preset("scene-tiles"), resources=JobResources(checkpoint=checkpoint)
    ):
        if isinstance(step, Bundle):
            refined = step
        elif isinstance(step, Progress) and time.monotonic() - said > _SAY_S:
            said = time.monotonic()
            print(f"{step.stage} {step.fraction:.3f} {step.message}", file=sys.stderr, flush=True)
    assert refined is not None
    cpu, wall, peak = cpu_seconds() - before, time.monotonic() - began, _peak_mb()
    to_truth = np.linalg.inv(np.array(refined.manifest["capture_to_asset"]).reshape(4, 4))[:3]
    leaves = sorted((tiles_folder(checkpoint) / "level").glob("0-*.npz"))
    mean, off, coverage = compare(leaves, to_truth, walk.truth)
    (PICTURES / f"rgbd-walk-{frames}.jpg").write_bytes(pictures(leaves, to_truth))
    entry = refined.manifest["tileset"]
    return TileFigures(
        frames=frames,
        tiles=entry["tiles"],
        triangles=entry["triangles"],
        megabytes=round(sum(len(refined.files[file]) for file in refined.files if file.startswith("tile-")) / 1e6, 2),
        cpu_minutes=round(cpu / 60, 2),
        wall_minutes=round(wall / 60, 2),
        peak_mb=round(peak),
        mean_mm=round(1e3 * mean, 3),
        off=round(off, 5),
        coverage=round(coverage, 5),
    )


def _measure_drift(frames: int, state: Path) -> DriftFigures:
    """Track a walk without poses, and compare its way with the true one, before and after loops are closed."""
    from capture2vr.edge.odometry.loop_closure import close_loops
    from capture2vr.edge.odometry.tracker import follow_frames
    from capture2vr.edge.points.frame_faults import FrameFaults
    from capture2vr.edge.read_capture import read_capture

    walk, folder = _walk(frames, state)
    before = cpu_seconds()
    bare = [replace(frame, camera_to_world=None) for frame in read_capture(folder).frames]
    way = follow_frames(bare, FrameFaults())
    before_loops = np.stack(way.poses)
    without_drift = close_loops(way.keys, before_loops, way.edges, no_tick)
    cpu_s, peak_mb = cpu_seconds() - before, _peak_mb()
    tracked, closed = (_errors_m(way.posed(bare, poses), walk.poses) for poses in (before_loops, without_drift.poses))
    return DriftFigures(
        frames=frames,
        tracked=len(tracked),
        keys=len(way.keys),
        loops=len(without_drift.loops),
        length_m=round(float(np.linalg.norm(np.diff(walk.poses[:, :3, 3], axis=0), axis=1).sum()), 1),
        cpu_s=round(cpu_s, 1),
        peak_mb=round(peak_mb),
        end_before_mm=round(1e3 * float(tracked[-1]), 1),
        mean_before_mm=round(1e3 * float(tracked.mean()), 1),
        end_mm=round(1e3 * float(closed[-1]), 1),
        mean_mm=round(1e3 * float(closed.mean()), 1),
    )


def _errors_m(frames: Sequence[Frame], truth: Floats) -> Floats:
    """Distance (M,) of tracked cameras from the true ones (N,4,4), both in the axes of the first; metres."""
    numbers = [int(Path(frame.name).stem) for frame in frames]
    true = np.linalg.inv(truth[numbers[0]]) @ truth[numbers]
    found = np.stack([np.asarray(frame.camera_to_world) for frame in frames])
    errors: Floats = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
    return errors


def _peak_mb() -> float:
    """Greatest resident memory so far of this process, or of one of its children that have ended."""
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3


_FIGURES: dict[str, Any] = {"points": PointFigures, "tiles": TileFigures, "drift": DriftFigures}
_MEASURES: dict[str, Callable[[int, Path], Any]] = {
    "points": _measure_points,
    "tiles": _measure_tiles,
    "drift": _measure_drift,
}
_TABLES: dict[str, Callable[[Sequence[Any]], Iterator[str]]] = {
    "points": point_table,
    "tiles": tile_table,
    "drift": drift_table,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench rgbd-walk", description=__doc__)
    parser.add_argument("--frames", type=int, nargs="+", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--what", nargs="+", choices=_MEASURES, default=list(_MEASURES), help="what is measured")
    parser.add_argument("--state", type=Path, default=Path("out") / "rgbd-walk", help="folder of walks and tiles")
    parser.add_argument("--again", action="store_true", help="measure walks that are kept once more")
    parser.add_argument("--show", action="store_true", help="print what is kept, and measure nothing")
    parser.add_argument("--child", type=int, default=0, help=argparse.SUPPRESS)
    return parser
