"""Settings of the training of a network. A preset states only how it differs from these defaults.

They are the paper's for an object (section 4.2) unless a reason is given; the symbols are those of `losses.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

UNUSED_KEYS = {"mlp": ("widths", "neighbours", "certainty")}
"""Keys of `NetworkConfig` that a model does not use, by model."""

LAYERS = 6
"""Layers of the paper's network."""
INPUT_AT = (2, 5)
"""Layers of the paper's network that also read the query, counted from 1."""
MLP_PARAMETERS = 463_100
"""Parameters of the ancestors' network."""

PER_POINT = 100  # queries per point: for 10,000 points the full million of the paper
GPU_CHUNK = 1 << 15  # queries that a GPU evaluates at once: activations of some 400 MB with the ancestors' network
WARM_QUERIES = 200_000  # most queries of the pool that the warm start uses: 40 steps of 5,000


_WEIGHTS = ("chamfer", "projection", "surface", "orthogonality", "self_consistency")


@dataclass(frozen=True, slots=True)
class Densify:
    """The second round of CAP-UDF: the fitted surface is sampled, and the fit goes on with those points added.

    Raises ValueError for a number with which it cannot be done.

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

    def __post_init__(self) -> None:
        _check_at_least(1, self, "steps", "batch")
        _check_above_zero(self, "field_below", "farthest", "growth")


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """Settings of the training of a network. Raises ValueError for those with which no network can be built or trained.

    model             "separable" is the paper's network, "mlp" that of its ancestors (463,100 parameters)
    widths            channels of the six layers of the separable network. The paper prints "128 or 256" and 147,200
                      parameters: 256 where the query is read gives 152,339; six times 169 give 147,218
    neighbours        0: kernel size 1. Otherwise the kernel has size 3 and runs over the query and so many nearest
                      points, at most 6, in the order of their distance
    steps             steps with the losses: 40,000 for an object, 100,000 for a scene in the paper
    warm_start        steps of regression onto the local field before them; 0 starts from a random network
    warm_up           steps over which the learning rate rises, at the most a tenth of `steps`
    batch             queries per step
    learning_rate     Adam's highest rate; a cosine takes it to 0 over the steps
    pool              queries drawn for the whole fit, at most; small clouds draw 100 per point
    strong_per_m2     most strong anchors per square metre of the surface, where the unit of the points is known
    weak_per_m2       the same of the weak anchors; of fewer strong ones, the share weak_per_m2 / strong_per_m2
    far_share         far queries per query, which the paper does not have; a twentieth keeps far sheets out
    seed              of the weights, the pool and the batches
    chamfer           weight of (1); 0 only for ablations
    projection        τ_p, weight of the first sum in (2)
    sign              sign of λ in (2): "printed" weighs places far from the surface most, "decaying" those near it
    surface           weight of the second sum in (2), which is (4): τ_p as printed
    orthogonality     τ_o, weight of (3)
    self_consistency  τ_s, weight of (6)
    pairs             what is equal for both queries of a pair: the way to the surface, f·ĝ, which has the gradients
                      that (7) names ("pull"), or the distance alone, as in (6) ("distance")
    certainty         what log(1/ω) is in (6): a factor of the difference ("weight"), or, as printed, an input of the
                      network ("input")
    decay             λ of (2), per unit frame
    memory            β of (5)
    densify           the round of CAP-UDF, or None
    patience          steps without a better residual on the held-out points before the fit ends; 0 never ends early
    """

    model: Literal["separable", "mlp"] = "separable"
    widths: tuple[int, ...] = (128, 256, 128, 128, 256, 128)
    neighbours: int = 0
    steps: int = 40_000
    warm_start: int = 0
    warm_up: int = 1_000
    batch: int = 5_000
    learning_rate: float = 1e-3
    pool: int = 1_000_000
    strong_per_m2: float = 1_000.0
    weak_per_m2: float = 500.0
    far_share: float = 0.0
    seed: int = 0
    chamfer: float = 1.0
    projection: float = 1e-3
    sign: Literal["printed", "decaying"] = "decaying"
    surface: float = 1e-3
    orthogonality: float = 1e-4
    self_consistency: float = 1e-2
    pairs: Literal["pull", "distance"] = "pull"
    certainty: Literal["weight", "input"] = "weight"
    decay: float = 10.0
    memory: float = 0.9
    densify: Densify | None = None
    patience: int = 0

    def __post_init__(self) -> None:
        if len(self.widths) != LAYERS or min(self.widths) < 1:
            given = ", ".join(map(str, self.widths))
            raise ValueError(f"widths = [{given}]: the network has {LAYERS} layers, each with at least one channel")
        if not (0 < self.weak_per_m2 <= self.strong_per_m2 and math.isfinite(self.weak_per_m2)):
            raise ValueError(
                f"weak_per_m2 = {self.weak_per_m2:g}: it must be finite, above 0 and at most strong_per_m2, "
                f"which is {self.strong_per_m2:g}"
            )
        _check_at_least(1, self, "steps", "batch", "pool")
        _check_at_least(0, self, "warm_start", "warm_up", "patience", "seed", "far_share", "decay", *_WEIGHTS)
        _check_above_zero(self, "learning_rate")
        if not 0 <= self.memory < 1:
            raise ValueError(f"memory = {self.memory:g}: it must be from 0 to below 1")
        if not any(getattr(self, name) for name in _WEIGHTS):
            raise ValueError(f"no loss has a weight above 0: {', '.join(_WEIGHTS)}")
        if not 0 <= self.neighbours <= LAYERS:
            raise ValueError(f"neighbours = {self.neighbours}: {LAYERS} layers reach at most {LAYERS}; use fewer")
        if self.neighbours and self.certainty == "input":
            raise ValueError('neighbours and certainty = "input" cannot be combined')

    @property
    def inputs(self) -> int:
        """Numbers that the network reads of a query: its place, and log(1/ω) where that is an input."""
        return 4 if self.certainty == "input" else 3

    @property
    def weak_share(self) -> float:
        """Weak anchors per strong anchor."""
        return self.weak_per_m2 / self.strong_per_m2

    @property
    def loss_steps(self) -> int:
        """Steps with the losses, those after the densification included."""
        return self.steps + (self.densify.steps if self.densify else 0)

    @property
    def total_steps(self) -> int:
        """All steps, the warm start included: 100 % of a progress bar."""
        return self.warm_start + self.loss_steps


def _check_at_least(least: int, config: object, *names: str) -> None:
    for name in names:
        if not least <= (value := getattr(config, name)) < math.inf:
            raise ValueError(f"{name} = {value:g}: it must be at least {least}, and finite")


def _check_above_zero(config: object, *names: str) -> None:
    for name in names:
        if not 0 < (value := getattr(config, name)) < math.inf:
            raise ValueError(f"{name} = {value:g}: it must be above 0, and finite")


def parameter_count(config: NetworkConfig) -> int:
    """Number of parameters of the configured network.

    A layer of C_in inputs has a depthwise filter of one weight, or of three, and a bias for each, and a pointwise
    matrix and a bias for each of its outputs; C_in counts the query where the layer reads it.
    """
    if config.model == "mlp":
        return MLP_PARAMETERS
    kernel = 3 if config.neighbours else 1
    count, channels = 0, config.inputs
    for number, width in enumerate(config.widths, 1):
        channels += config.inputs * (number in INPUT_AT)
        count += (kernel + 1) * channels + (channels + 1) * width
        channels = width
    return count + channels + 1


def pool_size(points: int, config: NetworkConfig) -> int:
    """Number of queries in the pool of so many points."""
    return min(config.pool, PER_POINT * points)


def far_batch(config: NetworkConfig, batch: int) -> int:
    """Number of far queries per step."""
    return round(config.far_share * batch)
