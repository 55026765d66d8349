"""The rows of the yardstick: shapes, and how each was scanned. No method is tuned to one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import component_count
from tests.bench.data_files import data_file
from tests.support import surfaces
from tests.support.mesh_metrics import welded


@dataclass(frozen=True, slots=True)
class Row:
    """A shape, and the points that are all a method sees of it.

    noise       standard deviation per axis, unit frame
    outliers    share of the points that lie anywhere in the box
    uneven      how many times denser one end is than the other
    occluders   balls of a tenth of the longest side in which no point was scanned
    resolution  cells along the longest side, for every method that has a grid of its own choice
    """

    name: str
    truth: Callable[[], Mesh]
    points: int = 10_000
    noise: float = 0.0
    outliers: float = 0.0
    uneven: float = 1.0
    occluders: int = 0
    resolution: int = 128

    @property
    def label(self) -> str:
        """The row's name in tables and in the cache."""
        parts = [f"{self.name}, {self.points:,}"]
        parts += [f"σ {self.noise:g}"] if self.noise else []
        parts += [f"{self.outliers:.0%} outliers"] if self.outliers else []
        parts += [f"{self.uneven:g} times denser"] if self.uneven != 1 else []
        parts += [f"{self.occluders} occluders"] if self.occluders else []
        return ", ".join(parts)

    @property
    def clean(self) -> bool:
        """Whether every point lies on the surface; on such rows good methods differ by less than the figures mean."""
        return not (self.noise or self.outliers)

    @property
    def scan(self) -> dict[str, Any]:
        """How the points were drawn, for the cache."""
        scan = {"points": self.points, "noise": self.noise, "outliers": self.outliers, "uneven": self.uneven}
        return {**scan, "occluders": self.occluders} if self.occluders else scan

    def sampled(self, truth: Mesh, seed: int) -> Floats:
        """(points,3) the row's points of its truth, less those that occluders hide."""
        xyz = surfaces.sampled(
            truth, self.points, noise=self.noise, outliers=self.outliers, uneven=self.uneven, seed=seed
        )
        if not self.occluders:
            return xyz
        hidden = xyz[np.random.default_rng(seed).permutation(len(xyz))[: self.occluders]]
        seen: Floats = xyz[(np.linalg.norm(xyz[:, None] - hidden[None], axis=2) > _OCCLUDER).all(axis=1)]
        return seen


def load(file: str, part: str = "") -> Mesh:
    """A mesh of the real data, or one part of it, in its unit frame."""
    return surfaces.read_unit(data_file(file), part)


@cache
def topology(truth: Callable[[], Mesh]) -> tuple[int, int, int]:
    """Pieces, border loops and non-manifold edges of a shape, vertices at the same place being one."""
    edges = edges_of(welded(truth()).faces)
    return component_count(edges.ends), component_count(edges.border_ends), edges.crowded_count


def deformed(truth: Callable[[], Mesh]) -> Mesh:
    """A garment that somebody moves in: twisted about its height by a sixth of a turn, and bent sideways."""
    mesh = truth()
    x, y, z = mesh.vertices.T
    turn = np.pi / 3 * y
    turned = np.stack(
        [x * np.cos(turn) + z * np.sin(turn) + 0.4 * y**2, y, z * np.cos(turn) - x * np.sin(turn)], axis=1
    )
    return surfaces.unit(turned, mesh.faces)


def half_of(truth: Callable[[], Mesh]) -> Mesh:
    """Half of a shape: the other half was never scanned, and nothing may be made up for it."""
    return surfaces.half(truth())


_OCCLUDER = 0.1  # radius of an occluder, unit frame

_HEMISPHERE = partial(load, "open_surfaces/hemisphere.obj")
_MOEBIUS = partial(load, "moebius/moebius-160-10.ply")
_DRESS = partial(load, "dress/dress-v17k-f34k.obj")
_SHIRT = partial(load, "tshirt_folded/tshirt1900-folding-triFolded.obj")
_CAR = partial(load, "car/vehicle_example.gltf")
_CAR_BODY = partial(load, "car/vehicle_example.gltf", "Body")
_TRUCK = partial(load, "milktruck/CesiumMilkTruck.gltf")

KNOWN = (
    Row("hemisphere", _HEMISPHERE),
    Row("grid with holes", partial(load, "open_surfaces/grid_holes.obj")),
    Row("Möbius strip", _MOEBIUS),
    Row("dress", _DRESS),
    Row("dress", _DRESS, points=50_000, resolution=256),
    Row("dress", _DRESS, noise=0.004),
    Row("folded T-shirt", _SHIRT),
    Row("folded T-shirt", _SHIRT, noise=0.003),
    Row("car with interior", _CAR),
    Row("car body", _CAR_BODY, noise=0.006),
    Row("truck", _TRUCK, noise=0.006),
    Row("smooth sheet", surfaces.smooth_sheet, noise=0.006),
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
"""The rows that the published figures are of, and some of their kind."""

UNSEEN = (
    Row("hemisphere", _HEMISPHERE, points=1_000),
    Row("Möbius strip", _MOEBIUS, points=1_000),
    Row("dress", _DRESS, points=1_000),
    Row("folded T-shirt", _SHIRT, points=1_000),
    Row("bumpy sheet", surfaces.bumpy_sheet, points=1_000),
    Row("cylinder", surfaces.cylinder, points=1_000),
    Row("nested bowls 0.06 apart", surfaces.nested_bowls),
    Row("nested bowls 0.06 apart", surfaces.nested_bowls, points=3_000),
    Row("nested bowls 0.06 apart", surfaces.nested_bowls, points=1_000),
    Row("half dress", partial(half_of, _DRESS)),
    Row("half T-shirt", partial(half_of, _SHIRT)),
    Row("half car with interior", partial(half_of, _CAR)),
    Row("half skirt", partial(half_of, surfaces.pleated_skirt)),
    Row("half bumpy sheet", partial(half_of, surfaces.bumpy_sheet), noise=0.003),
    Row("dress", _DRESS, uneven=20),
    Row("pleated skirt", surfaces.pleated_skirt, uneven=20),
    Row("bumpy sheet", surfaces.bumpy_sheet, uneven=20),
    Row("two sheets 0.06 apart", surfaces.two_sheets, uneven=20),
    Row("smooth sheet", surfaces.smooth_sheet, noise=0.006, outliers=0.05),
    Row("dress", _DRESS, outliers=0.05),
    Row("pleated skirt", surfaces.pleated_skirt, noise=0.003, outliers=0.05),
    Row("two sheets 0.06 apart", surfaces.two_sheets, outliers=0.05),
    Row("shrub", surfaces.leaves),
    Row("shrub", surfaces.leaves, points=1_000),
    Row("chair", surfaces.chair),
    Row("chair", surfaces.chair, points=1_000),
    Row("chair", surfaces.chair, noise=0.005),
    Row("scroll", surfaces.scroll, points=1_000),
    Row("coil", surfaces.coil, points=1_000),
)
"""Rows that nothing was chosen by: few points, close layers that bend, half a shape, uneven density, outliers,
leaves, closed boxes with creases, rolls."""

DEFORMED = (
    Row("deformed dress", partial(deformed, _DRESS), noise=0.002, occluders=3),
    Row("deformed T-shirt", partial(deformed, _SHIRT), noise=0.002, occluders=3),
)
"""Rows of the paper's Figure 9: garments that are worn, behind things that stand before them."""

ROWS = KNOWN + UNSEEN
