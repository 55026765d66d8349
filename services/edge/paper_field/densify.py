"""The densification round of CAP-UDF (Zhou et al., "Learning consistency-aware unsigned distance functions", 2022).

Queries around the points are pulled onto the fitted surface; those that reach it, near the input and not too close to
each other, become points of the next round. This closes the gaps between sparse points with what the field has learned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.field.planes import SPACING_RANK, rank_spacing
from capture2vr.edge.paper_field.losses import pull
from capture2vr.edge.paper_field.network_config import Densify
from capture2vr.edge.paper_field.networks import FieldNetwork
from capture2vr.edge.paper_field.queries import Pool
from capture2vr.edge.parallel import slices

DRAWN = 8  # queries per wanted point: half reach the surface, and the thinning keeps one of those close together
PULLS = 2  # the second corrects the first: a trained field is only nearly a distance
PART = 1 << 13  # queries between two yields: 0.1 s of the MLP on one core
DISK = 0.84  # of the spacing: disks of radius r, thrown at random until none fits, lie √0.7/r apart in the mean


def densify_points(network: FieldNetwork, pool: Pool, config: Densify, seed: int) -> Iterator[Floats | None]:
    """Compute the added points (K,3) float32. Yields None between parts of the work, and the points last."""
    points = pool.points.cpu().numpy()
    wanted = round(config.growth * len(points))
    count = min(len(pool), DRAWN * wanted)
    reached = []
    for part in slices(count, PART):
        j = torch.arange(part.start, part.stop, device=pool.points.device)
        reached.append(_pull_onto_surface(network, pool.strong_queries(j), config.field_below))
        yield None
    tree = cKDTree(points)
    xyz = np.concatenate(reached)
    xyz = xyz[tree.query(xyz)[0] < config.farthest]
    distance, _ = tree.query(points, k=min(SPACING_RANK + 1, len(points)))
    radius = DISK * float(np.median(rank_spacing(distance))) / math.sqrt(config.growth)
    yield xyz[poisson_disk(xyz, radius, seed)][:wanted]


def poisson_disk(xyz: Floats, radius: float, seed: int) -> Bools:
    """Thin points (N,3) -> mask (N,) of those to keep: none lies within the radius of another, and no more would fit.

    Every point has a random rank; in each round those of the lowest rank among their neighbours stay, and the
    neighbours are removed (M. Luby's independent set). It ends after some ten rounds whatever the number of points.
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
def _pull_onto_surface(network: FieldNetwork, q: torch.Tensor, below: float) -> Floats:
    """Pull the queries (M,3) onto the surface, and return those where the field then is below `below`."""
    for _ in range(PULLS):
        q = pull(q, *network.value_and_gradient(q))
    reached: Floats = q[network(q) < below].cpu().numpy()
    return reached
