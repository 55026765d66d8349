"""Denoise points without smoothing folds away: every point moves along its normal onto a robust local quadric.

σ_i        the noise at the point (`noise.py`, `folds.py`); where the share of noise is 0 the point stays
k          neighbours of one fit, growing from 16 to 288
o_j        a neighbour's offset across the surface;  r_j its residual to the quadric
w_j        (1 − d_j²/R²) · exp(−½(r_j / 2.5σ)²): what lies farther off than the noise explains is another layer
a_k, s_k   the quadric's height at the point, and its standard error σ·√(Σ l_j²), l_j the fit's weights

Of the neighbourhoods that agree the largest is taken (A. Goldenshluger, A. Nemirovski, "On spatially adaptive
estimation of nonparametric regression", 1997): the intervals a_k ± 2 s_k must meet, and the residuals must not exceed
the noise. So a flat place is averaged over 288 points and a pleat over as many as fit on it; no setting depends on
the cloud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.field.quadrics import TINY, fit_quadric, monomials, tangents, weighted_pca
from capture2vr.edge.parallel import in_threads, slices

NEIGHBOURS = (16, 28, 50, 90, 160, 288)  # each ×1.8: steps of ×1.5 gain nothing; 518 gains 1 % and doubles the time
REACH = 2.5  # in σ: 99 % of the noise keeps half its weight; a layer 5 σ away keeps an eighth
AGREE = 2.0  # in standard errors
# Residuals over noise that still count as noise: 1 plus this many of the spreads 1/√(2k) that k residuals have. A bound
# that does not fall with k lets wide quadrics cut off bumps (8 % more error), or keeps them from flat places.
EXCESS = 1.5
FARTHEST = 4.0  # in σ: a point farther from its surface than this is an outlier and stays where it is
WIDER = 1.05  # radius over the farthest neighbour's distance: that neighbour then has a tenth of the weight
# The weights cut the tails: Gaussian noise σ shows a weighted deviation of σ·c/√(1+c²), c = REACH.
_SHOWN_SIGMA = REACH / np.sqrt(1 + REACH * REACH)
ANCHORS = 40_000  # points with a quadric of their own: 3 s; in larger clouds the others use that of a neighbour
FIT_SHARE = 0.95  # of the run time, for the progress
_SEED = 0
CHUNK = 1_024  # points at once: 289 neighbours × 6 terms × 8 B are 14 MB


@dataclass(frozen=True, slots=True)
class StartPlanes:
    """Planes from which the next fits start: normal (N,3), height of the plane over the point along it (N,)."""

    normal: Floats
    height: Floats


@dataclass(frozen=True, slots=True)
class QuadricFit:
    """Quadrics fitted around points, each in its point's frame.

    normal (N,3); coefficients (N,6), lengths across in units of radius (N,); error (N,): the standard error at the
    point; excess (N,): the residuals over those that the noise explains.
    """

    normal: Floats
    coefficients: Floats
    radius: Floats
    error: Floats
    excess: Floats


@dataclass(frozen=True, slots=True)
class Sheets:
    """The quadric chosen at each anchor: as in `QuadricFit`, with the anchors' places (M,3) and noise (M,)."""

    anchor: Floats
    normal: Floats
    coefficients: Floats
    radius: Floats
    sigma: Floats


def denoise(xyz_unit: Floats, noise: Noise, tick: Tick = no_tick, *, anchors: Ints | None = None) -> Floats:
    """Remove the noise of points (N,3) in the unit frame -> (N,3) float64 in the same order.

    anchors: indices of the noisy points with a quadric of their own; None: some of them, at random.
    Clean clouds come back unchanged. `tick` is called between chunks, on the caller's thread; its errors pass through.
    """
    xyz = np.array(xyz_unit, np.float64)
    noisy = np.flatnonzero(noise.share > 0)
    if len(noisy) == 0:
        return xyz
    if anchors is None:
        anchors = np.sort(np.random.default_rng(_SEED).permutation(noisy)[:ANCHORS])
    sheets = _fit_sheets(anchors, xyz, cKDTree(xyz), noise, lambda part: tick(part * FIT_SHARE))
    near = cKDTree(sheets.anchor)
    smooth = xyz.copy()

    def work(part: slice) -> None:
        index = noisy[part]
        _, candidates = near.query(xyz[index], k=[1] if len(anchors) == len(noisy) else [1, 2, 3])
        smooth[index] += noise.share[index, None] * _moves_onto_sheets(xyz[index], candidates, sheets)

    in_threads(work, slices(len(noisy), CHUNK * 16), lambda part: tick(FIT_SHARE + part * (1 - FIT_SHARE)))
    return smooth


