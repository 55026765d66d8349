"""The densification round of CAP-UDF (Zhou et al., "Learning consistency-aware unsigned distance functions", 2022).

Queries around the points are pulled onto the fitted surface; those that land there, near the input and not too close
to each other, are points of the next round. It closes the gaps between sparse points with what the field has learned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from scipy.spatial import cKDTree

from services.edge.arrays import Bools, Floats
from services.edge.field.config import Densify
from services.edge.field.losses import pulled
from services.edge.field.networks import FieldNetwork
from services.edge.field.planes import SPACING_RANK, rank_spacing
from services.edge.field.queries import Pool
from services.edge.threads import slices

DRAWN = 8  # queries per wanted point: half land, and of eight on a place the thinning keeps one
PULLS = 2  # the second takes what the first left over: a trained field is a distance only nearly
PART = 1 << 13  # queries between two breaths: 0.1 s of the MLP on one core
DISK = 0.84  # of the spacing: disks of radius r, thrown at random until none fits, lie √0.7/r apart in the mean


def densified(network: FieldNetwork, pool: Pool, config: Densify, seed: int) -> Iterator[Floats | None]:
    """None for a breath between parts of the work, the added points (K,3) float32 last."""
    points = pool.points.cpu().numpy()
    wanted = round(config.growth * len(points))
    count = min(len(pool), DRAWN * wanted)
    landed = []
    for part in slices(count, PART):
        j = torch.arange(part.start, part.stop, device=pool.points.device)
        landed.append(_landed(network, pool.strong_queries(j), config.field_below))
        yield None
    tree = cKDTree(points)
    xyz = np.concatenate(landed)
    xyz = xyz[tree.query(xyz)[0] < config.farthest]
    distance, _ = tree.query(points, k=min(SPACING_RANK + 1, len(points)))
    radius = DISK * float(np.median(rank_spacing(distance))) / math.sqrt(config.growth)
    yield xyz[poisson_disk(xyz, radius, seed)][:wanted]


def poisson_disk(xyz: Floats, radius: float, seed: int) -> Bools:
    """(N,3) -> which to keep (N,), so that none lies within the radius of another and none more fits.

    Every point has a random rank; in each round those of the lowest rank among their neighbours stay and remove them
    (M. Luby's independent set), which ends after some ten rounds whatever the number of points.
    """
    rank = np.random.default_rng(seed).permutation(len(xyz))
    a, b = cKDTree(xyz).query_pairs(radius, output_type="ndarray").T
    keep = np.ones(len(xyz), bool)
    while len(a):
        first = rank[a] < rank[b]
        beaten = np.zeros(len(xyz), bool)
        beaten[np.where(first, b, a)] = True
        stays = ~beaten
        removed = np.zeros(len(xyz), bool)
        removed[b[stays[a]]] = True
        removed[a[stays[b]]] = True
        keep &= ~removed
        left = keep[a] & keep[b]
        a, b = a[left], b[left]
    return keep


@torch.no_grad()
def _landed(network: FieldNetwork, q: torch.Tensor, below: float) -> Floats:
    for _ in range(PULLS):
        q = pulled(q, *network.value_and_gradient(q))
    landed: Floats = q[network(q) < below].cpu().numpy()
    return landed
