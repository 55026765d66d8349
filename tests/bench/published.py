"""The methods of the literature at their own budget of steps: `python -m tests.bench published --hours 8`.

A cell is one method on one row, a process of its own, resumed from its checkpoint however often it is killed. What it
reached is measured at steps that double, and when the hours are over; published.json keeps the figures, and the folder
of --state the checkpoints, and the weights and the mesh of every measured step. `--table` only prints. Nothing is
extrapolated: a cell that has not ended shows the steps that it reached. The product's own figures of the scene, which
is no row of the yardstick, are kept here too.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.preset import load_preset
from tests.bench.cell import ROOT, figures_of
from tests.bench.cell import run_cell as run_yardstick_cell
from tests.bench.methods import Settings, near, peak_mb
from tests.bench.records import Record, Records, record_of
from tests.bench.shapes import DEFORMED, KNOWN, Row
from tests.support import scenes
from tests.support.mesh_metrics import welded

FOLDER = Path(__file__).parent
STORED, PLOT = FOLDER / "published.json", FOLDER / "published.png"
BATCH, OWN_BATCH = 1_000, 5_000
OWN = "standard"  # the product's preset that stands beside the literature
MEASURED_AT = (500, 1_000, 2_000, 5_000, 10_000, 20_000, 30_000, 40_000, 60_000, 80_000, 100_000)
_CLOCK_S = 10.0  # between two lines of a cell's clock
_OWN_TIMEOUT_S = 3_600.0  # of the product on the scene, which takes two minutes of two cores
PER_M2, DENSE_PER_M2 = 1_000, 10_000  # points per square metre in the paper's Tables 3 and 4


_ROOM = scenes.furnished_room()
_ROOM_M = float(np.ptp(_ROOM.vertices, axis=0).max())


def lounge() -> Mesh:
    """A furnished room in the unit frame."""
    return Mesh(unit_frame(_ROOM.vertices).to_unit(_ROOM.vertices), _ROOM.faces)


DRESS, TRUCK = (
    next(row for row in KNOWN if row.label == label) for label in ("dress, 10,000", "truck, 10,000, σ 0.006")
)
OBJECTS = tuple(
    row for row in KNOWN if row in (DRESS, TRUCK) or row.label in ("dress, 10,000, σ 0.004", "pleated skirt, 1,000")
)
AREA_M2 = {"dress": 2.4917, "truck": 2.7341, "lounge": area(Mesh(_ROOM.vertices, _ROOM.faces))}
"""Area of what is scanned at a density. The longest side of the objects is taken as a metre: garments are so long, and
models of the benchmarks that the paper names are scaled to it."""
SCENE = Row("lounge", lounge, points=round(PER_M2 * AREA_M2["lounge"]), resolution=256)


def by_density(row: Row, per_m2: int) -> Row:
    """The same row with as many points as its surface has at a number per square metre."""
    return replace(row, points=round(per_m2 * AREA_M2[row.name]))


OBJECTS_BY_DENSITY = tuple(by_density(row, per_m2) for per_m2 in (DENSE_PER_M2, PER_M2) for row in (DRESS, TRUCK))
DENSE_SCENE = by_density(SCENE, DENSE_PER_M2)


@dataclass(frozen=True, slots=True)
class Cell:
    """A method on a row; metres: length of the row's longest side, where it has one."""

    row: Row
    method: str
    config: NetworkConfig
    metres: float | None = None

    @property
    def label(self) -> str:
        """What tables call the method."""
        return self.method if self.config.batch == BATCH else f"{self.method}, {self.config.batch:,} queries"

    def settings(self, device: str) -> dict[str, Any]:
        """What the record is kept by; device: "cpu" or "cuda"."""
        return {**self.row.scan, "batch": self.config.batch, "steps": self.config.loss_steps, "device": device}


def cells() -> Iterator[Cell]:
    """All cells, in the order in which they are measured: quick methods first, row by row."""
    for methods in (("paper", "paper-no-self"), ("cap-udf",), ("levelset-udf",)):
        for row in OBJECTS:
            yield from (Cell(row, method, _fit(method)) for method in methods)
    yield Cell(OBJECTS[0], "paper", _fit("paper", OWN_BATCH))
    yield from _scene_cells(SCENE)
    for row in DEFORMED:
        yield from (Cell(row, method, _fit(method)) for method in ("paper", "levelset-udf"))
    for row in OBJECTS_BY_DENSITY:
        yield from (Cell(row, method, _fit(method), metres=1.0) for method in ("paper", "paper-no-self"))
    yield from _scene_cells(DENSE_SCENE)


