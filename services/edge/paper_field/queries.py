"""Draw the training queries: one pool for the whole fit, in which a query has a number j, and its batches.

P (N,3)   points
p_s, p_w  the strong anchor, of a random subset S of P, and the weak one, the nearest to it of a part of that subset
σ_p       s · (distance from p to its 50th neighbour in S),  s = max(¼, ¼√(|S|/20000))
ε_j       the offset of pair j, N(0, σ_p²)
q_s = p_s + ε,  q_w = p_w + ε

On a locally flat surface both queries of a pair have the same distance. Far queries are uniform in the padded box.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from capture2vr.edge.arrays import DistanceFn, Floats, Ints
from capture2vr.edge.paper_field.network_config import WARM_QUERIES, NetworkConfig, pool_size
from capture2vr.edge.parallel import in_threads, slices

RANK = 50  # the neighbour whose distance gives σ_p (NeuralPull)
SPREAD, SPREAD_POINTS = 0.25, 20_000  # s: dense clouds spread their queries over more neighbours (CAP-UDF)
AREA_RANK = 8  # the disk to this neighbour is the area of as many points: small, so that it holds one layer only
PADDING = 0.1  # of the box on every side, unit frame: the extraction's grid ends nearer than that
PART = 1 << 16  # queries of a KD-tree between two yields, at which the caller may stop


@dataclass(frozen=True, slots=True)
class Pool:
    """All queries of a fit, on its device, float32 and int64, unit frame.

    points (N,3); weak (N,) the weak anchor of each point; offset (J,3); anchor (J,) the strong anchor;
    nearest (J,) the nearest point to q_s; far (F,3) and far_distance (F,) to the nearest point.
    """

    points: Tensor
    weak: Tensor
    offset: Tensor
    anchor: Tensor
    nearest: Tensor
    far: Tensor
    far_distance: Tensor

    def __len__(self) -> int:
        return len(self.offset)

    def strong_queries(self, j: Tensor) -> Tensor:
        """q_s (M,3) of the pairs j."""
        return self.points[self.anchor[j]] + self.offset[j]

    def weak_queries(self, j: Tensor) -> Tensor:
        """q_w (M,3) of the pairs j."""
        return self.points[self.weak[self.anchor[j]]] + self.offset[j]


def draw_pool(
    xyz: Floats, config: NetworkConfig, device: torch.device, metres: float | None = None
) -> Iterator[Pool | None]:
    """Draw the pool; the same points and seed give the same. Yields None between parts of the work, the pool last.

    metres: length of the unit frame's longest side, which the anchors' densities refer to; None: every point is strong.
    """
    rng = np.random.default_rng(config.seed)
    xyz = np.ascontiguousarray(xyz, np.float32)
    tree = cKDTree(xyz)
    count = pool_size(len(xyz), config)
    strong = rng.permutation(len(xyz))[: strong_count(xyz, tree, config, metres)]
    yield None
    # Among the strong anchors: a spread by all points would leave those half-way between two of few without queries.
    among = cKDTree(xyz[strong]) if len(strong) < len(xyz) else tree
    sigma = np.empty(len(xyz), np.float32)
    for part in slices(len(strong), PART // 8):
        sigma[strong[part]] = _sigmas(xyz[strong[part]], among)
        yield None
    # Every strong anchor has equally many queries, to within one.
    anchor = strong[rng.permutation(np.arange(count) % len(strong))]
    offset = rng.standard_normal((count, 3), np.float32) * sigma[anchor, None]
    nearest: Ints = np.empty(count, np.int64)
    for part in slices(count, PART):
        nearest[part] = _nearest(tree, xyz[anchor[part]] + offset[part])[1]
        yield None
    far = _far_queries(xyz, max(1, round(config.far_share * count)), rng)
    far_distance = np.empty(len(far), np.float32)
    for part in slices(len(far), PART):
        far_distance[part] = _nearest(tree, far[part])[0]
        yield None
    weak = np.sort(strong[: max(1, round(config.weak_share * len(strong)))])
    parts = (xyz, _weak_anchors(xyz, weak), offset, anchor, nearest, far, far_distance)
    yield Pool(*(torch.from_numpy(part).to(device) for part in parts))


def base_values(pool: Pool, base: DistanceFn) -> Iterator[Tensor | None]:
    """Evaluate the base at the pool's first queries. Yields None between parts of the work, the distances last."""
    count = min(len(pool), WARM_QUERIES)
    values = np.empty(count, np.float32)
    for part in slices(count, PART // 4):
        j = torch.arange(part.start, part.stop, device=pool.offset.device)
        values[part] = base(pool.strong_queries(j).cpu().numpy())[0]
        yield None
    yield torch.from_numpy(values).to(pool.offset.device)


class Batches:
    """Shuffled batches of query indices: they depend on seed and step alone, so a resumed fit needs no random state.

    The pool is shuffled again whenever it is used up; within a batch no query comes twice.
    """

    def __init__(self, count: int, batch: int, seed: int, device: torch.device) -> None:
        self.size = min(batch, count)
        self._count, self._seed, self._device = count, seed, device
        self._epoch, self._order = -1, torch.empty(0, dtype=torch.int64)

    def at(self, step: int) -> Tensor:
        """Draw the batch of a training step: indices (size,) int64 into the pool of queries."""
        epoch, part = divmod(step, self._count // self.size)
        if epoch != self._epoch:
            # Drawn on the CPU: within a captured CUDA graph a GPU's generator goes on from a seed of its own.
            generator = torch.Generator().manual_seed((self._seed << 20) + epoch)
            self._epoch, self._order = epoch, torch.randperm(self._count, generator=generator).to(self._device)
        return self._order[part * self.size : (part + 1) * self.size]


def _sigmas(xyz: Floats, tree: cKDTree) -> Floats:
    """σ_p (M,) of strong anchors (M,3), whose tree it is."""
    scale = max(SPREAD, SPREAD * math.sqrt(tree.n / SPREAD_POINTS))
    return np.asarray(scale * _rank_distance(xyz, tree, min(RANK, tree.n - 1)), np.float32)


def strong_count(xyz: Floats, tree: cKDTree, config: NetworkConfig, metres: float | None) -> int:
    """Number of strong anchors among points (N,3), whose tree it is: at least as many as a fit needs points."""
    if metres is None:
        return len(xyz)
    rank = min(AREA_RANK, tree.n - 1)
    area_m2 = math.pi / rank * float(np.square(_rank_distance(xyz, tree, rank)).sum()) * metres**2
    most = max(config.strong_per_m2 * area_m2, RANK + 1)
    return len(xyz) if most >= len(xyz) else round(most)


def _rank_distance(xyz: Floats, tree: cKDTree, rank: int) -> Floats:
    """Distance (M,) from points (M,3) that are among the tree's to their neighbour of that rank."""
    found = in_threads(lambda part: tree.query(xyz[part], k=[rank + 1])[0][:, 0], slices(len(xyz), PART // RANK))
    return np.concatenate(found)


def _weak_anchors(xyz: Floats, subset: Ints) -> Ints:
    """Index (N,) of the point of the subset that is nearest to each point; its members are their own."""
    return np.asarray(subset[_nearest(cKDTree(xyz[subset]), xyz)[1]], np.int64)


def _far_queries(xyz: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Uniform random places (count,3) in the padded bounding box."""
    low, high = xyz.min(axis=0) - PADDING, xyz.max(axis=0) + PADDING
    return np.asarray(rng.uniform(low, high, (count, 3)), np.float32)


def _nearest(tree: cKDTree, queries: Floats) -> tuple[Floats, Ints]:
    found = in_threads(lambda part: tree.query(queries[part]), slices(len(queries), PART // 4))
    return np.concatenate([away for away, _ in found]), np.concatenate([index for _, index in found])
