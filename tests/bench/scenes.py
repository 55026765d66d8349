"""Flats of 1 to 64 million points by tiles: time, memory, triangles, and distance from the true surface.

A simulated flat with furniture (`tests/support/flats.py`) is scanned as a LAS file, some 24,000 points a square metre,
reconstructed by preset scene-tiles in a process of its own, and its finest tiles are compared with the truth. Every
size is kept when it is finished, and one that was cut off goes on from its finished tiles; `--show` only prints.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.srgb import to_srgb
from tests.bench.data_files import PICTURES
from tests.bench.peak_memory import peak_memory
from tests.support.flats import ROOM, Flat, flat

KEPT = Path(__file__).with_name("scenes.json")
SIZES = (1, 4, 16, 64)
"""Millions of points: a room has one."""
_DEFAULT = (1, 4)
_PER_M2 = 2_000  # samples of the surfaces that are compared
NEAR_M = 0.02  # from the truth, or from the mesh: two cells
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from the flat's frame, Y up, to a LAS file's, Z up
_CEILING_M = 2.25  # where the pictures cut the rooms open
_PICTURE_PX = 640


@dataclass(frozen=True, slots=True)
class SceneFigures:
    """What one size took, and how good it is.

    cpu_minutes   of all processes, which other programs on the machine hardly change; wall_minutes: with them
    preview_s     CPU seconds to the preview; peak_mb: most resident memory of all processes together
    mean_mm       mean distance of the tiles' surface from the true one; off: share of it more than 2 cm away
    coverage      share of the true surface with a tile within 2 cm
    """

    millions: int
    points: int
    area_m2: float
    tiles: int
    levels: int
    triangles: int
    megabytes: float
    cpu_minutes: float
    wall_minutes: float
    preview_s: float
    peak_mb: float
    mean_mm: float
    off: float
    coverage: float


def main(arguments: list[str]) -> None:
    """Measure the sizes that are missing, and print the table of all that are kept."""
    options = _parser().parse_args(arguments)
    if options.child:
        print(json.dumps(asdict(_measure(options.child, options.state))))
        return
    kept = {each.millions: each for each in load()}
    for millions in () if options.show else options.millions:
        if millions not in kept or options.again:
            kept[millions] = _in_child(millions, options.state)
            KEPT.write_text(json.dumps([asdict(kept[each]) for each in sorted(kept)], indent=1) + "\n")
    figures = [kept[each] for each in sorted(kept)]
    print("\n".join(table(figures)))
    if len(figures) > 1:
        plot(figures, PICTURES / "scenes.png")


def load() -> list[SceneFigures]:
    """The sizes that are kept."""
    return [SceneFigures(**each) for each in json.loads(KEPT.read_text())] if KEPT.exists() else []


def table(figures: Sequence[SceneFigures]) -> Iterator[str]:
    """Yield the lines of the table, and the exponent of time against area."""
    yield (
        "| points | area m² | tiles | levels | triangles | MB | CPU min | wall min | preview CPU s | peak MB "
        "| mean mm | off | coverage |"
    )
    yield "|---" * 13 + "|"
    for each in figures:
        yield (
            f"| {each.millions} M | {each.area_m2:,.0f} | {each.tiles} | {each.levels} | {each.triangles:,} "
            f"| {each.megabytes:.1f} | {each.cpu_minutes:.1f} | {each.wall_minutes:.1f} | {each.preview_s:.0f} "
            f"| {each.peak_mb:,.0f} | {each.mean_mm:.2f} | {each.off:.2%} | {each.coverage:.2%} |"
        )
    if len(figures) > 1:
        yield f"\nCPU time grows with area to the power of {exponent(figures):.2f}."


def exponent(figures: Sequence[SceneFigures]) -> float:
    """Slope of log CPU time over log area, by least squares."""
    slope, _ = np.polyfit(np.log([each.area_m2 for each in figures]), np.log([each.cpu_minutes for each in figures]), 1)
    return float(slope)


def plot(figures: Sequence[SceneFigures], path: Path) -> None:
    """Draw CPU time and peak memory over area, both axes logarithmic."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    areas = np.array([each.area_m2 for each in figures])
    minutes = np.array([each.cpu_minutes for each in figures])
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    left.loglog(areas, minutes, "o-", label=f"measured, exponent {exponent(figures):.2f}")
    left.loglog(areas, minutes[0] * areas / areas[0], "--", color="grey", label="proportional to area")
    left.set(xlabel="surface, m²", ylabel="CPU minutes", title="Time")
    left.legend()
    right.semilogx(areas, [each.peak_mb for each in figures], "o-")
    right.axhline(3_000, linestyle="--", color="grey")
    right.set(xlabel="surface, m²", ylabel="MB", title="Peak memory of all processes", ylim=(0, None))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _in_child(millions: int, state: Path) -> SceneFigures:
    """Measure one size in a process of its own, whose peak memory is nobody else's."""
    command = [sys.executable, "-m", "tests.bench", "scenes", "--child", str(millions), "--state", str(state)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    return SceneFigures(**json.loads(answer.strip().splitlines()[-1]))


def _measure(millions: int, state: Path) -> SceneFigures:
    """Scan, reconstruct and compare one flat; what a killed run has finished, and its times, count."""
    from capture2vr.cli.local.edge_settings import machine_room
    from capture2vr.edge.engine.address import LOCAL, engine_for_parts
    from capture2vr.edge.job_resources import JobResources
    from capture2vr.edge.pipeline import reconstruct
    from capture2vr.edge.preset import load_preset
    from capture2vr.edge.progress import Progress
    from capture2vr.edge.read_capture import read_capture
    from capture2vr.edge.tiles.folder import tiles_folder
    from capture2vr.storage.bundle import Bundle

    truth, folder = flat(millions), state / f"{millions}"
    folder.mkdir(parents=True, exist_ok=True)
    scan = folder / "flat.las"
    if not scan.exists():
        _write_las(truth, millions * 1_000_000, scan)
    resource_before, began, preview_s = cpu_seconds(), time.monotonic(), 0.0
    checkpoint = folder / "1.checkpoint"
    clock = _Clock(folder / "spent.json")
    refined = None
    engine = engine_for_parts(LOCAL, machine_room())
    resources = JobResources(checkpoint=checkpoint, engine=engine)
    steps = reconstruct(read_capture(scan), load_preset("scene-tiles"), resources=resources)
    with peak_memory() as peak:
        for step in steps:
            if isinstance(step, Bundle):
                preview_s = preview_s or cpu_seconds() - resource_before
                refined = step
            elif isinstance(step, Progress) and clock.is_due():
                print(f"{step.stage} {step.fraction:.3f} {step.message}", file=sys.stderr, flush=True)
                clock.save(cpu_seconds() - resource_before, time.monotonic() - began)
    assert refined is not None
    cpu, wall = clock.total(cpu_seconds() - resource_before, time.monotonic() - began)
    to_truth = _Z_UP.T @ np.linalg.inv(np.array(refined.manifest["capture_to_asset"]).reshape(4, 4))[:3]
    leaves = sorted((tiles_folder(checkpoint) / "level").glob("0-*.npz"))
    mean, off, coverage = compare(leaves, to_truth, truth)
    (PICTURES / f"scenes-{millions}.jpg").write_bytes(pictures(leaves, to_truth))
    entry = refined.manifest["tileset"]
    stored = sum(len(refined.files[file]) for file in refined.files if file.startswith("tile-"))
    shutil.rmtree(folder)
    return SceneFigures(
        millions=millions,
        points=millions * 1_000_000,
        area_m2=round(truth.area, 1),
        tiles=entry["tiles"],
        levels=entry["levels"],
        triangles=entry["triangles"],
        megabytes=round(stored / 1e6, 2),
        cpu_minutes=round(cpu / 60, 2),
        wall_minutes=round(wall / 60, 2),
        preview_s=round(preview_s, 1),
        peak_mb=round(peak.megabytes),
        mean_mm=round(1e3 * mean, 3),
        off=round(off, 5),
        coverage=round(coverage, 5),
    )


class _Clock:
    """Adds up the seconds of runs that were killed, from a file that is written every few seconds."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._before = json.loads(path.read_text()) if path.exists() else [0.0, 0.0]
        self._saved = time.monotonic()

    def is_due(self) -> bool:
        return time.monotonic() - self._saved > 10

    def save(self, cpu: float, wall: float) -> None:
        self._saved = time.monotonic()
        self._path.write_text(json.dumps(self.total(cpu, wall)))

    def total(self, cpu: float, wall: float) -> tuple[float, float]:
        return self._before[0] + cpu, self._before[1] + wall


def cpu_seconds() -> float:
    """CPU seconds of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def _write_las(truth: Flat, count: int, path: Path) -> None:
    """Write a scan part by part, in millimetres, Z up."""
    import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 1e-4)
    partial = path.with_suffix(".part")
    with laspy.open(partial, mode="w", header=header) as writer:
        for part in truth.parts(count):
            records = laspy.ScaleAwarePointRecord.zeros(len(part.xyz), header=header)
            records.x, records.y, records.z = (part.xyz @ _Z_UP.T).T
            assert part.rgb is not None
            records.red, records.green, records.blue = part.rgb.T.astype(np.uint16) * 257
            writer.write_points(records)
    partial.replace(path)


