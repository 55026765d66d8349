"""Points to mesh on the yardstick shapes: how near, how whole, how long. One default serves every row."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from services.edge.field import denoise, local_field
from services.edge.mesh.clean import clean
from services.edge.mesh.extract import extract
from services.edge.mesh.metrics import Quality, compare
from services.edge.mesh.nouns import Mesh
from services.edge.points.outliers import inliers
from tests import surfaces
from tests.conftest import data_folder


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: a shape, how it was scanned, how finely it is meshed."""

    name: str
    truth: Callable[[], Mesh]
    points: int = 10_000
    noise: float = 0.0
    outliers: float = 0.0
    resolution: int = 128


@dataclass(frozen=True, slots=True)
class Result:
    """What came out: the figures, and the seconds from points to mesh."""

    row: Row
    quality: Quality
    seconds: float


def load(file: str) -> Mesh:
    """A mesh of the real data, its parts merged, in its unit frame."""
    return surfaces.read_unit(data_folder() / file)


_DRESS = partial(load, "dress/dress-v17k-f34k.obj")
_SHIRT = partial(load, "tshirt_folded/tshirt1900-folding-triFolded.obj")
_CAR = partial(load, "car/vehicle_example.gltf")
_TRUCK = partial(load, "milktruck/CesiumMilkTruck.gltf")

ROWS = (
    Row("hemisphere", partial(load, "open_surfaces/hemisphere.obj")),
    Row("grid with holes", partial(load, "open_surfaces/grid_holes.obj")),
    Row("Möbius strip", partial(load, "moebius/moebius-160-10.ply")),
    Row("dress", _DRESS),
    Row("dress", _DRESS, points=50_000, resolution=256),
    Row("dress", _DRESS, noise=0.004),
    Row("folded T-shirt", _SHIRT),
    Row("folded T-shirt", _SHIRT, noise=0.003),
    Row("car with interior", _CAR),
    Row("truck", _TRUCK, noise=0.006),
    Row("smooth sheet", surfaces.smooth_sheet, noise=0.006),
    Row("smooth sheet", surfaces.smooth_sheet, noise=0.006, outliers=0.05),
    Row("pleated sheet", surfaces.pleated_sheet, noise=0.003),
    Row("pleated skirt", surfaces.pleated_skirt),
    Row("pleated skirt", surfaces.pleated_skirt, points=1_000),
    Row("two sheets 0.06 apart", surfaces.two_sheets),
    Row("two sheets 0.06 apart", surfaces.two_sheets, points=3_000),
    Row("two sheets 0.06 apart", surfaces.two_sheets, points=1_000),
    Row("bumpy sheet", surfaces.bumpy_sheet, noise=0.004),
    Row("cylinder", surfaces.cylinder, noise=0.005),
    Row("corner", surfaces.corner, noise=0.004),
)


def reconstruct(row: Row, seed: int) -> tuple[Mesh, float]:
    """The row's mesh and the seconds it took, the sampling not counted."""
    points = surfaces.sampled(row.truth(), row.points, noise=row.noise, outliers=row.outliers, seed=seed)
    start = time.perf_counter()
    points = denoise(points[inliers(points)])
    mesh = clean(extract(local_field(points), points, resolution=row.resolution), points)
    return mesh, time.perf_counter() - start


def rows(match: str = "", seed: int = 0) -> Iterator[Result]:
    """The results one by one, of the rows whose name contains `match`."""
    for row in ROWS:
        if match in row.name:
            mesh, seconds = reconstruct(row, seed)
            yield Result(row, compare(mesh, row.truth()), seconds)


def main(arguments: list[str]) -> None:
    """Print the table; an argument limits it to the rows whose name contains it."""
    print("| row | points | noise | Chamfer-L1 | floor | F@.005 | normals | pieces | loops | non-manifold | area | s |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    for result in rows(" ".join(arguments)):
        print("| " + " | ".join(_cells(result)) + " |", flush=True)


def _cells(result: Result) -> list[str]:
    row, quality = result.row, result.quality
    return [
        row.name,
        f"{row.points:,}",
        f"{row.noise or 0}" + (f", {row.outliers:.0%} outliers" if row.outliers else ""),
        f"{quality.chamfer_l1:.5f}",
        f"{quality.floor:.5f}",
        f"{quality.f_005:.3f}",
        f"{quality.normal_consistency:.3f}",
        f"{quality.components}",
        f"{quality.boundary_loops}",
        f"{quality.non_manifold_edges / max(quality.edges, 1):.2%}",
        f"{quality.area_ratio:.3f}",
        f"{result.seconds:.1f}",
    ]


if __name__ == "__main__":
    main(sys.argv[1:])