def _moves_onto_sheets(points: Floats, candidates: Ints, sheets: Sheets) -> Floats:
    """Displacement (P,3) of each point onto the nearest of its candidate sheets (P,C); 0 for an outlier."""
    relative = points[:, None] - sheets.anchor[candidates]
    flat = candidates.ravel()
    normal, radius = sheets.normal[flat], sheets.radius[flat]
    terms = monomials(relative.reshape(-1, 1, 3) / radius[:, None, None], *tangents(normal))[:, 0]
    sheet = np.einsum("na,na->n", terms, sheets.coefficients[flat])
    height = np.einsum("nx,nx->n", relative.reshape(-1, 3), normal) - sheet
    height = np.where(np.abs(height) > FARTHEST * sheets.sigma[flat], 0, height).reshape(candidates.shape)
    nearest = np.arange(len(points)), np.abs(height).argmin(axis=1)
    move: Floats = -height[nearest][:, None] * sheets.normal[candidates[nearest]]
    return move


def _fit_sheets(index: Ints, xyz: Floats, tree: cKDTree, noise: Noise, tick: Tick) -> Sheets:
    """Fit at each anchor the quadric of the largest neighbourhood that agrees with all smaller ones."""
    count = len(index)
    chosen = Sheets(xyz[index], np.empty((count, 3)), np.empty((count, 6)), np.empty(count), noise.sigma[index])

    def work(part: slice) -> None:
        alive = np.arange(part.start, part.stop)
        low, high = np.full(count, -np.inf), np.full(count, np.inf)
        start = None
        for k in (k for k in NEIGHBOURS if k < len(xyz)):
            fit = _fit(chosen.anchor[alive], k, xyz, tree, chosen.sigma[alive], start)
            height = fit.coefficients[:, 0]
            bottom = np.maximum(low[alive], height - AGREE * fit.error)
            top = np.minimum(high[alive], height + AGREE * fit.error)
            # The smallest neighbourhood is always accepted: there is none to fall back on.
            agrees = ((bottom <= top) & (fit.excess < 1 + EXCESS / np.sqrt(2 * k))) | (k == NEIGHBOURS[0])
            alive = alive[agrees]
            low[alive], high[alive] = bottom[agrees], top[agrees]
            chosen.normal[alive], chosen.coefficients[alive] = fit.normal[agrees], fit.coefficients[agrees]
            chosen.radius[alive] = fit.radius[agrees]
            start = StartPlanes(fit.normal[agrees], height[agrees])
            if len(alive) == 0:
                break

    in_threads(work, slices(count, CHUNK), tick)
    return chosen


def _fit(points: Floats, k: int, xyz: Floats, tree: cKDTree, sigma: Floats, start: StartPlanes | None) -> QuadricFit:
    """Fit a robust quadric through the k nearest neighbours of each point, starting from the previous fit's plane."""
    distance, index = tree.query(points, k=k + 1)
    relative = xyz[index] - points[:, None]
    radius = distance[:, -1:] * WIDER + TINY
    near = 1 - np.square(distance / radius)
    normal, height = (start.normal, start.height) if start else _plane(relative, near)
    offset = np.einsum("nkx,nx->nk", relative, normal)
    before = normal
    normal, height = _plane(relative, near * _same_layer(offset - height[:, None], sigma))
    # An eigenvector has either sign, and heights are only comparable along one.
    sign = np.where(np.einsum("nx,nx->n", normal, before) < 0, -1.0, 1.0)
    normal, height = normal * sign[:, None], height * sign
    offset = np.einsum("nkx,nx->nk", relative, normal)
    weights = near * _same_layer(offset - height[:, None], sigma)
    terms = monomials(relative / radius[..., None], *tangents(normal))
    coefficients, inverse = fit_quadric(terms, offset, weights)
    residual = offset - np.einsum("nka,na->nk", terms, coefficients)
    influence = weights * np.einsum("nka,na->nk", terms, inverse[:, 0])
    weights = near * _same_layer(residual, sigma)
    variance = (weights * np.square(residual)).sum(axis=1) / (weights.sum(axis=1) + TINY)
    return QuadricFit(
        normal,
        coefficients,
        radius[:, 0],
        error=sigma * np.linalg.norm(influence, axis=1),
        excess=np.sqrt(variance) / (_SHOWN_SIGMA * sigma),
    )


def _plane(relative: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Fit weighted planes -> normals (N,3), and the height of each over its point (N,)."""
    normal, mean = weighted_pca(relative, weights)
    return normal, np.einsum("nx,nx->n", mean, normal)


def _same_layer(residual: Floats, sigma: Floats) -> Floats:
    """Weights (N,K) exp(−½(r/2.5σ)²), which exclude neighbours of another layer."""
    weights: Floats = np.exp(-0.5 * np.square(residual / (REACH * sigma[:, None] + TINY)))
    return weights
