"""A smooth curved patch of surface at every point: Gaussian-process regression over the tangent plane.

x_i, n_i, h_i   a point, its normal, the local spacing
a, b, z         a place seen from x_i: along the plane and across it, in spacings
s, t = a/ℓ, b/ℓ;  ρ² = s² + t²

The height z(a,b) of a patch has the prior covariance exp(−½ |p−p'|²/ℓ²) (C. E. Rasmussen, C. K. I. Williams, "Gaussian
Processes for Machine Learning", 2006). Expanded in the features whose sum this kernel is, up to degree 4,

    z = Σ β_mn φ_mn,   φ_mn = exp(−½ρ²)·sᵐtⁿ/√(m!n!),   β_mn ~ N(0,1) independent,   m+n ≤ 4: 15 coefficients

The variance that is cut off, 1 − exp(−ρ²)·Σ_{k≤4} ρ²ᵏ/k!, is added to a neighbour's noise: nothing at one spacing, a
seventh of the prior's variance at the farthest. A neighbour j is weighted by how well it lies on the patch, in place
and in direction:

    w_j = exp(−½(r_j/c)²)·|n_j·n(a_j,b_j)|⁴     r_j its distance to the patch, n(a,b) the patch's normal beneath it

So points of another layer are left out even where the surface bends, and pleats of three points a side are followed;
weights by the distance to a plane would leave out the bend itself.

**Vote.** A point whose plane is wrong has a poor patch, but the patches of its neighbours pass through it. Its new
normal is that of the largest group of patches that agree there, each weighted by how many of its own neighbours it
explains. Mean |cos| of the points' normals, planes → two votes: dress .959 → .981, folded T-shirt .924 → .941, car
.907 → .925, pleated skirt of 1,000 points .987 → .999.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial, sqrt

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.field.planes import Planes
from capture2vr.edge.field.quadrics import TINY, tangents
from capture2vr.edge.parallel import in_threads, slices

NEIGHBOURS = 24  # 2.8 spacings around; 20 to 32 differ by 2 %
LENGTH = np.float32(2.0)  # ℓ in spacings: 1.5 and 3 lose 10 % and 50 % on sparse pleats
DEGREE = 4  # 3 loses a tenth on sparse pleats, 5 gains 3 % for half as much time again
# In spacings. Less follows sparse folds better, more evens out what denoising leaves, which is too smooth to be seen in
# 24 neighbours. Chamfer-L1 at 0.012 / 0.02 / 0.03: sheet of ten pleats from 1,000 points .00446 / .00488 / .00550,
# skirt from 1,000 .00274 / .00277 / .00283, dress with noise .00377 / .00376 / .00373; clean cloth, car within 0.6 %.
NOISE = 0.025
FLOOR = 1e-5  # of a neighbour's weight: keeps its noise finite
ALIGNED = 4  # power of |cos|; 2 to 8 differ by less than a seed


@dataclass(frozen=True, slots=True)
class PatchRound:
    """One round of fitting: c in spacings, and how often weights and patches are solved in turn."""

    reach: float
    solves: int


# Votes between the rounds. Wide at first, while the normals are rough; a single vote loses .002 of the normals, a third
# gains nothing. The last round's patches are the field's, so they are weighed once more.
ROUNDS = (PatchRound(0.10, 1), PatchRound(0.07, 1), PatchRound(0.07, 2))

VOTERS = 12  # nearest points, itself among them; 20 gain nothing
VOTE_OFF = 0.2  # in spacings: a patch this far from the point hardly passes through it
VOTE_NEAR = 2.0  # in spacings: how fast the vote of a patch falls with its distance
VOTE_ALIGNED = 8  # power of |cos|: patches more than 35° apart are of different groups
CHUNK = 1_024  # points at once: 24 neighbours × 15 features × 4 B are 1.5 MB

TERMS = tuple((m, degree - m) for degree in range(DEGREE + 1) for m in range(degree, -1, -1))  # (m,n) of each φ
_SCALE = np.array([1 / sqrt(factorial(m) * factorial(n)) for m, n in TERMS], np.float32)
_HALF = np.float32(0.5)


@dataclass(frozen=True, slots=True)
class Patches:
    """All float32. xyz (N,3), normals (N,3), u and v (N,3): place and axes; spacing (N,), unit frame.

    terms (N,15)   β/√(m!n!), heights in spacings
    support (N,)   the share of its neighbours that the patch explains, in [0,1]
    """

    xyz: Floats
    normals: Floats
    u: Floats
    v: Floats
    spacing: Floats
    terms: Floats
    support: Floats


@dataclass(frozen=True, slots=True)
class _Neighbours:
    """Neighbours (N,K) seen from their points: s, t, z, and their normals along u, v and n."""

    s: Floats
    t: Floats
    z: Floats
    normal_u: Floats
    normal_v: Floats
    normal_n: Floats


def fit_patches(planes: Planes, tree: cKDTree, *, trusted: bool = False, tick: Tick = no_tick) -> Patches:
    """Fit the patches of all points. `tree` is the KD-tree of their xyz; trusted: keep the normals, without votes."""
    xyz, normals, spacing = planes.xyz, planes.normals, planes.spacing
    index = np.empty((len(xyz), min(NEIGHBOURS, len(xyz))), np.int32)

    def look(part: slice) -> None:
        index[part] = tree.query(xyz[part], k=index.shape[1])[1]

    in_threads(look, slices(len(xyz), CHUNK))

    def at(done: float) -> Tick:
        return lambda _: tick(done / len(ROUNDS))

    for number, stage in enumerate(() if trusted else ROUNDS[:-1]):
        rough = _fit_round(Planes(xyz, normals, spacing), index, stage, at(number))
        normals = _vote_normals(rough, index[:, :VOTERS], at(number + 0.5))
    return _fit_round(Planes(xyz, normals, spacing), index, ROUNDS[-1], at(len(ROUNDS) - 1))


def predict(patches: Patches, index: Ints, q: Floats) -> tuple[Floats, Floats]:
    """Evaluate the patches index (M,K) at q (M,3): signed distances (M,K), to first order, and unit normals (M,K,3).

    Both have the sign of their patch's normal, which is arbitrary. Far from its point a patch is its plane.
    """
    # `take` gathers rows two to three times as fast as an index in brackets.
    spacing = patches.spacing.take(index)
    u, v, n = (rows.take(index, axis=0) for rows in (patches.u, patches.v, patches.normals))
    relative = (q[:, None] - patches.xyz.take(index, axis=0)) / spacing[..., None]
    s = np.einsum("mkx,mkx->mk", relative, u) / LENGTH
    t = np.einsum("mkx,mkx->mk", relative, v) / LENGTH
    height, slope_u, slope_v, steep = patch_surface(patches.terms.take(index, axis=0), s, t)
    normal = (n - slope_u[..., None] * u - slope_v[..., None] * v) * steep[..., None]
    return (np.einsum("mkx,mkx->mk", relative, n) - height) * steep * spacing, normal


def _fit_round(planes: Planes, index: Ints, stage: PatchRound, tick: Tick) -> Patches:
    """Fit patches over the planes to the neighbours index (N,K)."""
    count = len(planes.xyz)
    u, v = (np.empty((count, 3), np.float32) for _ in range(2))
    terms, support = np.empty((count, len(TERMS)), np.float32), np.empty(count, np.float32)

    def fit(part: slice) -> None:
        u[part], v[part] = tangents(planes.normals[part])
        axes = np.stack([u[part], v[part], planes.normals[part]], axis=2)
        near = index[part]
        relative = np.matmul(planes.xyz.take(near, axis=0) - planes.xyz[part, None], axes)
        relative /= planes.spacing[part, None, None]
        relative[..., :2] /= LENGTH
        normals = np.matmul(planes.normals.take(near, axis=0), axes)
        around = _Neighbours(
            *(np.ascontiguousarray(each[..., axis]) for each in (relative, normals) for axis in range(3))
        )
        terms[part], weights = _regress(around, stage)
        close = np.exp(-np.square(around.s) - np.square(around.t))
        support[part] = (weights * close).sum(axis=1) / close.sum(axis=1)

    in_threads(fit, slices(count, CHUNK), tick)
    return Patches(planes.xyz, planes.normals, u, v, planes.spacing, terms, support)


def _regress(around: _Neighbours, stage: PatchRound) -> tuple[Floats, Floats]:
    """Solve the regression of each patch -> terms (N,15), and the weights (N,K) of the neighbours on their patch."""
    squared = np.square(around.s) + np.square(around.t)
    features = _features(around.s, around.t) * np.exp(-squared * _HALF)[..., None]
    cut_off = _cut_off_variance(squared)
    weights = _initial_weights(around, stage.reach)
    for _ in range(stage.solves):
        precision = 1 / (np.float32(NOISE * NOISE) / (weights + np.float32(FLOOR)) + cut_off)
        weighted = features * precision[..., None]
        gram = np.matmul(weighted.transpose(0, 2, 1), features) + np.eye(len(TERMS), dtype=np.float32)
        right = np.matmul(around.z[:, None], weighted)
        terms = np.linalg.solve(gram, right.transpose(0, 2, 1))[..., 0] * _SCALE
        height, slope_u, slope_v, steep = patch_surface(terms[:, None], around.s, around.t)
        cos = np.abs(around.normal_n - slope_u * around.normal_u - slope_v * around.normal_v) * steep
        weights = np.exp(-np.square((around.z - height) * steep / stage.reach) * _HALF) * cos**ALIGNED
    return terms, weights


def _initial_weights(around: _Neighbours, reach: float) -> Floats:
    """Initial weights, before there is a patch: by the distance of two points from an arc across both normals.

    The mean of the two normals is perpendicular to the chord of any arc, so a bend does not lower the weight.
    """
    along = (around.s * around.normal_u + around.t * around.normal_v) * LENGTH + around.z * around.normal_n
    off = _HALF * (around.z + np.where(around.normal_n < 0, -along, along))
    weights: Floats = np.exp(-np.square(off / (2 * reach)) * _HALF) * np.square(around.normal_n)
    return weights


def _features(s: Floats, t: Floats) -> Floats:
    """Features φ without their factor exp(−½ρ²), at places (N,K) -> (N,K,15)."""
    s_to, t_to = [np.ones_like(s)], [np.ones_like(t)]
    for _ in range(DEGREE):
        s_to.append(s_to[-1] * s)
        t_to.append(t_to[-1] * t)
    features = np.empty((*s.shape, len(TERMS)), np.float32)
    for column, (m, n) in enumerate(TERMS):
        np.multiply(s_to[m] * t_to[n], _SCALE[column], out=features[..., column])
    return features


def _cut_off_variance(squared: Floats) -> Floats:
    """The prior's variance that the 15 features lack at ρ² = `squared`."""
    term = total = np.ones_like(squared)
    for k in range(1, DEGREE + 1):
        term = term * squared / np.float32(k)
        total = total + term
    return np.maximum(1 - np.exp(-squared) * total, np.float32(0))


