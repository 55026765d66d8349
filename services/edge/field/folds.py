"""Tell noise from folds that are sampled too sparsely to look flat anywhere, by means of held-out points.

Layers half a spacing to two apart have residuals like those of noise (`noise.py`), and denoising would merge them into
one sheet. But a merged sheet lies off all points of the layers, those that it was made from and held-out ones:

    r, s   medians over a region's held-out points of their distance to the local field of the other points, as measured
           and denoised

    s/r   0.8 to 1.25 for noise, 1.3 to 700 for folds
    r/h   in spacings h: 0 to 0.26 for folds, and for weak noise too. From σ = 0.4h on, the local field of the measured
          points crumples: r/h is 0.3 to 0.4, and s/r, which then reaches 2, decides nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick, smoothstep
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.noise import SCALES, Noise, interpolate_regions, noise_level, regions

DENOISED_RATIO = (1.25, 1.5)  # s/r: noise below, folds above, a smooth transition in between
MEASURED_GAP = (0.28, 0.31)  # r/h: folds are possible below; above it is noise, whatever s/r is
HELD_OUT = 0.2  # share of the points
TESTED = 8_000  # most points that are tested, in whole regions: 3 s; more would only sharpen the medians
REGION = 1_000  # points per region: its medians are then taken over 200
_LEAST = 1e-9  # added to r, which is 0 where all held-out points lie on the field
_SEED = 0


def noise_of(xyz_unit: Floats, tick: Tick = no_tick) -> Noise:
    """Estimate the noise of points (N,3) in the unit frame; folds do not count as noise. Deterministic.

    `tick` is called between chunks, on the caller's thread; its errors pass through.
    """
    xyz = np.asarray(xyz_unit, np.float64)
    if len(xyz) <= 2 * SCALES[0]:  # too few to tell noise from shape
        return Noise(np.zeros(len(xyz)), np.zeros(len(xyz)))
    noise = noise_level(xyz, cKDTree(xyz))
    suspect = np.flatnonzero(noise.share > 0)
    if len(suspect) <= 2 * SCALES[0]:
        return noise
    centres, folded = _fold_share(xyz, noise, _tested_points(xyz[suspect], suspect), tick)
    share = noise.share.copy()
    share[suspect] *= 1 - interpolate_regions(centres, folded, xyz[suspect])
    return Noise(noise.sigma, share)


def _tested_points(xyz: Floats, suspect: Ints) -> Ints:
    """Choose which of the suspect points, at xyz, are tested: all, or whole regions of them."""
    if len(suspect) <= TESTED:
        return suspect
    middles = np.random.default_rng(_SEED).permutation(len(suspect))[: TESTED // REGION]
    _, members = cKDTree(xyz).query(xyz[middles], k=REGION)
    tested: Ints = suspect[np.unique(members)]
    return tested


def _fold_share(xyz: Floats, noise: Noise, tested: Ints, tick: Tick) -> tuple[Floats, Floats]:
    """Compute regions of the tested points -> centres (R,3), and how surely each is folds (R,) in [0,1]."""
    shuffled = np.random.default_rng(_SEED).permutation(tested)
    split = round(HELD_OUT * len(tested))
    held_out, used = xyz[shuffled[:split]], np.sort(shuffled[split:])
    used_noise = Noise(noise.sigma[used], noise.share[used])
    measured = local_field(xyz[used], tick=lambda part: tick(0.25 * part))
    denoised = local_field(denoise(xyz[used], used_noise, tick=lambda part: tick(0.25 + 0.5 * part)))
    tick(1.0)
    centres, members = regions(held_out, round(REGION * HELD_OUT))
    gap = np.median(measured(held_out)[0][members], axis=1) + _LEAST
    ratio = np.median(denoised(held_out)[0][members], axis=1) / gap
    spacing = np.median(measured.patches.spacing[measured.tree.query(held_out)[1]][members], axis=1)
    return centres, smoothstep(ratio, DENOISED_RATIO) * (1 - smoothstep(gap / spacing, MEASURED_GAP))
