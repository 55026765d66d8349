"""Choose a preset for a point cloud automatically, where the client names none.

The choice depends on the number of points, their spacing in the unit frame, their noise in spacings, the size in metres
where the scale is known, and on whether there is a GPU. It comes with a reason, which progress and manifest show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field.noise import SCALES, noise_level
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset import PresetName
from capture2vr.sentences.sentence import say

FEWEST = 200  # points: of fewer, the neighbours that train a patch are a tenth of the cloud and more
# Longest side above which 512 cells are coarser than the 2 cm that furniture needs; one turn of a street's scanner is
# longer too, but has too few points for cells of its own far away.
TILES_M = 10.0
TILES_POINTS = 2_000_000  # above which a scene has more to show than its 200,000 points and 512 cells
ROOM_M = 3.0  # longest side above which a metric capture is a room or a street, not an object
CROWD = 150_000  # points above which a cloud is taken for a scene: phones scan an object with 5,000 to 100,000
FINE_SPACING = 1 / 80  # of the longest side, 6,000 points of a garment: sparser points hold no detail for `fine`
NOISY = 0.35  # σ in spacings, above which more training does not bring back the detail that the noise hides

# Of depth from photos, whose windows of 7 pixels smooth it already. Training for a minute left the held-out likeness as
# it was (fruit 26.5 dB, furry head 21.3 → 21.1), and 312 cells showed no more of the fruit than 192.
STEREO_FINEST = 192

REGIONS = 4  # places of the cloud where spacing and noise are measured
REGION_POINTS = 3_000  # neighbours each: enough for the quantiles that tell noise from folds, 0.1 s
_SEED = 0


@dataclass(frozen=True, slots=True)
class Traits:
    """What the choice depends on. Spacing: in the unit frame; noise: σ in spacings; extent_m: 0 if unknown; stereo:
    whether it is an object cut out of depth that was matched between photos."""

    points: int
    spacing: float
    noise: float
    extent_m: float
    gpu: bool
    stereo: bool = False


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen preset's name, and the reason in words; finest: most cells along the longest side, 0: the preset's."""

    preset: PresetName
    because: str
    finest: int = 0


def choose(traits: Traits) -> Choice:
    """Choose the preset for a cloud: on a CPU by the waiting time, on a GPU by the detail that the points can give."""
    if traits.points < FEWEST:
        return Choice("draft", say("points_too_few_to_train", count=traits.points))
    if traits.extent_m > TILES_M and traits.points > CROWD:
        return Choice("scene-tiles", say("size_m_too_large_cells", size=traits.extent_m))
    if traits.points > TILES_POINTS:
        return Choice("scene-tiles", say("points_show_more_than", count=traits.points))
    if traits.extent_m > ROOM_M:
        return Choice("scene", say("size_m_room", size=traits.extent_m))
    if traits.stereo:
        return Choice("draft", say("points_from_photos_gain_nothing", count=traits.points), STEREO_FINEST)
    if traits.points > CROWD:
        return Choice("scene", say("points_many_one_object", count=traits.points))
    if not traits.gpu:
        return Choice("standard", say("points_on_cpu_where_finer", count=traits.points))
    if traits.noise > NOISY:
        return Choice("standard", say("noise_point_spacings_hides_finer", noise=traits.noise))
    if traits.spacing > FINE_SPACING:
        return Choice("standard", say("points_longest_side_apart_show", spacing=traits.spacing))
    return Choice("fine", say("points_with_little_noise", count=traits.points))


def traits_of(points: Points, *, gpu: bool) -> Traits:
    """Measure a cloud of at least 2 points, in `REGIONS` places: takes 0.3 s, and 1 s for ten million points."""
    rng = np.random.default_rng(_SEED)
    longest = float(np.ptp(points.xyz, axis=0).max())
    regions = [_around(points.xyz, centre) for centre in rng.integers(len(points), size=REGIONS)]
    unsized = points.scale_confidence == "unknown" or points.scale_by_model  # no guess chooses how a capture is made
    spacing, noise = np.median([_spacing_and_noise(region) for region in regions], axis=0)
    return Traits(
        points=points.whole.count if points.whole else len(points),
        spacing=float(spacing / longest),
        noise=float(noise),
        extent_m=0.0 if unsized else longest * points.metres_per_unit,
        gpu=gpu,
        stereo=_is_object_of_photos(points),
    )


def _is_object_of_photos(points: Points) -> bool:
    """Return whether points are an object's, cut out of depth that was matched between photos."""
    is_object = points.cut is not None and points.cut.kept == "object"
    return is_object and any(not view.tracked for view in points.texture_views)


def _around(xyz: Floats, centre: int) -> Floats:
    """(REGION_POINTS,3) the points nearest to the one with index `centre`, found without a KD-tree of all points."""
    away = np.einsum("nx,nx->n", xyz - xyz[centre], xyz - xyz[centre])
    nearest: Floats = xyz[np.argpartition(away, min(REGION_POINTS, len(xyz)) - 1)[:REGION_POINTS]]
    return nearest


def _spacing_and_noise(xyz: Floats) -> tuple[float, float]:
    """Median spacing of points (N,3) in their units, and median noise σ in spacings."""
    tree = cKDTree(xyz)
    spacing = float(np.median(point_spacing(xyz, tree)))
    if len(xyz) <= 2 * SCALES[0]:  # too few to tell noise from shape
        return spacing, 0.0
    noise = noise_level(xyz, tree)
    return spacing, float(np.median(noise.sigma * noise.share)) / spacing
