"""The product's extraction beside that of others, on the same fields: `python -m tests.bench peer-extraction`.

DCUDF2 (MIT) and MIND (MIT, but it compiles in GCO and cc3d, which are not) run in an interpreter of their own, which
PEERS_PYTHON names, from the clones that DCUDF2_FOLDER and MIND_FOLDER name; nothing of theirs is in this repository.
The fields are networks that `published` trained, a small one that is trained on the spot, and the garment network that
DCUDF2's repository carries, whose true surface is not published: there the mean value of the field on the mesh stands
for the distance.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.mesh.topology import component_count
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from capture2vr.edge.paper_field.networks import network_of
from capture2vr.edge.preset import load_preset
from tests.bench.methods import Settings, peak_mb, shortened
from tests.bench.peers.peer_fields import run_child
from tests.bench.published import OBJECTS, Cell, add_state, cells, weights_reached
from tests.support.mesh_metrics import chamfer_l1, welded

PEERS = {"dcudf2": ("DCUDF2", "DCUDF2_FOLDER"), "mind": ("MIND", "MIND_FOLDER")}
QUICK = "pleated skirt, 1,000: paper, six layers of 64"
"""A network of the preset `paper`, small and trained on the spot, so that the peers end on a CPU."""

_QUICK = Settings("paper", steps=1_000, batch=1_000, changes={"widths": (64,) * 6})
GARMENT = "garment 564 of DCUDF2's repository"
_PAD = 0.05  # around the points, as DCUDF2's own evaluation has it
_CHUNK = 1 << 16
_NEAR = 0.02  # within which cells of a grid are taken for points of a network without any
_CELLS = 96  # of that grid
_PULLS = 5


@dataclass(frozen=True, slots=True)
class Subject:
    """A field as a stored network, the points that it was fitted to, and the true surface where it is known."""

    name: str
    network: Path
    points: Floats
    truth: Mesh | None


class NetworkField:
    """The `DistanceFn` of a network alone: values (N,) and gradients (N,3) of length 1."""

    def __init__(self, network: torch.nn.Module) -> None:
        self._network = network

    @classmethod
    def read(cls, path: Path) -> NetworkField:
        """The field of a stored network."""
        return cls(torch.load(path, weights_only=False))

    def __call__(self, queries: Floats) -> tuple[Floats, Floats]:
        values, gradients = np.empty(len(queries), np.float32), np.empty((len(queries), 3), np.float32)
        for start in range(0, len(queries), _CHUNK):
            part = slice(start, start + _CHUNK)
            q = torch.from_numpy(np.ascontiguousarray(queries[part], np.float32)).requires_grad_()
            f = self._network(q)
            (slope,) = torch.autograd.grad(f.sum(), q)
            slope = slope / (slope.norm(dim=1, keepdim=True) + 1e-12)
            values[part], gradients[part] = f.detach().numpy(), slope.numpy()
        return values, gradients


def main(arguments: list[str]) -> None:
    """Print the table."""
    options = _parser().parse_args(arguments)
    print(
        "| field | extraction | cells | s | peak MB | Chamfer-L1 | mean value on the mesh | vertices | pieces "
        "| non-manifold |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as scratch:
        for subject in subjects(Path(scratch), options):
            for line in lines(subject, options):
                print(line, flush=True)


def subjects(scratch: Path, options: argparse.Namespace) -> Iterator[Subject]:
    """The networks that have been trained so far, the quick one, and that of DCUDF2 where its clone is."""
    for cell in cells():
        name = f"{cell.row.label}: {cell.label}"
        reached = weights_reached(cell, options.state)
        if options.fields not in name or reached is None:
            continue
        network = scratch / "network.pt"
        step = write_network(cell, reached, network)
        truth = welded(cell.row.truth())
        yield Subject(f"{name}, {step:,} steps", network, cell.row.sampled(truth, 0), truth)
    if options.fields in QUICK:
        yield quick(scratch / "quick.pt")
    folder = os.environ.get("DCUDF2_FOLDER")
    if folder and options.fields in GARMENT:
        network = scratch / "garment.pt"
        failed = _child("dump", folder, Path("-"), network, Path("-"))
        if failed:
            sys.exit(f"{GARMENT}: {failed}")
        sys.path.insert(0, folder)  # the class of its network
        yield Subject(GARMENT, network, points_of(NetworkField.read(network)), None)


def quick(network: Path, settings: Settings = _QUICK) -> Subject:
    """Train the small network of QUICK and write it."""
    row = next(row for row in OBJECTS if QUICK.startswith(row.label))
    truth = welded(row.truth())
    points = row.sampled(truth, 0)
    config = load_preset(settings.method).fit
    assert isinstance(config, NetworkConfig)
    *_, last = fit_network(points, shortened(config, settings))
    torch.save(last.field.network, network)
    return Subject(f"{QUICK}, {settings.steps:,} steps", network, points, truth)


def write_network(cell: Cell, weights: tuple[int, Path], target: Path) -> int:
    """Write a cell's network with its weights; return the step that they are of."""
    step, path = weights
    network = network_of(cell.config)
    network.load_state_dict(torch.load(path, weights_only=True))
    torch.save(network, target)
    return step


