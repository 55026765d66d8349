"""Extraction and cleaning at 64³ to 512³ cells: seconds, peak memory, size, and what is wrong with the topology.

The learned field is a network regressed onto the local field: its values cost what those of any trained one do.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.topology import component_count
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from tests.bench.methods import peak_mb
from tests.support import surfaces

RESOLUTIONS = (64, 128, 256, 512)
SHAPES = ((surfaces.hemisphere, 1), (surfaces.pleated_skirt, 2), (surfaces.two_sheets, 2))  # and their borders
REGRESSION = 300  # steps onto the local field: enough for a whole surface on these shapes


def main(arguments: list[str]) -> None:
    """Print the table."""
    options = _parser().parse_args(arguments)
    print(
        "| field | shape | cells | extract s | clean s | peak MB | vertices | pieces | non-manifold | loops (truth) |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for make, borders in SHAPES:
        near = surfaces.sampled(make(), options.points)
        for name in options.fields:
            distance = FIELDS[name](near, options)
            for resolution in options.cells:
                row = _row(distance, near, resolution, borders)
                print(f"| {name} | {make.__name__} | {resolution} | {row}", flush=True)


def _row(distance: DistanceFn, near: Floats, resolution: int, borders: int) -> str:
    before = _reset_peak()
    began = time.perf_counter()
    raw = extract(distance, near, resolution=resolution)
    extracted = time.perf_counter()
    mesh = clean(raw, near)
    cleaned = time.perf_counter()
    peak = peak_mb() - before
    edges = edges_of(mesh.faces)
    return (
        f"{extracted - began:.2f} | {cleaned - extracted:.2f} | {peak:.0f} | {len(mesh.vertices):,} "
        f"| {component_count(edges.ends)} | {edges.crowded_count} | {component_count(edges.border_ends)} "
        f"({borders}) |"
    )


def _local(near: Floats, options: argparse.Namespace) -> DistanceFn:
    return local_field(near)


def _learned(near: Floats, options: argparse.Namespace) -> DistanceFn:
    config = NetworkConfig(warm_start=REGRESSION, steps=1)
    *_, last = fit_network(near, config, device=options.device, base=local_field(near))
    return last.field


FIELDS = {"local": _local, "learned": _learned}


def _reset_peak() -> float:
    """Make Linux forget the peak resident memory; what is resident now, in MB."""
    Path("/proc/self/clear_refs").write_text("5")
    return peak_mb()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench extraction", description=__doc__)
    parser.add_argument("--cells", type=int, nargs="*", default=RESOLUTIONS)
    parser.add_argument("--fields", nargs="*", default=list(FIELDS), choices=list(FIELDS))
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--device", default="cpu")
    return parser
