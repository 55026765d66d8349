"""How noisy a cloud is, region by region, without mistaking folds, layers or sparse sampling for noise.

A quadric is fitted to the 12 nearest neighbours of every probe; its residual r_i is noise plus whatever geometry a
quadric cannot follow. Geometry varies from place to place and almost always leaves some neighbourhoods flat, so the
*lowest* 5 % of a region's residuals tell its noise. Noise is a floor that no neighbourhood gets under, so its residuals
crowd just above it:

    √(q₀₅/q₂₀) of χ² with 7 degrees of freedom = 0.75         measured on noisy clouds 0.63–0.80
    folded, layered, pleated or sparse clouds without noise    measured 0.00–0.55

The crowding says whether it is noise, the lowest 5 % says how much. Folds too sparsely sampled to leave anything flat
crowd as well, but their level grows with the neighbourhood, which that of noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from services.edge.arrays import Floats, Ints
from services.edge.field.planes import CHUNK, SPACING_RANK, rank_spacing
from services.edge.field.quadrics import QUADRIC, TINY, monomials, tangents, weighted_pca
from services.edge.threads import in_threads, slices

SCALES = (12, 24, 48, 96)  # neighbours; the least that leave a quadric's 6 coefficients some freedom, then doubled
# Noise / radius above which a neighbourhood is a ball, not a sheet: its thickness says nothing yet. A ball filled by
# noise shows 0.36, a sheet with σ of half a spacing 0.29 and the right σ; from 0.2 on, folds were taken for noise.
BLOB = 0.30
# A ball cuts off what the noise carries out of it: true over found σ, by found σ / radius, of sheets simulated with
# 12 to 96 neighbours, which differ by 4 %.
CUT_OFF = (0.15, 0.20, 0.23, 0.25, 0.27, 0.285, 0.30), (1.0, 1.03, 1.07, 1.11, 1.15, 1.19, 1.23)
LOW, NEXT = 0.05, 0.20  # quantiles of a region's residuals
CROWDED = (0.45, 0.65)  # q₀₅/q₂₀ of the residuals at SCALES[0]: geometry below, noise above, in between by degrees
MATTERS = (0.03, 0.08)  # noise in spacings: the blend of eight planes hides less than this by itself
GROWS = (2.2, 3.0)  # the level from 24 neighbours over that from 12: noise alone 1.1, noisy folds 1.8, sparse folds 4
PROBES = 40_000  # residuals in all: 1 s; more would only sharpen a quantile
REGION = 1_000  # probes a region: its 5 % quantile then rests on 50 of them, ±8 %
OVERLAP = 4  # regions that a point is in: the level changes gently from one to the next
BLEND = 4  # regions a point's level is interpolated from
_SEED = 0


@dataclass(frozen=True, slots=True)
class Noise:
    """sigma (N,): standard deviation across the surface, unit frame; share (N,) in [0,1]: how surely it is noise."""

    sigma: Floats
    share: Floats


def noise_level(xyz: Floats, tree: cKDTree) -> Noise:
    """The noise at every point of xyz (N,3), N > 12. `tree` is the KD-tree of `xyz`. Deterministic."""
    probes = np.random.default_rng(_SEED).permutation(len(xyz))[:PROBES]
    centres, members = regions(xyz[probes], REGION)
    sigma, share = _levels(xyz, tree, probes, members)
    return Noise(between(centres, sigma, xyz), between(centres, share, xyz))


def regions(xyz: Floats, size: int) -> tuple[Floats, Ints]:
    """Overlapping regions of points (N,3) in random order: centres (R,3) and the members of each (R,size)."""
    centres = xyz[: max(1, len(xyz) * OVERLAP // size)]
    _, members = cKDTree(xyz).query(centres, k=min(size, len(xyz)))
    return centres, members.reshape(len(centres), -1)


def between(centres: Floats, values: Floats, xyz: Floats) -> Floats:
    """What regions with values (R,) at their centres (R,3) say at xyz (N,3): the nearest few, by inverse square."""
    away, region = cKDTree(centres).query(xyz, k=min(BLEND, len(centres)))
    weights = 1 / (np.square(away.reshape(len(xyz), -1)) + TINY)
    weights /= weights.sum(axis=1, keepdims=True)
    blended: Floats = (weights * values[region.reshape(weights.shape)]).sum(axis=1)
    return blended


def _levels(xyz: Floats, tree: cKDTree, probes: Ints, members: Ints) -> tuple[Floats, Floats]:
    """Regions' member probes (R,M) -> sigma and share (R,), from the least scale that sees a sheet, not a ball."""
    sigma: Floats = np.zeros(len(members))
    share: Floats = np.zeros(len(members))
    first = sigma
    open_ = np.ones(len(members), bool)
    for neighbours in (scale for scale in SCALES if scale < len(xyz)):
        residual, radius, spacing = _residuals(xyz, tree, probes, neighbours)
        low, following = np.quantile(residual[members], (LOW, NEXT), axis=1)
        freedom = neighbours + 1 - QUADRIC
        found = low / np.sqrt(chdtri(freedom, 1 - LOW) / freedom)
        thick = found / np.median(radius[members], axis=1)
        if neighbours == SCALES[1]:
            share *= 1 - ramp(found / (first + TINY), GROWS)
        sigma[open_] = (found * np.interp(thick, *CUT_OFF))[open_]
        if neighbours == SCALES[0]:
            first = found
            share = ramp(low / (following + TINY), CROWDED)
            share *= ramp(sigma / np.median(spacing[members], axis=1), MATTERS)
        open_ &= (thick > BLOB) & (share > 0)
        if not open_.any() and (neighbours > SCALES[0] or not share.any()):
            break
    return sigma, share


def _residuals(xyz: Floats, tree: cKDTree, probes: Ints, neighbours: int) -> tuple[Floats, Floats, Floats]:
    """Of a quadric through each probe's neighbourhood: standard deviation, the radius, the local spacing (P,)."""
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
    """relative (N,K,3) -> unbiased standard deviation across the least-squares quadric (N,)."""
    normal, mean = weighted_pca(relative, np.ones(relative.shape[:2]))
    terms = monomials(relative / radius[:, None, None], *tangents(normal))
    height = np.einsum("nkx,nx->nk", relative - mean[:, None], normal)
    gram = np.matmul(terms.transpose(0, 2, 1), terms) + TINY * np.eye(QUADRIC)
    coefficients = np.linalg.solve(gram, np.einsum("nka,nk->na", terms, height)[..., None])[..., 0]
    residual = height - np.einsum("nka,na->nk", terms, coefficients)
    deviation: Floats = np.sqrt(np.square(residual).sum(axis=1) / (relative.shape[1] - QUADRIC))
    return deviation


def ramp(value: Floats, bounds: tuple[float, float]) -> Floats:
    """0 below the first bound, 1 above the second, smooth in between."""
    t = np.clip((value - bounds[0]) / (bounds[1] - bounds[0]), 0, 1)
    smooth: Floats = t * t * (3 - 2 * t)
    return smooth
