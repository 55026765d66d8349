"""Extraction and cleaning at 64³ to 256³ cells: seconds, peak memory, size, and what is wrong with the topology."""

from __future__ import annotations

import sys
import time
import tracemalloc
from collections.abc import Sequence

from services.edge.arrays import DistanceFn, Floats, Ints
from services.edge.field import local_field
from services.edge.mesh.clean import clean
from services.edge.mesh.extract import extract
from services.edge.mesh.metrics import edge_faces, pieces
from tests import surfaces

RESOLUTIONS = (64, 96, 128, 192, 256)
POINTS = 10_000
SHAPES = ((surfaces.hemisphere, 1), (surfaces.pleated_skirt, 2), (surfaces.two_sheets, 2))  # and their borders


def main(arguments: Sequence[str] = ()) -> None:
    """Print the table; arguments are resolutions in place of the usual ones."""
    resolutions = [int(argument) for argument in arguments] or RESOLUTIONS
    print("| shape | cells | extract s | clean s | peak MB | vertices | pieces | non-manifold | border loops (truth) |")
    print("|---|---|---|---|---|---|---|---|---|")
    for make, borders in SHAPES:
        truth = make()
        near = surfaces.sampled(truth, POINTS)
        distance = local_field(near)
        for resolution in resolutions:
            began = time.perf_counter()
            raw = extract(distance, near, resolution=resolution)
            extracted = time.perf_counter()
            mesh = clean(raw, near)
            cleaned = time.perf_counter()
            edges = edge_faces(mesh.faces)
            print(
                f"| {make.__name__} | {resolution} | {extracted - began:.2f} | {cleaned - extracted:.2f} "
                f"| {_peak_mb(distance, near, resolution):.0f} | {len(mesh.vertices):,} | {pieces(edges.vertices)} "
                f"| {int((edges.faces > 2).sum())} | {_loops(mesh.faces)} ({borders}) |",
                flush=True,
            )


def _peak_mb(distance: DistanceFn, near: Floats, resolution: int) -> float:
    """Peak of numpy's memory in one extraction with cleaning, run apart because tracing costs time."""
    tracemalloc.start()
    clean(extract(distance, near, resolution=resolution), near)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def _loops(faces: Ints) -> int:
    edges = edge_faces(faces)
    return pieces(edges.vertices[edges.faces == 1])


if __name__ == "__main__":
    main(sys.argv[1:])
