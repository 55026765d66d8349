"""Estimate the noise of a point cloud region by region, without mistaking folds, layers or sparse points for noise.

A quadric is fitted to the 12 nearest neighbours of every probe; its residual r_i is noise plus whatever geometry a
quadric cannot follow. Geometry varies from place to place and almost always leaves some neighbourhoods flat, so the
*lowest* 5 % of a region's residuals measure its noise. No neighbourhood has less than the noise, so where there is
noise the residuals crowd just above it:

    √(q₀₅/q₂₀) of χ² with 7 degrees of freedom = 0.75         measured on noisy clouds 0.63–0.80
    folded, layered, pleated or sparse clouds without noise    measured 0.00–0.55

The crowding tells whether it is noise, the lowest 5 % how much. Folds sampled too sparsely to look flat anywhere crowd
as well, but the level of their residuals grows with the size of the neighbourhood, unlike that of noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from capture2vr.edge.arrays import Floats, Ints, smoothstep
from capture2vr.edge.field.planes import CHUNK, SPACING_RANK, rank_spacing
from capture2vr.edge.field.quadrics import QUADRIC, TINY, monomials, tangents, weighted_pca
from capture2vr.edge.parallel import in_threads, slices

SCALES = (12, 24, 48, 96)  # neighbours: the least that leave degrees of freedom beside 6 coefficients, then doubled
# Noise / radius above which a neighbourhood is a ball, not a sheet, and its thickness is not yet the noise. A ball
# filled by noise shows 0.36, a sheet with σ of half a spacing 0.29 and the right σ; with a bound of 0.2 or more, folds
# were taken for noise.
BLOB = 0.30
# A ball of neighbours leaves out the points that noise carries out of it: true over found σ, by found σ / radius, of
# sheets simulated with 12 to 96 neighbours, which differ by 4 %.
CUT_OFF = (0.15, 0.20, 0.23, 0.25, 0.27, 0.285, 0.30), (1.0, 1.03, 1.07, 1.11, 1.15, 1.19, 1.23)
LOW, NEXT = 0.05, 0.20  # quantiles of a region's residuals
CROWDED = (
    0.45,
    0.65,
)  # q₀₅/q₂₀ of the residuals at SCALES[0]: geometry below, noise above, a smooth transition in between
MATTERS = (0.03, 0.08)  # noise in spacings: the blend of eight planes hides less than this by itself
GROWS = (2.2, 3.0)  # the level from 24 neighbours over that from 12: noise alone 1.1, noisy folds 1.8, sparse folds 4
PROBES = 40_000  # most residuals that are computed: 1 s; more would only sharpen a quantile
REGION = 1_000  # probes per region: its 5 % quantile then rests on 50 of them, ±8 %
OVERLAP = 4  # regions that a point is in: the level changes gently from one to the next
BLEND = 4  # regions a point's level is interpolated from
_SEED = 0


@dataclass(frozen=True, slots=True)
class Noise:
    """sigma (N,): standard deviation across the surface, unit frame; share (N,) in [0,1]: how surely it is noise."""

    sigma: Floats
    share: Floats


def noise_level(xyz: Floats, tree: cKDTree) -> Noise:
    """Estimate the noise at every point of xyz (N,3), N > 12. `tree` is the KD-tree of `xyz`. Deterministic."""
    probes = np.random.default_rng(_SEED).permutation(len(xyz))[:PROBES]
    centres, members = regions(xyz[probes], REGION)
    sigma, share = _levels(xyz, tree, probes, members)
    return Noise(interpolate_regions(centres, sigma, xyz), interpolate_regions(centres, share, xyz))


def regions(xyz: Floats, size: int) -> tuple[Floats, Ints]:
    """Make overlapping regions of points (N,3) in random order: centres (R,3) and the members of each (R,size)."""
    centres = xyz[: max(1, len(xyz) * OVERLAP // size)]
    _, members = cKDTree(xyz).query(centres, k=min(size, len(xyz)))
    return centres, members.reshape(len(centres), -1)


def interpolate_regions(centres: Floats, values: Floats, xyz: Floats) -> Floats:
    """Interpolate values (R,) at region centres (R,3) to xyz (N,3): the nearest few, weighted by inverse square."""
    away, region = cKDTree(centres).query(xyz, k=min(BLEND, len(centres)))
    weights = 1 / (np.square(away.reshape(len(xyz), -1)) + TINY)
    weights /= weights.sum(axis=1, keepdims=True)
    blended: Floats = (weights * values[region.reshape(weights.shape)]).sum(axis=1)
    return blended


def _levels(xyz: Floats, tree: cKDTree, probes: Ints, members: Ints) -> tuple[Floats, Floats]:
    """Estimate sigma and share (R,) of regions of probes (R,M), at the least scale that sees a sheet, not a ball."""
    sigma: Floats = np.zeros(len(members))
    share: Floats = np.zeros(len(members))
    first = sigma
    undecided = np.ones(len(members), bool)
    for neighbours in (scale for scale in SCALES if scale < len(xyz)):
        residual, radius, spacing = _residuals(xyz, tree, probes, neighbours)
        low, following = np.quantile(residual[members], (LOW, NEXT), axis=1)
        freedom = neighbours + 1 - QUADRIC
        found = low / np.sqrt(chdtri(freedom, 1 - LOW) / freedom)
        thick = found / np.median(radius[members], axis=1)
        if neighbours == SCALES[1]:
            share *= 1 - smoothstep(found / (first + TINY), GROWS)
        sigma[undecided] = (found * np.interp(thick, *CUT_OFF))[undecided]
        if neighbours == SCALES[0]:
            first = found
            share = smoothstep(low / (following + TINY), CROWDED)
            share *= smoothstep(sigma / np.median(spacing[members], axis=1), MATTERS)
        undecided &= (thick > BLOB) & (share > 0)
        if not undecided.any() and (neighbours > SCALES[0] or not share.any()):
            break
    return sigma, share


def _residuals(xyz: Floats, tree: cKDTree, probes: Ints, neighbours: int) -> tuple[Floats, Floats, Floats]:
    """Fit a quadric to each probe's neighbourhood -> residuals' standard deviation, radius, local spacing (P,)."""
    residual, radius, spacing = (np.empty(len(probes)) for _ in range(3))

    def measure(part: slice) -> None:
        distance, index = tree.query(xyz[probes[part]], k=neighbours + 1)
        relative = xyz[index] - xyz[probes[part], None]
        radius[part] = distance[:, -1] + np.sqrt(TINY)
        spacing[part] = rank_spacing(distance[:, : SPACING_RANK + 1])
        residual[part] = _deviation(relative, radius[part])

    in_threads(measure, slices(len(probes), CHUNK * SCALES[0] // neighbours))
    return residual, radius, spacing


def _deviation(relative: Floats, radius: Floats) -> Floats:
    """Fit least-squares quadrics to neighbours, relative (N,K,3) -> unbiased standard deviation across them (N,)."""
    normal, mean = weighted_pca(relative, np.ones(relative.shape[:2]))
    terms = monomials(relative / radius[:, None, None], *tangents(normal))
    height = np.einsum("nkx,nx->nk", relative - mean[:, None], normal)
    gram = np.matmul(terms.transpose(0, 2, 1), terms) + TINY * np.eye(QUADRIC)
    coefficients = np.linalg.solve(gram, np.einsum("nka,nk->na", terms, height)[..., None])[..., 0]
    residual = height - np.einsum("nka,na->nk", terms, coefficients)
    deviation: Floats = np.sqrt(np.square(residual).sum(axis=1) / (relative.shape[1] - QUADRIC))
    return deviation
