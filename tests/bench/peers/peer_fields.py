"""Published networks with their published weights on the yardstick's clouds: `python -m tests.bench peer-fields`.

GEOUDF_FOLDER and LOSF_FOLDER name clones of GeoUDF (no licence: figures alone) and LoSF (MIT), PEERS_PYTHON an
interpreter with their packages; nothing of theirs is in this repository. A cell is a process of its own.
peer_fields.json keeps what was measured, so a run goes on where the last one ended; `--table` only prints.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from tests.bench import yardstick
from tests.bench.cell import ROOT, figures_of, run_cell
from tests.bench.methods import NAMES, Settings
from tests.bench.paper import heat_maps
from tests.bench.paper.heat_maps import Column, View
from tests.bench.peers.peer_fields_child import GEOUDF_PROGRAM, GEOUDF_WEIGHTS, LOCAL_WEIGHTS
from tests.bench.published import OBJECTS, keep_mesh, kept_mesh
from tests.bench.published import STORED as PUBLISHED
from tests.bench.records import Record, Records, fingerprint, record_of
from tests.bench.shapes import Row
from tests.support.mesh_metrics import welded

STORED = Path(__file__).parent / "peer_fields.json"
ROWS = (*OBJECTS, replace(OBJECTS[0], points=48_000))
"""The clouds that `published` measures, and one as dense as those that the local-shape network is made for."""

OWN, OURS = "its own", "the product's"
HEAD = (
    "| cloud | field | extraction | cells | Chamfer-L1 | Chamfer-L2 × 10⁶ | normal error | pieces | non-manifold | s "
    "| peak MB |\n" + "|---" * 11 + "|"
)


@dataclass(frozen=True, slots=True)
class Peer:
    """A published network and an extraction.

    variable     of the environment, that names the folder of its clone
    files        of the clone, that it needs: weights first of all
    most_points  of a cloud that it has the memory for
    """

    name: str
    extraction: str
    variable: str
    files: tuple[Path, ...]
    most_points: int = 1_000_000

    def missing(self, row: Row) -> str:
        """What stands between this peer and a run on a cloud, or nothing."""
        if row.points > self.most_points:
            return f"its distances between all pairs of points take {3 * 4 * row.points**2 / 1e9:.0f} GB"
        folder = os.environ.get(self.variable)
        if not folder:
            return f"no {self.variable}"
        absent = [file for file in self.files if not (Path(folder) / file).is_file()]
        return f"{self.variable} lacks {absent[0]}" if absent else ""


_GEOUDF_FILES = (GEOUDF_WEIGHTS / "pu_model_best.t7", GEOUDF_WEIGHTS / "udf_model_best.t7", Path(GEOUDF_PROGRAM))
_LOCAL = "local-shape network of LoSF's repository"
_GEOUDF_POINTS = 20_000  # three tables of all pairs' distances are in memory at once
PEERS = {
    "geoudf": Peer("GeoUDF", OWN, "GEOUDF_FOLDER", _GEOUDF_FILES, _GEOUDF_POINTS),
    "geoudf-field": Peer("GeoUDF", OURS, "GEOUDF_FOLDER", _GEOUDF_FILES, _GEOUDF_POINTS),
    "local-shape": Peer(_LOCAL, OURS, "LOSF_FOLDER", (LOCAL_WEIGHTS, Path("DCUDF/udf_models.py"))),
}
NOT_MEASURED = {
    "LoSF-UDF": "its code is public (MIT), its checkpoint `pretrained/train-total-uniform.ckpt` was not in the copy "
    "of the repository at hand",
    f"{_LOCAL} | {OWN}": "its script does not fit the extraction beside it, which takes other arguments "
    "and a grid of 256³ alone",
}
"""What the tables name without figures, and why."""


def main(arguments: list[str]) -> None:
    """Measure what is missing, print the table, draw the picture."""
    options = _parser().parse_args(arguments)
    rows = [row for row in ROWS if options.rows in row.label]
    records = Records(STORED)
    if not options.table:
        measure(rows, options, records)
    print(HEAD)
    for row in rows:
        for line in lines(row, options, records.all()):
            print(line)
    for name, why in NOT_MEASURED.items():
        field, _, extraction = name.partition(" | ")
        print(f"| – | {field} | {extraction or '–'} | – | {why} |" + " |" * 6)
    if options.picture:
        heat_maps.draw([columns(row, options) for row in rows], View(), options.picture)


def measure(rows: list[Row], options: argparse.Namespace, records: Records) -> None:
    """Measure the cells that no record is of, or all with --fresh."""
    for row in rows:
        truth = row.truth()
        points = row.sampled(truth, 0)
        if row not in OBJECTS and (options.fresh or _key(row, "standard", options) not in records.all()):
            figures = run_cell(points, truth, Settings("standard", resolution=options.cells), options.timeout)
            records.add(record_of(row.label, "standard", _settings(row, options), figures))
        for name in options.peers:
            if not options.fresh and _key(row, name, options) in records.all():
                continue
            why = PEERS[name].missing(row)
            if why:
                print(f"{row.label}: {name}: {why}", file=sys.stderr)
                continue
            figures = run_peer(name, points, welded(truth), options, _mesh_of(row, name, options))
            records.add(Record(row.label, name, _settings(row, options), version_of(PEERS[name]), figures))
            print(f"{row.label}: {name}: {figures}", file=sys.stderr, flush=True)


def run_peer(name: str, points: Floats, truth: Mesh, options: argparse.Namespace, kept: Path) -> dict[str, Any]:
    """The figures of a peer's mesh, which is kept at `kept`, or {"failed": why}."""
    folder = Path(os.environ[PEERS[name].variable]).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        source, target = Path(scratch) / "points.npz", Path(scratch) / "mesh.npz"
        np.savez(source, points=points)
        asked = [name, str(folder), str(source), str(target), str(options.cells)]
        failed = run_child("tests.bench.peers.peer_fields_child", asked, options.timeout)
        if failed:
            return {"failed": failed}
        with np.load(target) as made:
            mesh = Mesh(made["vertices"].astype(np.float64), made["faces"].astype(np.int64))
            cost = {each: float(f"{float(made[each]):.5g}") for each in ("seconds", "peak_mb")}
    if not len(mesh.faces):
        return {"failed": "no surface was found"}
    kept.parent.mkdir(parents=True, exist_ok=True)
    keep_mesh(kept, mesh)
    figures = figures_of(mesh, truth).items()
    return {**{key: float(f"{value:.5g}") if isinstance(value, float) else value for key, value in figures}, **cost}


