"""Choose how strongly a fit is pulled to noisy points, by cross-validation on held-out points.

A fit pulls each patch towards its point with the weight μ/σ² (`anchor_losses.py`). With too little, pleats are smoothed
away; with too much, the noise comes back. So before the fit a fifth of the points is held out, short trial fits with
different μ predict where those were scanned, and the μ that predicts best is chosen, or no pull at all. There is one μ
for the whole cloud, because σ is local already; one per region of 400 held-out points was 2 % worse on a noisy dress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.field.anchors import Anchors
from capture2vr.edge.field.noise import Noise

# μ, rising: cloth with noise almost as large as its folds needs the most. Where the least predicts best, averaging can
# not be too wide.
CANDIDATES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
TIE = 1.005  # of the least error: up to here a larger μ counts as equal, and wins: its patches bend more safely
HELD_OUT = 0.2  # share of the points
FAR = 3.0  # in σ: errors are cut off here, so that outliers do not decide
TRIAL_POINTS = 40_000  # most points of the trial fits, in balls of `BALL`: more would only sharpen a mean
BALL = 1_000  # points
_LEAST_NOISE = 0.02  # in spacings: lower bound of σ; more exact points get no more trust
_STAYED = 3e-4  # in spacings: a smaller move is none; rounding one of 400,000 points to float32 moves it by a tenth
_SEED = 0


@dataclass(frozen=True, slots=True)
class Scan:
    """The scanned points relative to their anchors.

    height, sigma  (N,) distance from the anchor along the normal, and noise, both in spacings
    freedom        (N,) in [0,1]: how much of its offset a patch may use, 0 where there is no noise
    usable         (N,) whether the height is a measurement: False for clean points and outliers
    """

    height: Floats
    sigma: Floats
    freedom: Floats
    usable: Bools

    def trust(self, weight: float) -> Floats:
        """μ/σ² (N,), 0 where the height is not usable."""
        trust: Floats = np.where(self.usable, weight / np.square(self.sigma), 0)
        return trust

    def without_trust(self) -> Scan:
        """Copy for a fit whose anchors stay at the denoised points."""
        return replace(self, freedom=np.zeros_like(self.freedom), usable=np.zeros_like(self.usable))

    def subset(self, part: Ints) -> Scan:
        """Return the subset of these anchors."""
        return Scan(self.height[part], self.sigma[part], self.freedom[part], self.usable[part])


def scan_of(xyz: Floats, noise: Noise, anchors: Anchors) -> Scan:
    """Compare points (N,3) as they were scanned with their anchors."""
    height = np.einsum("nx,nx->n", xyz - anchors.xyz, anchors.frame[:, 2]) / anchors.spacing
    sigma = np.maximum(noise.sigma / anchors.spacing, _LEAST_NOISE)
    freedom = np.asarray(noise.share, np.float64)
    # The anchor's base passes through the denoised point. A point that the denoising did not move is an outlier: it has
    # no pull, so that its patch can follow the neighbours.
    moved = np.abs(height - anchors.terms[:, 0])
    usable = (freedom > 0) & (moved > _STAYED) & (np.abs(height) < 2 * FAR * sigma)
    return Scan(height, sigma, freedom, np.asarray(usable))


def trial_points(xyz: Floats) -> Ints:
    """Choose which of the points (N,3) the trial fits use: all, or whole balls of them."""
    if len(xyz) <= TRIAL_POINTS:
        return np.arange(len(xyz))
    centres = np.random.default_rng(_SEED).permutation(len(xyz))[: TRIAL_POINTS // BALL]
    _, members = cKDTree(xyz).query(xyz[centres], k=BALL)
    return np.unique(members)


def held_out_mask(count: int) -> Bools:
    """Choose the held-out points (count,) that the trial fits do not see."""
    return np.random.default_rng(_SEED).random(count) < HELD_OUT


def squared_errors(offset: Floats, scan: Scan) -> Floats:
    """Squared distance of predicted offsets (N,) to where the points were scanned, in σ, bounded."""
    return np.square(np.minimum(np.abs(offset - scan.height) / scan.sigma, FAR))


def choose_trust(errors_of: Sequence[Floats]) -> float | None:
    """Choose μ by the errors (H,) of each candidate at the held-out points; the least one where there are none.

    None where the least predicts best: the surface is so smooth that the denoised points, averaged over neighbourhoods
    of up to 288, are better than what the scanned ones add. On flat faces that meet in creases the error is then a
    quarter less, on a smooth sheet a tenth.
    """
    if not errors_of or len(errors_of[0]) == 0:
        return CANDIDATES[0]
    means = [float(error.mean()) for error in errors_of]
    if min(means) == means[0]:
        return None
    return max(candidate for candidate, mean in zip(CANDIDATES, means, strict=True) if mean <= TIE * min(means))