def points_of(field: NetworkField) -> Floats:
    """Points on a field's zero set: cells of a grid near it, pulled along the gradient."""
    axis = np.linspace(-0.55, 0.55, _CELLS)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    near: Floats = grid[field(grid)[0] < _NEAR]
    for _ in range(_PULLS):
        f, gradient = field(near)
        near = near - f[:, None] * gradient
    return near


def lines(subject: Subject, options: argparse.Namespace) -> Iterator[str]:
    """A line for the product's extraction, and one for each peer, or why there is none."""
    field = NetworkField.read(subject.network)
    began = time.perf_counter()
    mesh = clean(extract(field, subject.points, resolution=options.cells), subject.points)
    yield _line(subject, "the product's", options.cells, time.perf_counter() - began, peak_mb(), mesh, field)
    for peer, (name, variable) in PEERS.items():
        folder = os.environ.get(variable)
        if peer not in options.peers:
            continue
        if not folder:
            yield f"| {subject.name} | {name} | {options.cells} | no {variable} |" + " |" * 6
            continue
        with tempfile.TemporaryDirectory() as scratch:
            task, target = Path(scratch) / "task.json", Path(scratch) / "mesh.npz"
            low, high = subject.points.min(axis=0) - _PAD, subject.points.max(axis=0) + _PAD
            asked = {"low": low.tolist(), "high": high.tolist(), "resolution": options.cells}
            task.write_text(json.dumps(asked))
            failed = _child(peer, folder, task, subject.network, target, options.timeout)
            if failed:
                yield f"| {subject.name} | {name} | {options.cells} | {failed} |" + " |" * 6
                continue
            with np.load(target) as made:
                mesh = Mesh(made["vertices"].astype(np.float64), made["faces"].astype(np.int64))
                yield _line(subject, name, options.cells, float(made["seconds"]), float(made["peak_mb"]), mesh, field)


def _line(subject: Subject, name: str, cells: int, seconds: float, peak: float, mesh: Mesh, field: NetworkField) -> str:
    if not len(mesh.faces):
        return f"| {subject.name} | {name} | {cells} | {seconds:.0f}, no surface |" + " |" * 6
    edges = edges_of(mesh.faces)
    distance = f"{chamfer_l1(mesh, subject.truth):.5f}" if subject.truth else "–"
    value = float(field(sample(mesh, 20_000, np.random.default_rng(0)).xyz)[0].mean())
    return (
        f"| {subject.name} | {name} | {cells} | {seconds:.1f} | {peak:.0f} | {distance} | {value:.5f} "
        f"| {len(mesh.vertices):,} | {component_count(edges.ends)} | {edges.crowded_count} |"
    )


def _child(peer: str, folder: str, task: Path, network: Path, target: Path, timeout_s: float | None = None) -> str:
    """Run the child; return why it failed, or nothing."""
    asked = [peer, str(Path(folder).resolve()), str(task), str(network), str(target)]
    return run_child("tests.bench.peers.peer_extraction_child", asked, timeout_s)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench peer-extraction", description=__doc__)
    parser.add_argument("--cells", type=int, default=256, help="along a side of the box")
    parser.add_argument("--fields", default="dress, 10,000: ", help="only fields whose name contains this")
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=list(PEERS))
    parser.add_argument("--timeout", type=float, default=7_200, help="seconds for one extraction")
    add_state(parser)
    return parser
