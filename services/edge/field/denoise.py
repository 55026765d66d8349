"""Noise off, folds kept: every point moves along the normal onto a robust local quadric.

σ_i        the noise at the point (`noise.py`); 0 share of noise means: leave the point where it is
k          neighbours of one fit, growing from 16 to 160
o_j        a neighbour's offset across the surface;  r_j its residual to the quadric
w_j        (1 − d_j²/R²) · exp(−½(r_j / 2.5σ)²): what lies farther off than the noise explains is another layer
a_k, s_k   the quadric's height at the point, and its standard error σ·√(Σ l_j²), l_j the fit's weights

The largest neighbourhood wins of those that all agree (A. Goldenshluger, A. Nemirovski, "On spatially adaptive
estimation of nonparametric regression", 1997): the intervals a_k ± 2 s_k must meet, and the residuals must not exceed
the noise. So a flat place is averaged over 160 points and a pleat over as many as fit on it: no setting is per cloud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.field.noise import SCALES as NOISE_SCALES
from services.edge.field.noise import Noise, noise_level
from services.edge.field.planes import in_threads, slices
from services.edge.field.quadrics import TINY, fit_quadric, monomials, tangents, weighted_pca

NEIGHBOURS = (16, 28, 50, 90, 160)  # each ×1.8: steps of ×1.5 gain nothing and cost a third more; nor does 240
REACH = 2.5  # in σ: 99 % of the noise keeps half its weight; a layer 5 σ away keeps an eighth
AGREE = 2.0  # in standard errors
EXCESS = 1.15  # residual over noise that still counts as noise: 160 residuals spread by 6 %, 16 by 18 %
FARTHEST = 4.0  # in σ: what lies farther from its surface than this is a stray, and is not drawn in
WIDER = 1.05  # of the farthest neighbour's distance: it keeps a tenth of the weight
# The weights cut the tails: Gaussian noise σ shows a weighted deviation of σ·c/√(1+c²), c = REACH.
_SEEN = REACH / np.sqrt(1 + REACH * REACH)
CHUNK = 1_024  # points at once: 161 neighbours × 6 terms × 8 B are 8 MB


@dataclass(frozen=True, slots=True)
class Start:
    """The planes a fit starts from: normal (N,3), height of the plane over the point along it (N,)."""

    normal: Floats
    height: Floats


@dataclass(frozen=True, slots=True)
class Fit:
    """Quadrics at points: normal (N,3), height along it (N,), standard error (N,), residual over the noise's (N,)."""

    normal: Floats
    height: Floats
    error: Floats
    excess: Floats


def denoise(xyz_unit: Floats, tick: Tick = no_tick) -> Floats:
    """(N,3) in the unit frame -> (N,3) float64 in the same order, noise taken off where there is any.

    Clean clouds come back unchanged. `tick` is called between chunks, on the caller's thread. Raises what it raises.
    """
    xyz = np.array(xyz_unit, np.float64)
    if len(xyz) <= 2 * NOISE_SCALES[0]:  # too few to tell noise from shape
        return xyz
    tree = cKDTree(xyz)
    noise = noise_level(xyz, tree)
    noisy = np.flatnonzero(noise.share > 0)
    smooth = xyz.copy()

    def work(part: slice) -> None:
        index = noisy[part]
        smooth[index] += _moves(index, xyz, tree, noise)

    in_threads(work, slices(len(noisy), CHUNK), tick)
    return smooth


def _moves(index: Ints, xyz: Floats, tree: cKDTree, noise: Noise) -> Floats:
    """The way each of the points goes (M,3)."""
    sigma = noise.sigma[index]
    move = np.zeros((len(index), 3))
    low, high = np.full(len(index), -np.inf), np.full(len(index), np.inf)
    alive, start = np.arange(len(index)), None
    for k in (k for k in NEIGHBOURS if k < len(xyz)):
        fit = _fit(xyz[index[alive]], k, xyz, tree, sigma[alive], start)
        bottom = np.maximum(low[alive], fit.height - AGREE * fit.error)
        top = np.minimum(high[alive], fit.height + AGREE * fit.error)
        # The least neighbourhood is taken as it is: there is nothing smaller to fall back on.
        agrees = ((bottom <= top) & (fit.excess < EXCESS)) | (k == NEIGHBOURS[0])
        alive, bottom, top = alive[agrees], bottom[agrees], top[agrees]
        start = Start(fit.normal[agrees], fit.height[agrees])
        move[alive] = start.height[:, None] * start.normal
        low[alive], high[alive] = bottom, top
        if len(alive) == 0:
            break
    stray = np.linalg.norm(move, axis=1) > FARTHEST * sigma
    return np.where(stray, 0, noise.share[index])[:, None] * move


def _fit(points: Floats, k: int, xyz: Floats, tree: cKDTree, sigma: Floats, start: Start | None) -> Fit:
    """A robust quadric through the k nearest neighbours of each point, from the plane of the fit before."""
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
    return Fit(
        normal,
        height=coefficients[:, 0],
        error=sigma * np.linalg.norm(influence, axis=1),
        excess=np.sqrt(variance) / (_SEEN * sigma),
    )


def _plane(relative: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Weighted planes: normals (N,3) and the height of each over its point (N,)."""
    normal, _, mean = weighted_pca(relative, weights)
    return normal, np.einsum("nx,nx->n", mean, normal)


def _same_layer(residual: Floats, sigma: Floats) -> Floats:
    weights: Floats = np.exp(-0.5 * np.square(residual / (REACH * sigma[:, None] + TINY)))
    return weights