def _leaf(path: Path, to_truth: Floats) -> Mesh:
    """A tile's mesh as delivered, in the flat's own frame."""
    with np.load(path) as arrays:
        vertices = arrays["vertices"] @ to_truth[:, :3].T + to_truth[:, 3]
        return Mesh(vertices, arrays["faces"].astype(np.int64), arrays["rgb"] if len(arrays["rgb"]) else None)


def compare(leaves: Sequence[Path], to_truth: Floats, truth: Flat) -> tuple[float, float, float]:
    """Mean distance of the tiles from the truth, share that is off, and share of the truth that is covered."""
    rng = np.random.default_rng(5)
    true = np.concatenate([part.xyz for part in truth.parts(int(_PER_M2 * truth.area), seed=9, noise_m=0.0)])
    covered, away = np.zeros(len(true), bool), []
    for path in leaves:
        mesh = _leaf(path, to_truth)
        if not len(mesh.faces):
            continue
        away.append(truth.distance(sample(mesh, max(int(_PER_M2 * area(mesh)), 10), rng).xyz))
        dense = sample(mesh, max(int(8 * _PER_M2 * area(mesh)), 100), rng).xyz
        low, high = dense.min(axis=0) - NEAR_M, dense.max(axis=0) + NEAR_M
        inside = np.flatnonzero(((true > low) & (true < high)).all(axis=1) & ~covered)
        covered[inside] = cKDTree(dense).query(true[inside])[0] < NEAR_M
    every = np.concatenate(away)
    return float(every.mean()), float((every > NEAR_M).mean()), float(covered.mean())


