"""Settings of the training of a network. A preset states only how it differs from these defaults.

They are the paper's for an object (section 4.2) unless a reason is given; the symbols are those of `losses.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

UNUSED_KEYS = {"mlp": ("width",)}
"""Keys of `NetworkConfig` that a model does not use, by model."""

PER_POINT = 100  # queries per point: for 10,000 points the full million of the paper
WARM_QUERIES = 200_000  # most queries of the pool that the warm start uses: 40 steps of 5,000


@dataclass(frozen=True, slots=True)
class Densify:
    """The second round of CAP-UDF: the fitted surface is sampled, and the fit goes on with those points added.

    steps         steps after the round, on top of the fit's own
    batch         queries per step after it: there are more points to cover
    field_below   unit frame: a pulled query where the field is larger has not reached the surface
    farthest      unit frame: a pulled query farther from the input is dropped (CAP-UDF: 0.002–0.0035)
    growth        points added at most, as a multiple of the input (CAP-UDF: 0.5–5)
    """

    steps: int = 20_000
    batch: int = 20_000
    field_below: float = 0.01
    farthest: float = 0.0035
    growth: float = 1.0


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """Settings of the training of a network.

    model             "separable" is the paper's network, "mlp" that of its ancestors (463,100 parameters)
    width             channels of the separable network, 128 or 256; the MLP is always 256 wide
    steps             steps with the losses: 40,000 for an object, 100,000 for a scene in the paper
    warm_start        steps of regression onto the local field before them; 0 starts from a random network
    warm_up           steps over which the learning rate rises, at the most a tenth of `steps`
    batch             queries per step
    learning_rate     Adam's highest rate; a cosine takes it to 0 over the steps
    pool              queries drawn for the whole fit, at most; small clouds draw 100 per point
    weak_share        share of the points that are weak anchors; the paper's pairs are 1,000 : 100–500 points per m²
    far_share         far queries per query; a twentieth is enough to keep far sheets out and costs a hundredth
    seed              of the weights, the pool and the batches
    chamfer           weight of (1); 0 only for ablations
    projection        τ_p, weight of (2)
    orthogonality     τ_o, weight of (3)
    surface           τ_f, weight of (4), which the paper mentions inside (2) and lists without a weight
    self_consistency  τ_s, weight of (6)
    decay             λ of (2), per unit frame
    memory            β of (5)
    densify           the round of CAP-UDF, or None
    patience          steps without a better residual on the held-out points before the fit ends; 0 never ends early
    """

    model: Literal["separable", "mlp"] = "separable"
    width: int = 128
    steps: int = 40_000
    warm_start: int = 0
    warm_up: int = 1_000
    batch: int = 5_000
    learning_rate: float = 1e-3
    pool: int = 1_000_000
    weak_share: float = 0.25
    far_share: float = 0.05
    seed: int = 0
    chamfer: float = 1.0
    projection: float = 1e-3
    orthogonality: float = 1e-4
    surface: float = 0.0
    self_consistency: float = 1e-2
    decay: float = 10.0
    memory: float = 0.9
    densify: Densify | None = None
    patience: int = 0

    @property
    def loss_steps(self) -> int:
        """Steps with the losses, those after the densification included."""
        return self.steps + (self.densify.steps if self.densify else 0)

    @property
    def total_steps(self) -> int:
        """All steps, the warm start included: 100 % of a progress bar."""
        return self.warm_start + self.loss_steps


def pool_size(points: int, config: NetworkConfig) -> int:
    """Number of queries in the pool of so many points."""
    return min(config.pool, PER_POINT * points)


def far_batch(config: NetworkConfig, batch: int) -> int:
    """Number of far queries per step."""
    return round(config.far_share * batch)
