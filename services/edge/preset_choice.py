"""Which preset suits a cloud, where the client names none.

What is looked at: how many points, how far apart in the unit frame, how noisy in spacings, how large in metres where
the capture knows, and whether there is a GPU. The answer comes with its reason, which progress and manifest repeat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Floats
from services.edge.field.noise import SCALES, noise_level
from services.edge.mesh.spacing import point_spacing
from services.edge.points.nouns import Points

Preset = Literal["draft", "standard", "fine", "scene"]

FEWEST = 200  # points: of fewer, the neighbours that train a patch are a tenth of the cloud and more
ROOM_M = 3.0  # longest side from which on a metric capture is a room or a street, not a thing
CROWD = 150_000  # points from which on a cloud of unknown scale is one: things come from phones with 5,000 to 100,000
FINE_SPACING = 1 / 80  # of the longest side, 6,000 points of a garment: sparser, the points hold no detail for `fine`
NOISY = 0.35  # σ in spacings, above which no more training brings back the detail that the noise took

REGIONS = 4  # places where spacing and noise are looked at
REGION_POINTS = 3_000  # neighbours each: enough for the quantiles that tell noise from folds, 0.1 s
_SEED = 0


@dataclass(frozen=True, slots=True)
class Traits:
    """A cloud and its machine: spacing in the unit frame, noise σ in spacings; extent_m is 0 for an unknown scale."""

    points: int
    spacing: float
    noise: float
    extent_m: float
    gpu: bool


@dataclass(frozen=True, slots=True)
class Choice:
    """A preset's name and why."""

    preset: Preset
    because: str


def choose(traits: Traits) -> Choice:
    """The preset for a cloud. What a person waits for decides on a CPU, what the points can give on a GPU."""
    if traits.points < FEWEST:
        return Choice("draft", f"{traits.points:,} points are too few to train on")
    if traits.extent_m > ROOM_M:
        return Choice("scene", f"{traits.extent_m:.1f} m are a room, not a thing")
    if traits.points > CROWD:
        return Choice("scene", f"{traits.points:,} points are many for one thing")
    if not traits.gpu:
        return Choice("standard", f"{traits.points:,} points on a CPU: under a minute")
    if traits.noise > NOISY:
        return Choice("standard", f"noise of {traits.noise:.2f} spacings leaves no finer detail")
    if traits.spacing > FINE_SPACING:
        return Choice("standard", f"points {traits.spacing:.3f} of the longest side apart hold no finer detail")
    return Choice("fine", f"{traits.points:,} points with little noise, on a GPU")


def traits_of(points: Points, *, gpu: bool) -> Traits:
    """Look at a cloud of at least 2 points, in `REGIONS` places: 0.3 s, and 1 s for ten million points."""
    rng = np.random.default_rng(_SEED)
    longest = float(np.ptp(points.xyz, axis=0).max())
    regions = [_around(points.xyz, centre) for centre in rng.integers(len(points), size=REGIONS)]
    spacing, noise = np.median([_spacing_and_noise(region) for region in regions], axis=0)
    return Traits(
        points=len(points),
        spacing=float(spacing / longest),
        noise=float(noise),
        extent_m=0.0 if points.scale_confidence == "unknown" else longest * points.metres_per_unit,
        gpu=gpu,
    )


def _around(xyz: Floats, centre: int) -> Floats:
    """The points nearest to one of them, without a tree over all."""
    away = np.einsum("nx,nx->n", xyz - xyz[centre], xyz - xyz[centre])
    nearest: Floats = xyz[np.argpartition(away, min(REGION_POINTS, len(xyz)) - 1)[:REGION_POINTS]]
    return nearest


def _spacing_and_noise(xyz: Floats) -> tuple[float, float]:
    tree = cKDTree(xyz)
    spacing = float(np.median(point_spacing(xyz, tree)))
    if len(xyz) <= 2 * SCALES[0]:  # too few to tell noise from shape
        return spacing, 0.0
    noise = noise_level(xyz, tree)
    return spacing, float(np.median(noise.sigma * noise.share)) / spacing
