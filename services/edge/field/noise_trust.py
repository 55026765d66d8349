"""How far to trust noisy points: decided by points that a fit has not seen.

A fit pulls each patch towards its point with the weight μ/σ² (`agreement.py`). With too little, pleats are smoothed
away; with too much, the noise comes back. So before the fit a fifth of the points lose their pull, short fits with
different μ predict where those were scanned, and the μ that predicted best is taken, or none at all: one answer for
the whole cloud, for σ is local already. One per region of 400 held-out points was 2 % worse on a noisy dress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Bools, Floats, Ints
from services.edge.field.anchors import Anchors
from services.edge.field.noise import Noise

# μ, rising: cloth whose noise nears its folds wants the most. Where the least predicts best, no averaging is too wide.
CANDIDATES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
TIE = 1.005  # of the least error: what predicts as well and trusts more wins, with its own point a patch bends safer
HELD_OUT = 0.2  # share of the points
FAR = 3.0  # in σ: errors count up to here, so that strays decide nothing
JUDGES = 40_000  # points of the short fits, in balls of `BALL`: more would only sharpen a mean
BALL = 1_000
_LEAST_NOISE = 0.02  # in spacings: points as exact as this are not worth more trust
_STAYED = 3e-4  # in spacings: to round one of 400,000 points to float32 moves it by a tenth of that
_SEED = 0


@dataclass(frozen=True, slots=True)
class Scan:
    """height (N,): how far from its anchor a point was scanned, along the normal; sigma (N,): its noise, both in
    spacings; freedom (N,) in [0,1]: how much of its offset a patch may use, 0 where there is no noise; told (N,):
    whether the height says anything."""

    height: Floats
    sigma: Floats
    freedom: Floats
    told: Bools

    def trust(self, weight: float) -> Floats:
        """μ/σ² (N,), 0 where the height says nothing."""
        trust: Floats = np.where(self.told, weight / np.square(self.sigma), 0)
        return trust

    def ignored(self) -> Scan:
        """The same where anchors stay at the denoised points."""
        return replace(self, freedom=np.zeros_like(self.freedom), told=np.zeros_like(self.told))

    def of(self, part: Ints) -> Scan:
        """The scan of these anchors."""
        return Scan(self.height[part], self.sigma[part], self.freedom[part], self.told[part])


def scan_of(xyz: Floats, noise: Noise, anchors: Anchors) -> Scan:
    """Of points (N,3) as they were scanned, and the anchors that stand for them."""
    height = np.einsum("nx,nx->n", xyz - anchors.xyz, anchors.frame[:, 2]) / anchors.spacing
    sigma = np.maximum(noise.sigma / anchors.spacing, _LEAST_NOISE)
    freedom = np.asarray(noise.share, np.float64)
    # A stray, which the denoising left where it was, is free to go where its neighbours are. The anchor's base passes
    # through the denoised point.
    moved = np.abs(height - anchors.terms[:, 0])
    told = (freedom > 0) & (moved > _STAYED) & (np.abs(height) < 2 * FAR * sigma)
    return Scan(height, sigma, freedom, np.asarray(told))


def judges(xyz: Floats) -> Ints:
    """Which of the points (N,3) the short fits take: all, or whole balls of them."""
    if len(xyz) <= JUDGES:
        return np.arange(len(xyz))
    centres = np.random.default_rng(_SEED).permutation(len(xyz))[: JUDGES // BALL]
    _, members = cKDTree(xyz).query(xyz[centres], k=BALL)
    return np.unique(members)


def held_out(count: int) -> Bools:
    """(count,) which points the short fits do not see."""
    return np.random.default_rng(_SEED).random(count) < HELD_OUT


def errors(offset: Floats, scan: Scan) -> Floats:
    """Of predicted offsets (N,): squared distance to where the points were scanned, in σ, bounded."""
    return np.square(np.minimum(np.abs(offset - scan.height) / scan.sigma, FAR))


def chosen(errors_of: Sequence[Floats]) -> float | None:
    """μ, from the errors (H,) of each candidate at the held-out points; the least one where there are none.

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