def _scene_cells(row: Row) -> Iterator[Cell]:
    """Every method on the room, with its weights and steps for scenes."""
    scene = _fit("paper-scene")
    level = replace(_fit("levelset-udf"), projection=1e-3, surface=1e-2, orthogonality=1e-4, steps=100_000)
    for method, config in (
        ("paper", scene),
        ("paper-no-self", replace(scene, self_consistency=0.0)),
        ("cap-udf", _fit("cap-udf")),
        ("levelset-udf", level),
    ):
        yield Cell(row, method, config, _ROOM_M)


def _fit(preset: str, batch: int = BATCH) -> NetworkConfig:
    config = load_preset(preset).fit
    assert isinstance(config, NetworkConfig)
    densify = replace(config.densify, batch=batch) if config.densify else None
    return replace(config, batch=batch, densify=densify)


def main(arguments: list[str]) -> None:
    """Go on with the cells for the given hours, then print the tables and draw the curves."""
    options = _parser().parse_args(arguments)
    if options.cell is not None:
        cell = list(cells())[options.cell]
        try:
            run_cell(cell, options.state, options.until, options.device)
        except OSError as error:
            reason = f"{error.strerror or error}: {error.filename or options.state}"
            sys.exit(f"{_name(cell)}: {reason}; what was measured stays")
        return
    failed = [] if options.table else measure(options)
    records = Records(STORED).all()
    for line in table(records):
        print(line)
    draw(records)
    if failed:
        sys.exit(f"these ended before their time, for the reasons above: {'; '.join(failed)}")


