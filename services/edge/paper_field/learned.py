"""The distance field of a trained network: numpy in, numpy out.

Far from all points a network's value is a guess, and a guess of 0 would be a sheet in the air. There the distance to
the nearest point is used instead, which is never 0.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.field.compute import translate_memory_errors
from capture2vr.edge.field.planes import SPACING_RANK, rank_spacing
from capture2vr.edge.paper_field.network_config import GPU_CHUNK
from capture2vr.edge.paper_field.networks import FieldNetwork
from capture2vr.edge.parallel import in_threads, slices

FAR = 6.0  # local spacings: the network is used up to here. Its training reaches four, the extraction three and 2 cells
CHUNK = {
    "cpu": 4_096,
    "cuda": GPU_CHUNK,
}  # queries at once: on a CPU the activations of a layer stay in the cache (2 MB)
TREE_CHUNK = 1 << 14  # queries of the KD-tree per task of a thread
_TINY = 1e-12  # avoids a division by 0: a gradient of 0 stays 0, which the extraction treats as none


class LearnedField:
    """The `DistanceFn` of a network and the points it was fitted to.

    Distances (M,) and gradients (M,3) are float32, gradients of length 1, also where their own length is not: the
    extraction asks on which side a query lies. A call uses the weights of `network` of that moment.
    """

    def __init__(self, network: FieldNetwork, points: Floats) -> None:
        self.network = network
        self._points = np.ascontiguousarray(points, np.float32)
        self._tree = cKDTree(self._points)
        distance, _ = self._tree.query(self._points, k=min(SPACING_RANK + 1, len(self._points)))
        self._reach = FAR * rank_spacing(distance.astype(np.float32))

    def __call__(self, queries: Floats) -> tuple[Floats, Floats]:
        q = np.ascontiguousarray(queries, np.float32)
        found = in_threads(lambda part: self._tree.query(q[part]), slices(len(q), TREE_CHUNK))
        away = np.concatenate([np.empty(0), *(a for a, _ in found)])
        index = np.concatenate([np.empty(0, np.int64), *(i for _, i in found)])
        far = away > self._reach[index]
        f, gradient = np.asarray(away, np.float32), np.empty((len(q), 3), np.float32)
        with translate_memory_errors(f"the field at {len(q):,} places"):
            f[~far], gradient[~far] = self._evaluate_network(q[~far])
        gradient[far] = (q[far] - self._points[index[far]]) / away[far, None]
        return f, gradient

    @torch.no_grad()
    def _evaluate_network(self, q: Floats) -> tuple[Floats, Floats]:
        f, gradient = np.empty(len(q), np.float32), np.empty((len(q), 3), np.float32)
        device = next(self.network.parameters()).device
        for part in slices(len(q), CHUNK[device.type]):
            distance, slope = self.network.value_and_gradient(torch.from_numpy(q[part]).to(device))
            slope = slope / (slope.norm(dim=1, keepdim=True) + _TINY)
            f[part], gradient[part] = distance.cpu().numpy(), slope.cpu().numpy()
        return f, gradient


def learned_field(network: FieldNetwork, points: Floats) -> DistanceFn:
    """Make the field of a network and its points (N,3), N ≥ 2, in the unit frame."""
    return LearnedField(network, points)
