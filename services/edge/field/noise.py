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
BLOB = 0.2  # noise / radius above which a neighbourhood is a ball, not a sheet: its thickness says nothing yet
LOW, NEXT = 0.05, 0.20  # quantiles of a region's residuals
CROWDED = (0.45, 0.65)  # q₀₅/q₂₀ of the residuals at SCALES[0]: geometry below, noise above, in between by degrees
MATTERS = (0.03, 0.08)  # noise in spacings: the blend of eight planes hides less than this by itself
GROWS = (2.2, 3.0)  # the level from 24 neighbours over that from 12: noise alone 1.1, noisy folds 1.8, sparse folds 4
PROBES = 40_000  # residuals in all: 1 s; more would only sharpen a quantile
REGION = 1_000  # probes a region: its 5 % quantile then rests on 50 of them, ±8 %
PROBES_PER_REGION = 250  # regions overlap fourfold, so the level changes gently from one to the next
BLEND = 4  # regions a point's level is interpolated from
_SEED = 0


@dataclass(frozen=True, slots=True)
class Noise:
    """sigma (N,): standard deviation across the surface, unit frame; share (N,) in [0,1]: how surely it is noise."""

    sigma: Floats
    share: Floats


def noise_level(xyz: Floats, tree: cKDTree) -> Noise:
    """The noise at every point of xyz (N,3), N > 12. `tree` is the KD-tree of `xyz`. Deterministic."""
    rng = np.random.default_rng(_SEED)
    probes = rng.permutation(len(xyz))[:PROBES]
    centres = xyz[probes[: max(1, len(probes) // PROBES_PER_REGION)]]
    _, members = cKDTree(xyz[probes]).query(centres, k=min(REGION, len(probes)))
    members = members.reshape(len(centres), -1)
    sigma, share = _levels(xyz, tree, probes, members)
    away, region = cKDTree(centres).query(xyz, k=min(BLEND, len(centres)))
    weights = 1 / (np.square(away.reshape(len(xyz), -1)) + TINY)
    weights /= weights.sum(axis=1, keepdims=True)
    region = region.reshape(weights.shape)
    return Noise((weights * sigma[region]).sum(axis=1), (weights * share[region]).sum(axis=1))


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
        if neighbours == SCALES[1]:
            share *= 1 - _ramp(found / (first + TINY), GROWS)
        sigma[open_] = found[open_]
        if neighbours == SCALES[0]:
            first = found
            share = _ramp(low / (following + TINY), CROWDED)
            share *= _ramp(sigma / np.median(spacing[members], axis=1), MATTERS)
        open_ &= (sigma > BLOB * np.median(radius[members], axis=1)) & (share > 0)
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


def _ramp(value: Floats, between: tuple[float, float]) -> Floats:
    """0 below the first bound, 1 above the second, smooth in between."""
    t = np.clip((value - between[0]) / (between[1] - between[0]), 0, 1)
    smooth: Floats = t * t * (3 - 2 * t)
    return smooth