def measure(options: argparse.Namespace) -> list[str]:
    """Run the cells that have not ended, as many at once as asked for, until the hours are over; return what failed."""
    options.state.mkdir(parents=True, exist_ok=True)
    until = time.time() + 3_600 * options.hours
    for scene in (SCENE, DENSE_SCENE):
        if options.rows in f"{scene.label}: {OWN}":
            measure_product(scene, Records(STORED))
    records = Records(STORED).all()
    device = _kind(options.device)
    waiting = [
        number
        for number, cell in enumerate(cells())
        if options.rows in _name(cell) and not _has_ended(cell, records, device)
    ]
    failed: list[str] = []
    running: dict[int, subprocess.Popen[bytes]] = {}
    each_s = 60 * options.cell_minutes
    while (waiting and time.time() < until) or running:
        while waiting and len(running) < options.jobs and time.time() < until:
            number = waiting.pop(0)
            ends = min(until, time.time() + each_s)
            command = [sys.executable, "-m", "tests.bench", "published", "--cell", str(number), "--until", str(ends)]
            command += ["--state", str(options.state), "--device", options.device]
            threads = max(1, (os.cpu_count() or 1) // options.jobs)
            # Threads that spin while they wait for each other stall a training beside other work: 0.4 steps a second
            # in place of 1.7 beside a test run, and no faster alone.
            variables = {"OMP_NUM_THREADS": str(threads), "OMP_WAIT_POLICY": "PASSIVE"}
            running[number] = subprocess.Popen(command, cwd=ROOT, env={**os.environ, **variables})
        time.sleep(1)
        ended = {number: process for number, process in running.items() if process.poll() is not None}
        failed += [_name(list(cells())[number]) for number, process in ended.items() if process.returncode]
        running = {number: process for number, process in running.items() if number not in ended}
    return failed


def measure_product(row: Row, records: Records) -> None:
    """Measure the product's preset on a scene, unless its figures are there; what failed is tried again."""
    known = [each for each in records.all().values() if (each.row, each.method) == (row.label, OWN)]
    if any("failed" not in each.figures for each in known):
        return
    truth, chosen = row.truth(), Settings(OWN, resolution=row.resolution)
    figures = run_yardstick_cell(row.sampled(truth, chosen.seed), truth, chosen, _OWN_TIMEOUT_S)
    records.add(record_of(row.label, OWN, {**row.scan, "resolution": chosen.resolution}, figures))


def _name(cell: Cell) -> str:
    return f"{cell.row.label}: {cell.label}"


def _kind(device: str) -> str:
    """The kind of a device: "cpu", or "cuda" for "cuda:0"."""
    return device.split(":")[0]


def _has_ended(cell: Cell, records: dict[tuple[str, str, str], Record], device: str) -> bool:
    curve = curve_on(device, cell, records)
    return bool(curve) and curve[-1]["step"] >= cell.config.loss_steps


def curve_of(cell: Cell, records: dict[tuple[str, str, str], Record]) -> list[dict[str, Any]]:
    """What a cell reached, a table of figures by measured step: on the kind of device where it came farther."""
    curves = [curve_on(device, cell, records) for device in ("cpu", "cuda")]
    return max(curves, key=lambda curve: curve[-1]["step"] if curve else 0)


def curve_on(device: str, cell: Cell, records: dict[tuple[str, str, str], Record]) -> list[dict[str, Any]]:
    """What a cell reached on a kind of device."""
    key = record_of(cell.row.label, cell.label, cell.settings(device), {"version": ""}).key
    return list(records[key].figures["curve"]) if key in records else []


def run_cell(cell: Cell, state: Path, until: float, device: str) -> None:
    """Train a cell from its checkpoint on, until the time is over, and record what it reached."""
    import torch

    from capture2vr.edge.field import checkpoint
    from capture2vr.edge.mesh.clean import clean
    from capture2vr.edge.mesh.extract import extract
    from capture2vr.edge.paper_field.learned import LearnedField
    from capture2vr.edge.paper_field.network_fit import fit_network

    kind = _kind(device)
    folder = state / _folder_name(cell, kind)
    folder.mkdir(parents=True, exist_ok=True)
    truth = cell.row.truth()
    points = cell.row.sampled(truth, 0)
    whole = welded(truth)
    clock = _CellClock(folder / "clock.json")
    records = Records(STORED)
    curve = curve_on(kind, cell, records.all())
    fit = fit_network(points, cell.config, device=device, checkpoint=folder / "fit.pt", metres=cell.metres)
    if torch.cuda.is_available():
        torch.cuda.reset_peak_memory_stats()
    with closing(fit):
        for step in fit:
            assert isinstance(step.field, LearnedField)
            if not step.losses:
                continue
            clock.advance(step.number)
            over = time.time() > until
            kept = folder / f"step-{step.number}.npz"
            new = all(each["step"] < step.number for each in curve)
            if (step.number in MEASURED_AT or over or step.number == step.of) and (new or not kept.exists()):
                seconds = round(clock.seconds, 1)
                with clock.paused():
                    kept.with_suffix(".pt").write_bytes(checkpoint.saved_bytes(step.field.network.state_dict()))
                    mesh = clean(extract(step.field, points, resolution=cell.row.resolution), points)
                    keep_mesh(kept, mesh)
                    entry = {"step": step.number, "queries": _queries(step.number, cell.config), "seconds": seconds}
                    entry |= _figures(mesh, step.field, points, whole) if new else {}
                entry["peak_mb"] = round(peak_mb())
                if device != "cpu":
                    entry["gpu_mb"] = round(torch.cuda.max_memory_allocated() / 2**20)
                if new:
                    curve.append(entry)
                    records.add(record_of(cell.row.label, cell.label, cell.settings(kind), {"curve": curve}))
                    print(f"{_name(cell)}: {json.dumps(entry)}", file=sys.stderr, flush=True)
            if over:
                return


def _figures(mesh: Mesh, field: Any, points: Floats, truth: Mesh) -> dict[str, Any]:
    from capture2vr.edge.certificate import consistency

    if not len(mesh.faces):
        return {"failed": "no surface was found"}
    quality = figures_of(mesh, truth)
    quality["consistency"] = consistency(field, near(points, 0))
    kept = (
        "chamfer_l1",
        "chamfer_l2",
        "f_005",
        "f_010",
        "normal_consistency",
        "components",
        "floor",
        "floor_f_005",
        "consistency",
    )
    return {key: float(f"{quality[key]:.5g}") for key in kept}


def _queries(step: int, config: NetworkConfig) -> int:
    """Queries seen up to a step."""
    late = max(0, step - config.steps)
    return (step - late) * config.batch + late * (config.densify.batch if config.densify else 0)


def keep_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh, in half the bytes of its arrays: 32 bits a number."""
    np.savez_compressed(path, vertices=mesh.vertices.astype(np.float32), faces=mesh.faces.astype(np.int32))


def kept_mesh(path: Path) -> Mesh:
    """Read what `keep_mesh` wrote."""
    with np.load(path) as kept:
        return Mesh(kept["vertices"].astype(np.float64), kept["faces"].astype(np.int64))


NO_MESH = "no mesh in --state"
"""What a table says of a cell whose meshes are not kept on this machine; `published --table` tells what it reached."""


def mesh_reached(cell: Cell, state: Path) -> tuple[int, Mesh] | None:
    """The mesh of the last measured step that the folder of --state keeps, and that step; None without."""
    last = _last_kept(cell, state, "npz")
    return (last[0], kept_mesh(last[1])) if last else None


def weights_reached(cell: Cell, state: Path) -> tuple[int, Path] | None:
    """The last measured step whose weights the folder of --state keeps, and their file; None without."""
    return _last_kept(cell, state, "pt")


def _last_kept(cell: Cell, state: Path, suffix: str) -> tuple[int, Path] | None:
    kept = [
        (int(path.stem.removeprefix("step-")), path)
        for kind in ("cpu", "cuda")
        for path in (state / _folder_name(cell, kind)).glob(f"step-*.{suffix}")
    ]
    return max(kept, key=lambda each: each[0]) if kept else None


def _folder_name(cell: Cell, kind: str) -> str:
    name = f"{cell.row.label} {cell.label}".replace(" ", "-").replace(",", "")
    return name if kind == "cpu" else f"{name}-{kind}"


class _CellClock:
    """Seconds of training, kept in a file: a fit that is killed goes on from an earlier step, and so does its clock."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._past: list[tuple[int, float]] = []
        if path.exists():
            self._past = [(step, seconds) for step, seconds in json.loads(path.read_text())]
        self.seconds, self._last, self._first = 0.0, time.monotonic(), True

    def advance(self, step: int) -> None:
        """Count the time since the last call, which ended with this step."""
        now = time.monotonic()
        if self._first:
            self._past = [each for each in self._past if each[0] < step]
            self.seconds, self._first = (self._past[-1][1] if self._past else 0.0), False
        else:
            self.seconds += now - self._last
        self._last = now
        if not self._past or self.seconds - self._past[-1][1] > _CLOCK_S:
            self._past.append((step, self.seconds))
            half = self._path.with_suffix(".tmp")
            half.write_text(json.dumps(self._past))
            half.replace(self._path)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """A context whose time is not counted."""
        yield
        self._last = time.monotonic()


def table(records: dict[tuple[str, str, str], Record]) -> Iterator[str]:
    """Lines of the table: what every cell reached last, and how far it came."""
    yield "| row | method | steps | of | queries | minutes | GPU MB | Chamfer-L1 | F@.005 | normals | pieces | floor |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|---|"
    for cell in cells():
        curve = [each for each in curve_of(cell, records) if "failed" not in each]
        head = f"| {cell.row.label} | {cell.label} |"
        if not curve:
            yield f"{head} 0 | {cell.config.loss_steps:,} |" + " |" * 8
            continue
        last = curve[-1]
        yield (
            f"{head} {last['step']:,} | {cell.config.loss_steps:,} | {last['queries'] / 1e6:.1f} M "
            f"| {last['seconds'] / 60:.0f} | {last.get('gpu_mb', '')} | {last['chamfer_l1']:.5f} | {last['f_005']:.3f} "
            f"| {last['normal_consistency']:.3f} | {last['components']:.0f} | {last['floor']:.5f} |"
        )


def draw(records: dict[tuple[str, str, str], Record]) -> None:
    """Draw Chamfer-L1 against the steps, a picture for each row that has any."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    rows = list(dict.fromkeys(cell.row for cell in cells() if curve_of(cell, records)))
    if not rows:
        return
    across = min(len(rows), 4)
    down = math.ceil(len(rows) / across)
    figure, grid = plt.subplots(
        down, across, figsize=(4.5 * across, 3.8 * down), layout="constrained", squeeze=False, sharey=True, sharex=True
    )
    axes = grid.ravel()
    colours = {name: f"C{number}" for number, name in enumerate(dict.fromkeys(cell.label for cell in cells()))}
    for axis in axes[len(rows) :]:
        axis.set_visible(False)
    for axis, row in zip(axes, rows, strict=False):
        for cell in cells():
            curve = [each for each in curve_of(cell, records) if "failed" not in each]
            if cell.row == row and curve:
                places = [x["step"] for x in curve], [x["chamfer_l1"] for x in curve]
                axis.plot(*places, marker="o", label=cell.label, color=colours[cell.label])
                axis.axhline(curve[-1]["floor"], color="grey", linewidth=0.8, linestyle=":")
        axis.set(xscale="log", yscale="log", title=row.label, xlabel="steps")
        axis.legend(fontsize=7)
    axes[0].set_ylabel("Chamfer-L1, unit frame (dotted: floor)")
    figure.savefig(PLOT, dpi=100)
    plt.close(figure)


def add_state(parser: argparse.ArgumentParser) -> None:
    """Add the option --state: the folder that keeps checkpoints, weights and meshes of all cells."""
    parser.add_argument(
        "--state", type=Path, default=ROOT / "build" / "published", help="folder of checkpoints, weights and meshes"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench published", description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="how long to go on")
    parser.add_argument("--cell-minutes", type=float, default=math.inf, help="how long to stay with a cell at most")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="cells at once")
    parser.add_argument("--rows", default="", help="only cells whose row and method contain this")
    parser.add_argument("--device", default="cpu", help="where fields are trained, as cuda:0")
    add_state(parser)
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--cell", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--until", type=float, default=0.0, help=argparse.SUPPRESS)
    return parser
