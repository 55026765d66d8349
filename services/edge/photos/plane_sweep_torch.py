"""Plane sweep on a GPU: the `SweepBackend` in PyTorch, which processes a few planes or one row at a time.

It has the same formulas as `zncc.py` and `sgm.py`, and the same result except for rounding: OpenCV warps pictures in
steps of 1/32 pixel, here they are warped exactly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from capture2vr.edge.arrays import Bytes, Floats, Tick
from capture2vr.edge.photos.sgm import EDGE, P1, P2
from capture2vr.edge.photos.undistorted import UndistortedPhoto
from capture2vr.edge.photos.warp import Rays, WarpSource
from capture2vr.edge.photos.zncc import NOISE, WINDOW

_PLANES = 16
"""Planes processed at once: each tensor of 16 planes of 640 x 480 pixels takes 20 MB."""


@contextmanager
def _translate_memory_errors() -> Iterator[None]:
    """Translate a full GPU's error into MemoryError, which callers without PyTorch know."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise MemoryError(str(error).splitlines()[0]) from None


class TorchSweep:
    """`SweepBackend` on a PyTorch device. Its methods raise MemoryError where the device is full."""

    @_translate_memory_errors()
    def __init__(self, reference: UndistortedPhoto, sources: Sequence[UndistortedPhoto], device: str) -> None:
        self._device = torch.device(device)
        self._grey = self._put(reference.grey)
        self._mean = _box(self._grey)
        self._inverse = _inverse(_box(self._grey.square()) - self._mean.square())
        rays = Rays.of(reference)
        x, y = self._put(rays.x), self._put(rays.y)
        self._rays = torch.stack(
            [x[None].expand(len(y), -1), y[:, None].expand(-1, len(x)), torch.ones_like(self._grey)]
        )
        of = [WarpSource.of(reference, source) for source in sources]
        self._sources = [(self._put(each.grey), self._put(each.turn), self._put(each.shift)) for each in of]

    @_translate_memory_errors()
    def choose_planes(self, planes: Floats, tick: Tick) -> Floats:
        """Choose a plane for each pixel by SGM: its index (H,W), with a fraction between planes."""
        costs = []
        for part in torch.split(self._put(planes), _PLANES):
            score = self._score(part[:, None, None].expand(-1, *self._grey.shape))
            costs.append((127.5 * (1 - score.clamp(-1, 1))).to(torch.uint8))
            tick(sum(map(len, costs)) / len(planes))
        cost = torch.cat(costs).permute(1, 2, 0).to(torch.int16)
        return _lowest(_aggregate(cost, self._grey)).cpu().numpy()

    @_translate_memory_errors()
    def score(self, q: Floats) -> Floats:
        """Return the ZNCC (H,W) in [-1,1] at the inverse depths q (H,W): the mean of the two best sources."""
        return self._score(self._put(q)[None])[0].cpu().numpy()

    def _score(self, q: Tensor) -> Tensor:
        """Return the scores (k,H,W) at the inverse depths (k,H,W)."""
        first, second = torch.full_like(q, -1), torch.full_like(q, -1)
        for grey, turn, shift in self._sources:
            score = self._zncc(_warp(grey, torch.einsum("ij,jhw->ihw", turn, self._rays), shift, q))
            second = torch.maximum(second, torch.minimum(first, score))
            first = torch.maximum(first, score)
        return torch.where(second > -1, (first + second) / 2, first)

    def _zncc(self, other: Tensor) -> Tensor:
        """Return the ZNCC of warped pictures (k,H,W) with the reference."""
        mean = _box(other)
        spread = _inverse(_box(other.square()) - mean.square())
        return (_box(self._grey * other) - self._mean * mean) * self._inverse * spread

    def _put(self, values: Floats | Bytes) -> Tensor:
        """Copy an array to the device, as float32."""
        return torch.from_numpy(np.ascontiguousarray(values, np.float32)).to(self._device)


def _warp(grey: Tensor, turned: Tensor, shift: Tensor, q: Tensor) -> Tensor:
    """Warp a picture (h,w) to the reference, through the inverse depths q (k,H,W); black outside."""
    u, v, w = (turned[axis] + shift[axis] * q for axis in range(3))
    height, width = grey.shape
    ahead = w > 0
    safe = torch.where(ahead, w, torch.ones_like(w))
    place = torch.stack([(2 * u / safe + 1) / width - 1, (2 * v / safe + 1) / height - 1], dim=-1)
    place = torch.where(ahead[..., None], place, torch.full_like(place, 4.0))  # behind the source: outside its picture
    tall = place.reshape(1, -1, place.shape[2], 2)
    seen = functional.grid_sample(grey[None, None], tall, padding_mode="zeros", align_corners=False)
    return seen.reshape(q.shape)


def _box(values: Tensor) -> Tensor:
    """Box filter: means over windows of (H,W) or (k,H,W), mirrored at the border."""
    reach = WINDOW // 2
    stack = values.reshape(-1, 1, *values.shape[-2:])
    wide = functional.pad(stack, (reach, reach, reach, reach), mode="reflect")
    across = functional.avg_pool2d(wide, (1, WINDOW), 1)
    return functional.avg_pool2d(across, (WINDOW, 1), 1).reshape(values.shape)


def _inverse(variance: Tensor) -> Tensor:
    """Return 1/sqrt(var + ε)."""
    return (variance.clamp(min=0) + NOISE**2).rsqrt()


def _aggregate(cost: Tensor, grey: Tensor) -> Tensor:
    """Sum the costs (H,W,D) int16 over four paths, as `sgm.aggregate` does."""
    tone = grey.to(torch.int16)
    total = torch.zeros_like(cost)
    _paths(cost, total, _jump_penalty(tone.diff(dim=0).abs()))
    _paths(cost.transpose(0, 1), total.transpose(0, 1), _jump_penalty(tone.diff(dim=1).abs().T))
    return total


def _jump_penalty(step: Tensor) -> Tensor:
    """Return the penalty of a depth jump, as in `sgm.py`."""
    return (P2 / (1 + step.double() / EDGE)).clamp(min=P1 + 1).to(torch.int16)


def _paths(cost: Tensor, total: Tensor, jump: Tensor) -> None:
    """Add the path costs of both directions along the first axis to `total`."""
    rows = range(len(cost))
    for way in (rows, rows[::-1]):
        here = cost[way[0]]
        total[way[0]] += here
        for before, row in pairwise(way):
            least = here.amin(dim=1, keepdim=True)
            beside = functional.pad(here, (1, 1), value=torch.iinfo(torch.int16).max // 2)
            side = torch.minimum(beside[:, :-2], beside[:, 2:]) + P1
            far = least + jump[min(before, row)][:, None]
            here = cost[row] + torch.minimum(torch.minimum(here, side), far) - least
            total[row] += here


def _lowest(total: Tensor) -> Tensor:
    """Return the index (H,W) of the plane of least cost, with a fraction from a parabola through its neighbours."""
    index = total.argmin(dim=2, keepdim=True).clamp(1, total.shape[2] - 2)
    before, here, after = (total.gather(2, index + step)[..., 0].float() for step in (-1, 0, 1))
    bend = before - 2 * here + after
    offset = torch.where(bend > 0, (before - after) / (2 * bend.clamp(min=1e-9)), (before - after).sign())
    return index[..., 0] + offset.clamp(-1, 1)