def pictures(leaves: Sequence[Path], to_truth: Floats) -> bytes:
    """Two pictures side by side as JPEG, ceilings cut away: the whole flat, and the room at its corner."""
    from PIL import Image

    meshes = [_leaf(path, to_truth) for path in leaves]
    sheet = np.concatenate([_picture(_cut_open(meshes, np.full(3, np.inf))), _picture(_cut_open(meshes, ROOM))], axis=1)
    out = BytesIO()
    Image.fromarray(sheet).save(out, "JPEG", quality=85)
    return out.getvalue()


def _cut_open(meshes: Sequence[Mesh], to: Floats) -> Mesh:
    """Join meshes, without what lies above _CEILING_M or beyond `to` (3,)."""
    from capture2vr.edge.tiles.tile_levels import joined

    high = np.minimum(to + 0.05, [np.inf, _CEILING_M, np.inf])
    kept = []
    for mesh in meshes:
        below = (mesh.vertices[mesh.faces].mean(axis=1) < high).all(axis=1)
        kept += [compact(mesh, below)] if below.any() else []
    return joined(kept)


def _picture(mesh: Mesh) -> Bytes:
    from capture2vr.edge.render.renderer import RenderMesh, place_cameras, render_view

    subject = RenderMesh.of(replace(mesh), _PICTURE_PX, sky_rays=4_000_000)
    view = render_view(subject, place_cameras(subject, (30.0,), 50.0)[0], _PICTURE_PX)
    return to_srgb(view.light + (1 - view.cover) * np.float32(0.75))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench scenes", description=__doc__)
    parser.add_argument("--millions", type=int, nargs="+", choices=SIZES, default=list(_DEFAULT))
    parser.add_argument("--state", type=Path, default=Path("out") / "scenes", help="folder of scans and finished tiles")
    parser.add_argument("--again", action="store_true", help="measure sizes that are kept once more")
    parser.add_argument("--show", action="store_true", help="print what is kept, and measure nothing")
    parser.add_argument("--child", type=int, default=0, help=argparse.SUPPRESS)
    return parser
