"""Whether what looks like noise is folds, too sparsely sampled to leave anything flat: unseen points decide.

The residuals of layers half a spacing to two apart crowd as those of noise do (`noise.py`), and to take that "noise"
off makes one sheet of them. But a sheet between layers has left its points, those it was made of and others:

    r, s   medians over a region's held-out points of their distance to the local field of the other points, as measured
           and denoised

    s/r   0.8 to 1.25 where it was noise, 1.3 to 700 where it was folds
    r/h   in spacings h: 0 to 0.26 where it was folds, as much where it was little noise. From σ = 0.4h on the field as
          measured crumples through the noise: r/h is 0.3 to 0.4, and s/r, up to 2, says nothing any more.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.field.denoise import denoise
from services.edge.field.local import local_field
from services.edge.field.noise import SCALES, Noise, between, noise_level, ramp, regions

LEFT = (1.25, 1.5)  # s/r: noise below, folds above, in between by degrees
CRUMPLED = (0.28, 0.31)  # r/h: folds below, above it is noise whatever s/r is
HELD_OUT = 0.2  # share of the points
JUDGED = 8_000  # points, in whole regions: 3 s; more would only sharpen the medians
REGION = 1_000  # points: the medians then rest on 200
_LEAST = 1e-9  # of a distance: 0 where all held-out points lie on the field
_SEED = 0


def noise_of(xyz_unit: Floats, tick: Tick = no_tick) -> Noise:
    """The noise of points (N,3) in the unit frame that is no folds. Deterministic.

    `tick` is called between chunks, on the caller's thread. Raises what it raises.
    """
    xyz = np.asarray(xyz_unit, np.float64)
    if len(xyz) <= 2 * SCALES[0]:  # too few to tell noise from shape
        return Noise(np.zeros(len(xyz)), np.zeros(len(xyz)))
    noise = noise_level(xyz, cKDTree(xyz))
    suspect = np.flatnonzero(noise.share > 0)
    if len(suspect) <= 2 * SCALES[0]:
        return noise
    centres, folded = _folded(xyz, noise, _judged(xyz[suspect], suspect), tick)
    share = noise.share.copy()
    share[suspect] *= 1 - between(centres, folded, xyz[suspect])
    return Noise(noise.sigma, share)


def _judged(xyz: Floats, suspect: Ints) -> Ints:
    """Which of the suspect points, whose places are xyz, are looked at: all, or whole regions of them."""
    if len(suspect) <= JUDGED:
        return suspect
    middles = np.random.default_rng(_SEED).permutation(len(suspect))[: JUDGED // REGION]
    _, members = cKDTree(xyz).query(xyz[middles], k=REGION)
    judged: Ints = suspect[np.unique(members)]
    return judged


def _folded(xyz: Floats, noise: Noise, judged: Ints, tick: Tick) -> tuple[Floats, Floats]:
    """Of the judged points: centres of regions (R,3), and how surely each is folds (R,) in [0,1]."""
    mixed = np.random.default_rng(_SEED).permutation(judged)
    split = round(HELD_OUT * len(judged))
    unseen, seen = xyz[mixed[:split]], np.sort(mixed[split:])
    taken = Noise(noise.sigma[seen], noise.share[seen])
    measured = local_field(xyz[seen], tick=lambda part: tick(0.25 * part))
    denoised = local_field(denoise(xyz[seen], taken, tick=lambda part: tick(0.25 + 0.5 * part)))
    tick(1.0)
    centres, members = regions(unseen, round(REGION * HELD_OUT))
    near = np.median(measured(unseen)[0][members], axis=1) + _LEAST
    left = np.median(denoised(unseen)[0][members], axis=1) / near
    spacing = np.median(measured.patches.spacing[measured.tree.query(unseen)[1]][members], axis=1)
    return centres, ramp(left, LEFT) * (1 - ramp(near / spacing, CRUMPLED))
