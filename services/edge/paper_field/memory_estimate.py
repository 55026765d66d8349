"""Estimate how much memory a fit takes, so that a worker knows it before it accepts a job. Imports no torch."""

from __future__ import annotations

from capture2vr.edge.field.config import BLOCK_BYTES, AnchorConfig
from capture2vr.edge.paper_field.network_config import (
    GPU_CHUNK,
    WARM_QUERIES,
    NetworkConfig,
    far_batch,
    parameter_count,
    pool_size,
)

FLOAT, INDEX = 4, 8  # bytes
WEIGHT_COPIES = 6  # weights, gradients, two moments of Adam, the best weights, those of the checkpoint
MLP_LAYERS, MLP_WIDTH = 8, 256
# Floats per query, layer and channel that are kept for the backward pass: the slope and a(z); with the gradient
# also δ before and after the slope. A ReLU's slope has no gradient of its own, so its factors need not be kept.
KEPT_BY_VALUE = 2
KEPT_BY_GRADIENT = {"separable": 4, "mlp": 3}
KEPT_BY_AUTOGRAD = 9  # the same where autograd computes the gradient, as it does for a kernel of 3
BACKWARD = 1.5  # times what is kept, for the gradients of the backward pass; measured at 1,000 and 20,000 queries
TREE_BYTES = 64  # per point and tree: coordinates, index and its share of the nodes
# Bytes of torch's workspaces, and of what it imports for a first step; on a GPU also the context and the graph's pool.
RUNTIME = {"cpu": 64 << 20, "cuda": 600 << 20}
# Bytes of a fit of anchors: one block of edges with its activations; and per point some nine edges of 110 bytes, the
# patch, Adam's state, and on a CPU the neighbours and the edges in double precision while they are built.
ANCHORS = {"cpu": 100 << 20, "cuda": 1_200 << 20}
ANCHOR_BYTES = {"cpu": 5_000, "cuda": 2_000}


def fit_memory_bytes(points: int, config: AnchorConfig | NetworkConfig, device: str = "cpu") -> int:
    """Estimate the bytes that a fit to so many points takes on its device; no bound, on a CPU within a factor of 2.

    = runtime + weights + pool + the activations of a step + trees (CPU), or a block of distances and the activations of
      what the extraction asks at once (GPU)                                                             for a network
    = a block of edges + some bytes per point                                                            for anchors

    The local field and the KD-trees that draw the pool stay in main memory and are not counted for a GPU.
    """
    kind = "cpu" if device == "cpu" else "cuda"
    if isinstance(config, AnchorConfig):
        return ANCHORS[kind] + ANCHOR_BYTES[kind] * points
    most_points, batch = points, config.batch
    if config.densify:
        most_points, batch = round(points * (1 + config.densify.growth)), max(batch, config.densify.batch)
    pool = pool_size(most_points, config)
    beside = 3 * TREE_BYTES * most_points if kind == "cpu" else 2 * BLOCK_BYTES + evaluation_bytes(config)
    return (
        RUNTIME[kind]
        + WEIGHT_COPIES * FLOAT * parameter_count(config)
        + _pool_bytes(pool, most_points, config)
        + _step_bytes(min(batch, pool), config)
        + beside
    )


def evaluation_bytes(config: NetworkConfig) -> int:
    """Bytes of the activations of one chunk of the trained field, with gradients: all slopes, three layers at work.

    A step's memory is not given back for it: it belongs to the captured graph. Measured on an H200 at 2^18 queries: 2.9
    GB of the ancestors' network (2.95 by this), 1.5 to 1.8 GB of the paper's (1.88).
    """
    kept = KEPT_BY_AUTOGRAD * _channels(config) if config.neighbours else _channels(config) + 3 * _width(config)
    return GPU_CHUNK * kept * FLOAT


def _pool_bytes(pool: int, points: int, config: NetworkConfig) -> int:
    """Bytes of the pool.

    Per query an offset, two indices, its place in the batches' order and ω; per far query a place and a distance.
    """
    per_query = 3 * FLOAT + 3 * INDEX + FLOAT
    far = round(config.far_share * pool) * 4 * FLOAT
    return pool * per_query + far + min(pool, WARM_QUERIES) * FLOAT + points * (3 * FLOAT + INDEX)


def _step_bytes(batch: int, config: NetworkConfig) -> int:
    """Bytes of the activations of one step: with gradients at q, q̂ and the weak queries of pairs that compare them."""
    pairs, pulled = config.self_consistency > 0, config.pairs == "pull"
    with_gradient = batch * (1 + (config.projection > 0) + (pairs and pulled))
    by_value = batch * ((pairs and not pulled) + (config.surface > 0)) + far_batch(config, batch)
    by_gradient = KEPT_BY_AUTOGRAD if config.neighbours else KEPT_BY_GRADIENT[config.model]
    kept = by_gradient * with_gradient + KEPT_BY_VALUE * by_value
    return round(BACKWARD * kept * _channels(config) * FLOAT)


def _width(config: NetworkConfig) -> int:
    return MLP_WIDTH if config.model == "mlp" else max(config.widths)


def _channels(config: NetworkConfig) -> int:
    """Channels of all layers, times the places that each is computed at: with a kernel of 3, several."""
    if config.model == "mlp":
        return MLP_LAYERS * MLP_WIDTH
    places = range(len(config.widths), 0, -1) if config.neighbours else [1] * len(config.widths)
    return sum(width * min(count, config.neighbours + 1) for width, count in zip(config.widths, places, strict=True))
