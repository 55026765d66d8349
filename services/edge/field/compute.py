"""What a CPU and a GPU do differently: nearest neighbours, threads or a CUDA graph for a step, out of memory."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import BLOCK_BYTES
from capture2vr.edge.parallel import in_threads
from capture2vr.sentences.sentence import say

_log = logging.getLogger(__name__)

_capturing = threading.Lock()

In = TypeVar("In")
Out = TypeVar("Out")

Nearest = Callable[[Tensor], Tensor]
"""(M,3) -> index (M,) of the nearest point to each, or (M,K) of the K nearest."""


def open_device(name: str) -> torch.device:
    """Return the torch device of that name. Raises EdgeError DEVICE_ABSENT where this machine does not have it."""
    try:
        device = torch.device(name)
        if device.type not in ("cpu", "cuda"):
            raise RuntimeError("fits run on cpu and cuda")
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:  # torch asserts where it was built without CUDA
        raise EdgeError(
            "DEVICE_ABSENT",
            say("worker_cannot_compute", device=name, why=str(error).splitlines()[0]),
            hints=(say("use_device_cpu"), say("start_worker_on_machine")),
        ) from None
    return device


def nearest_in(points: Tensor) -> Nearest:
    """Nearest-neighbour search among fixed points (N,3): a KD-tree on a CPU, all distances by blocks on a GPU."""
    if points.device.type == "cpu":
        return _KdTree(points)
    return lambda queries: nearest_by_blocks(queries, points)


def nearest(queries: Tensor, points: Tensor) -> Tensor:
    """Find the nearest point of each query, for points that move every step: indices (M,)."""
    return nearest_in(points)(queries)


def several_nearest_in(points: Tensor, count: int) -> Nearest:
    """k-nearest-neighbour search like `nearest_in`: indices (M,count) of the `count` nearest points, nearest first."""
    if points.device.type == "cpu":
        tree = cKDTree(_finite(points))
        ranks = np.arange(1, count + 1)
        return lambda queries: torch.from_numpy(np.asarray(tree.query(_finite(queries), k=ranks)[1], np.int64))
    size = max(1, BLOCK_BYTES // (points.element_size() * len(points)))

    def by_blocks(queries: Tensor) -> Tensor:
        parts = torch.split(queries.detach(), size)
        return torch.cat([torch.cdist(part, points).topk(count, largest=False).indices for part in parts])

    return by_blocks


class _KdTree:
    def __init__(self, points: Tensor) -> None:
        # Without balancing and compacting a tree of a step's 5,000 queries takes 0.7 ms to build, not 1.2.
        self._tree = cKDTree(_finite(points), balanced_tree=False, compact_nodes=False)

    def __call__(self, queries: Tensor) -> Tensor:
        return torch.from_numpy(np.asarray(self._tree.query(_finite(queries))[1], np.int64))


def _finite(xyz: Tensor) -> Floats:
    """Replace NaN, which a KD-tree refuses. A fit that diverges is found by its loss, which stays NaN."""
    return torch.nan_to_num(xyz.detach()).numpy()


def nearest_by_blocks(queries: Tensor, points: Tensor, block_bytes: int = BLOCK_BYTES) -> Tensor:
    """Find the nearest point of each query by brute force, in blocks of points: indices (M,).

    The blocks' shapes depend only on the sizes of the input, as a captured CUDA graph needs it.

    |q−p|² − |q|² = |p|² − 2 q·p is one matrix product; `cdist` without it starts a block of threads for every pair. Its
    rounding is 2e-7, so the point found may be another whose squared distance is as small to within that.
    """
    queries, points = queries.detach(), points.detach()
    best = torch.full((len(queries),), torch.inf, dtype=queries.dtype, device=queries.device)
    index = torch.zeros(len(queries), dtype=torch.int64, device=queries.device)
    size = max(1, block_bytes // (queries.element_size() * max(1, len(queries))))
    for start in range(0, len(points), size):
        block = points[start : start + size]
        score, which = torch.addmm(block.square().sum(dim=1), queries, block.T, alpha=-2).min(dim=1)
        nearer = score < best
        best = torch.where(nearer, score, best)
        index = torch.where(nearer, which + start, index)
    return index


def rows(table: Tensor, index: Tensor) -> Tensor:
    """Return table[index]. Its backward sums in a fixed order, unlike indexing, so that fits are reproducible."""
    return torch.nn.functional.embedding(index, table)


def map_blocks(work: Callable[[In], Out], blocks: Sequence[In], device: torch.device) -> list[Out]:
    """Apply `work` to every block; on a CPU in threads of one core each. The results are in the order of the blocks.

    torch's own threads split every small operation and busy-wait between two of them: when other work uses the cores, a
    step then takes four times as long as on one core. A GPU's blocks run one by one: graph capture is for one thread.
    """
    threads = torch.get_num_threads()
    if threads == 1 or len(blocks) == 1 or device.type != "cpu":
        return [work(block) for block in blocks]

    def alone(block: In) -> Out:
        torch.set_num_threads(1)  # for this thread, and as the default of later threads, which is reset below
        return work(block)

    try:
        return in_threads(alone, blocks)
    finally:
        torch.set_num_threads(threads)


def capture_step(step: Callable[[], None], device: torch.device) -> Callable[[], None]:
    """Capture a step as one CUDA graph, because small kernels are limited by their launches; on a CPU return it as is.

    The step must read and write only tensors that keep their address, and must have run a few times before, so that
    allocators, cuBLAS and Adam's state have settled. The capture itself computes nothing. A step that cannot be
    captured is returned as it is. May be called from the threads of several jobs.
    """
    if device.type != "cuda":
        return step
    try:
        graph = torch.cuda.CUDAGraph()
        # One capture at a time: its start waits for the device, which would abort another capture. On a stream of its
        # own: the default one is shared by all threads, and is of the first GPU. The outer context resets the stream
        # even where the capture cannot begin.
        stream = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        # thread_local: other jobs of this worker go on using the GPU from their threads during the capture.
        capture = partial(torch.cuda.graph, graph, stream=stream, capture_error_mode="thread_local")
        with _capturing, torch.cuda.stream(stream), capture():
            step()
    except torch.cuda.OutOfMemoryError:
        raise
    except RuntimeError:
        _log.warning("cannot capture this fit's step as a CUDA graph; it runs without one, more slowly", exc_info=True)
        return step
    return graph.replay


@contextmanager
def translate_memory_errors(what: str) -> Iterator[None]:
    """Translate torch's out-of-memory errors, of a GPU and of the CPU allocator, into EdgeError GPU_OOM."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        message = f"{what} does not fit into the free memory: {str(error).splitlines()[0]}"
        raise _out_of_memory(message) from None
    except RuntimeError as error:
        if "DefaultCPUAllocator" not in str(error):  # its error has no class of its own
            raise
        raise _out_of_memory(f"{what} does not fit into this machine's memory") from None


def _out_of_memory(message: str) -> EdgeError:
    return EdgeError(
        "GPU_OOM",
        message,
        hints=(say("try_again_when_other_jobs"), say("choose_preset_with_smaller_batch")),
        retryable=True,
    )