def run_child(module: str, arguments: list[str], timeout_s: float | None = None) -> str:
    """Run a module in the interpreter of PEERS_PYTHON, from this checkout; return why it failed, or nothing."""
    command = [os.environ.get("PEERS_PYTHON", sys.executable), "-m", module, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, cwd=ROOT, check=False)
    except subprocess.TimeoutExpired:
        return f"not done after {timeout_s:.0f} s"
    if done.returncode < 0:
        return f"killed by {signal.Signals(-done.returncode).name}"
    said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
    return said[-1].replace("|", "/")[:120] if done.returncode else ""


def version_of(peer: Peer) -> str:
    """A digest of the weights and the program that a peer ran with."""
    digest = hashlib.sha256()
    for file in peer.files:
        digest.update((Path(os.environ[peer.variable]) / file).read_bytes())
    return digest.hexdigest()[:12]


def lines(row: Row, options: argparse.Namespace, stored: dict[tuple[str, str, str], Record]) -> Iterator[str]:
    """The lines of a cloud: the product and the literature from their records, then each peer or why it has none."""
    for record in Records(yardstick.STORED).all().values():
        if record.row == row.label and record.method in ("draft", "standard") and "failed" not in record.figures:
            yield _line(row, NAMES[record.method], OURS, record.settings["resolution"], record.figures)
    own = stored.get(_key(row, "standard", options))
    if own:
        yield _line(row, NAMES["standard"], OURS, options.cells, own.figures)
    for record in Records(PUBLISHED).all().values():
        if record.row == row.label and record.method in ("paper", "cap-udf") and record.figures.get("curve"):
            last = record.figures["curve"][-1]
            steps = f"{NAMES[record.method]}, {last['step']:,} of {record.settings['steps']:,} steps"
            if record.settings["batch"] == 1_000:
                yield _line(row, steps, OURS, row.resolution, last)
    for name, peer in PEERS.items():
        measured = stored.get(_key(row, name, options))
        if measured:
            yield _line(row, peer.name, peer.extraction, options.cells, measured.figures)
        elif name in options.peers:
            why = peer.missing(row) or "not measured yet"
            yield f"| {row.label} | {peer.name} | {peer.extraction} | {options.cells} | {why} |" + " |" * 6


def _line(row: Row, field: str, extraction: str, cells: int, figures: dict[str, Any]) -> str:
    start = f"| {row.label} | {field} | {extraction} | {cells} |"
    if "failed" in figures:
        return f"{start} {figures['failed']} |" + " |" * 6
    crowded = figures.get("non_manifold_edges")
    memory = figures.get("peak_mb")
    return (
        f"{start} {figures['chamfer_l1']:.5f} | {figures['chamfer_l2'] * 1e6:.1f} "
        f"| {1 - figures['normal_consistency']:.3f} | {figures['components']:.0f} "
        f"| {'–' if crowded is None else crowded} | {figures['seconds']:,.0f} "
        f"| {'–' if memory is None else f'{memory:,.0f}'} |"
    )


def columns(row: Row, options: argparse.Namespace) -> list[Column]:
    """The kept meshes of a cloud in the colours of their error, and the truth."""
    truth, shown = welded(row.truth()), []
    for name, peer in PEERS.items():
        kept = _mesh_of(row, name, options)
        title = f"{peer.name.split(' of ')[0]}\n{peer.extraction} extraction"
        mesh = heat_maps.coloured(kept_mesh(kept), truth) if kept.exists() else None
        shown.append(Column(title, row.label if mesh else "no mesh", mesh))
    return [*shown, Column("the truth", "", heat_maps.plain(truth))]


def _mesh_of(row: Row, name: str, options: argparse.Namespace) -> Path:
    kept: Path = options.state / f"{row.label} {name} {options.cells}.npz".replace(" ", "-").replace(",", "")
    return kept


def _settings(row: Row, options: argparse.Namespace) -> dict[str, Any]:
    return {**row.scan, "resolution": options.cells}


def _key(row: Row, name: str, options: argparse.Namespace) -> tuple[str, str, str]:
    return row.label, name, fingerprint(_settings(row, options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench peer-fields", description=__doc__)
    parser.add_argument("--cells", type=int, default=128, help="along a side; GeoUDF's own program knows 128 and 192")
    parser.add_argument("--rows", default="", help="only clouds whose label contains this")
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=list(PEERS))
    parser.add_argument("--state", type=Path, default=ROOT / "build" / "peer-fields", help="folder of the meshes")
    parser.add_argument("--timeout", type=float, default=7_200, help="seconds for one cell")
    parser.add_argument("--fresh", action="store_true", help="measure again what is already stored")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--picture", type=Path, help="draw the meshes in the colours of their error into this PNG")
    return parser