def patch_surface(terms: Floats, s: Floats, t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Evaluate terms (...,15) at s, t (...) -> height in spacings, its slopes along u and v, and 1/√(1 + slope²).

    Horner's scheme in t, whose coefficients are Horner schemes in s; both carry their derivatives along.
    """
    at = dict(zip(TERMS, np.moveaxis(terms, -1, 0), strict=True))
    value = by_s = by_t = np.zeros_like(s)
    for n in range(DEGREE, -1, -1):
        row, row_by_s = at[DEGREE - n, n], np.zeros_like(s)
        for m in range(DEGREE - n - 1, -1, -1):
            row_by_s = row_by_s * s + row
            row = row * s + at[m, n]
        by_t = by_t * t + value
        by_s = by_s * t + row_by_s
        value = value * t + row
    bell = np.exp(-(np.square(s) + np.square(t)) * _HALF)
    height = value * bell
    slope_u, slope_v = (by_s * bell - s * height) / LENGTH, (by_t * bell - t * height) / LENGTH
    return height, slope_u, slope_v, 1 / np.sqrt(1 + np.square(slope_u) + np.square(slope_v))


def _vote_normals(patches: Patches, index: Ints, tick: Tick) -> Floats:
    """New normals (N,3) by a vote of the patches index (N,V) around each point."""
    normals = np.empty_like(patches.normals)

    def vote(part: slice) -> None:
        q, near, spacing = patches.xyz[part], index[part], patches.spacing[part, None]
        distance, normal = predict(patches, near, q)
        away = np.linalg.norm(patches.xyz[near] - q[:, None], axis=2)
        votes = np.exp(-np.square(distance / (VOTE_OFF * spacing)) - np.square(away / (VOTE_NEAR * spacing)))
        votes = votes * np.square(patches.support[near]) + np.float32(TINY)
        cos = np.matmul(normal, normal.transpose(0, 2, 1))
        agree = np.abs(cos) ** VOTE_ALIGNED
        best = np.arange(len(q)), (votes * np.matmul(agree, votes[..., None])[..., 0]).argmax(axis=1)
        summed = np.einsum(
            "nk,nkx->nx", votes * agree[best] * np.where(cos[best] < 0, np.float32(-1), np.float32(1)), normal
        )
        normals[part] = summed / (np.linalg.norm(summed, axis=1, keepdims=True) + TINY)

    in_threads(vote, slices(len(normals), CHUNK), tick)
    return normals
