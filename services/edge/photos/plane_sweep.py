"""Plane sweep: the depth of every pixel of a view, from a few other views.

R. T. Collins, "A Space-Sweep Approach to True Multi-Image Matching", 1996. Planes parallel to the view's image stand at
equal steps of inverse depth q = 1/z; on each the other pictures are brought into the view's place by a homography and
compared (`zncc`); `sgm` chooses a plane for every pixel; the depth is then refined pixel by pixel between the planes.
The arithmetic is a `Stand`'s: `stand.py` on the CPU, `stand_torch.py` on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from services.edge.arrays import Floats, Tick, no_tick
from services.edge.photos.pictures import Picture
from services.edge.photos.stand import CpuStand, vertex
from services.edge.photos.warp import Rays, Source, shift_px

_NEARER, _FARTHER = 0.7, 1.25
"""Of the nearest and the farthest sparse point of a view: how far the sweep goes beyond them."""
_PERCENTILES = (0.5, 99.0)
_STEP_PX = 1.0
"""Shift of a source's pixels from plane to plane; the refinement looks between them."""
_FEWEST, _MOST = 24, 128
"""Planes. Memory is 4 bytes a pixel and plane: 128 of 640 x 480 are 160 MB."""
_REFINEMENTS = (0.5, 0.25, 0.08)
"""Steps of the refinement in planes."""


@dataclass(frozen=True, slots=True)
class DepthMap:
    """depth (H,W) float32 in units of the alignment, along the optical axis; score (H,W) float32: ZNCC, -1 to 1."""

    depth: Floats
    score: Floats


class Stand(Protocol):
    """A reference and the pictures that it is compared with, at one size."""

    def chosen(self, planes: Floats, tick: Tick) -> Floats:
        """(H,W) number of the plane that SGM chooses for each pixel, or a little beside it; planes (D,) of 1/z."""

    def score(self, q: Floats) -> Floats:
        """(H,W) ZNCC in [-1,1] at the inverse depths q (H,W)."""


StandOf = Callable[[Picture, Sequence[Picture]], Stand]


def stand_on(device: str) -> StandOf:
    """Where the arithmetic is done: "cpu", or as PyTorch names a GPU."""
    if device == "cpu":
        return CpuStand
    from services.edge.photos.stand_torch import TorchStand  # loads torch

    return lambda reference, sources: TorchStand(reference, sources, device)


def sweep(
    reference: Picture, sources: Sequence[Picture], z: Floats, tick: Tick = no_tick, *, stand_of: StandOf = CpuStand
) -> DepthMap:
    """Depth of all pixels of `reference`. z (n,): depths of the sparse points that it saw.

    Planes are chosen on pictures of half the size, an eighth of the work, and the depth is refined on the whole ones.
    """
    near, far = np.percentile(z, _PERCENTILES)
    q_far, q_near = 1 / (_FARTHER * far), 1 / (_NEARER * near)
    small, small_sources = reference.halved(), [source.halved() for source in sources]
    planes = np.linspace(q_far, q_near, _planes(small, small_sources, q_far, q_near))
    chosen = stand_of(small, small_sources).chosen(planes, lambda fraction: tick(0.6 * fraction))
    fine = stand_of(reference, sources)
    q = _enlarged((planes[0] + (planes[1] - planes[0]) * chosen).astype(np.float32), reference.grey.shape)
    for number, step in enumerate(_REFINEMENTS):
        q = _refined(fine, q, step * (planes[1] - planes[0]))
        tick(0.6 + 0.4 * (number + 1) / len(_REFINEMENTS))
    q = np.clip(q, q_far, q_near).astype(np.float32)
    return DepthMap(1 / q, fine.score(q))


def _planes(reference: Picture, sources: Sequence[Picture], q_far: float, q_near: float) -> int:
    """Planes so that the picture's middle moves about `_STEP_PX` from one to the next in the median source."""
    others = [Source.of(reference, source) for source in sources]
    shift = shift_px(Rays.of(reference), others, q_far, q_near)
    return int(np.clip(shift / _STEP_PX, _FEWEST, _MOST))


def _enlarged(q: Floats, shape: tuple[int, ...]) -> Floats:
    import cv2

    return np.asarray(cv2.resize(q, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))


def _refined(stand: Stand, q: Floats, step: float) -> Floats:
    """q moved by at most `step` to where the pictures agree best; windows follow the depth of each of their pixels."""
    scores = [stand.score(q + np.float32(offset * step)) for offset in (-1, 0, 1)]
    return q + np.float32(step) * vertex(-scores[0], -scores[1], -scores[2])
