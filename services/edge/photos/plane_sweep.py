"""Plane sweep stereo: compute the depth of every pixel of a view from a few other views.

R. T. Collins, "A Space-Sweep Approach to True Multi-Image Matching", 1996. Planes parallel to the view's image are at
equal steps of inverse depth q = 1/z; for each plane the other pictures are warped to the view by a homography and
compared (`zncc`); `sgm` chooses a plane for every pixel; then the depth is refined per pixel between the planes, and
smoothed within surfaces, by turns: a pixel alone follows its noise, and where each of a window's pixels has another
error, the window matches less well.
A `SweepBackend` does the computation: `plane_sweep_cpu.py` on the CPU, `plane_sweep_torch.py` on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.photos.plane_sweep_cpu import CpuSweep, vertex
from capture2vr.edge.photos.undistorted import UndistortedPhoto
from capture2vr.edge.photos.warp import Rays, WarpSource, shift_px

_NEARER, _FARTHER = 0.7, 1.25
"""First and last plane, over the depths of a view's nearest and farthest sparse points."""
_PERCENTILES = (0.5, 99.0)
"""Percentiles of the sparse points' depths that count as nearest and farthest."""
_STEP_PX = 1.0
"""Shift of a source's pixels from plane to plane; the refinement finds depths between them."""
_FEWEST, _MOST = 24, 96
"""Least and most planes. Memory is 4 bytes per pixel and plane: 96 of 320 x 240 are 30 MB. Of 128 no more is found, of
80 a little less in dark fur."""
_REFINEMENTS = (0.5, 0.25, 0.12)
"""Steps of the refinement, in distances between planes."""
_ALIKE, _NEAR_PX = 0.5, 1.5
"""Standard deviations of the smoothing: differences of neighbours, in distances between planes, and pixels. With it the
depth of a rendered cup errs by .06 % of its size in the median, without it by .10. Twice as wide a difference, a median
before it and a fourth refinement leave .05, but of stems of two pixels a twentieth less."""


@dataclass(frozen=True, slots=True)
class DepthMap:
    """Depth of a view's pixels: depth (H,W) float32 along the optical axis, in units of the alignment; score (H,W)
    float32: ZNCC, -1 to 1."""

    depth: Floats
    score: Floats


class SweepBackend(Protocol):
    """Computes the sweep of one reference picture and its sources, all at one size."""

    def choose_planes(self, planes: Floats, tick: Tick) -> Floats:
        """Choose a plane for each pixel by SGM: its index (H,W), with a fraction between planes; planes (D,) of 1/z."""

    def score(self, q: Floats) -> Floats:
        """Return the ZNCC (H,W) in [-1,1] at the inverse depths q (H,W)."""


SweepBackendOf = Callable[[UndistortedPhoto, Sequence[UndistortedPhoto]], SweepBackend]
"""Function that makes the backend for a reference and its sources."""


def backend_on(device: str) -> SweepBackendOf:
    """Return the backend for a device: "cpu", or a GPU as PyTorch names it."""
    if device == "cpu":
        return CpuSweep
    from capture2vr.edge.photos.plane_sweep_torch import TorchSweep  # loads torch

    return lambda reference, sources: TorchSweep(reference, sources, device)


def sweep(
    reference: UndistortedPhoto,
    sources: Sequence[UndistortedPhoto],
    z: Floats,
    tick: Tick = no_tick,
    *,
    backend_of: SweepBackendOf = CpuSweep,
) -> DepthMap:
    """Compute the depth of all pixels of `reference`. z (n,): depths of the sparse points that it sees.

    Planes are chosen on pictures of half the size, an eighth of the work; the depth is refined at full size.
    """
    near, far = np.percentile(z, _PERCENTILES)
    q_far, q_near = 1 / (_FARTHER * far), 1 / (_NEARER * near)
    small, small_sources = reference.half_size(), [source.half_size() for source in sources]
    planes = np.linspace(q_far, q_near, _planes(small, small_sources, q_far, q_near))
    spacing = float(planes[1] - planes[0])
    chosen = backend_of(small, small_sources).choose_planes(planes, lambda fraction: tick(0.6 * fraction))
    fine = backend_of(reference, sources)
    q = _upscale((planes[0] + spacing * chosen).astype(np.float32), reference.grey.shape)
    for number, step in enumerate(_REFINEMENTS):
        q = _smooth(_refine(fine, q, step * spacing), spacing)
        tick(0.6 + 0.4 * (number + 1) / len(_REFINEMENTS))
    q = np.clip(q, q_far, q_near).astype(np.float32)
    return DepthMap(1 / q, fine.score(q))


def _planes(reference: UndistortedPhoto, sources: Sequence[UndistortedPhoto], q_far: float, q_near: float) -> int:
    """Return the number of planes for which the picture's middle moves `_STEP_PX` per plane in the median source."""
    others = [WarpSource.of(reference, source) for source in sources]
    shift = shift_px(Rays.of(reference), others, q_far, q_near)
    return int(np.clip(shift / _STEP_PX, _FEWEST, _MOST))


def _upscale(q: Floats, shape: tuple[int, ...]) -> Floats:
    """Upscale inverse depths to `shape`, bilinearly."""
    import cv2

    return np.asarray(cv2.resize(q, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))


def _refine(backend: SweepBackend, q: Floats, step: float) -> Floats:
    """Move q by at most `step` to the best score; each pixel of a window is warped by its own depth."""
    scores = [backend.score(q + np.float32(offset * step)) for offset in (-1, 0, 1)]
    return q + np.float32(step) * vertex(-scores[0], -scores[1], -scores[2])


def _smooth(q: Floats, spacing: float) -> Floats:
    """Smooth inverse depths within surfaces, not over their edges. Those of a plane are linear: they stay."""
    import cv2

    return np.asarray(cv2.bilateralFilter(q, 5, _ALIKE * spacing, _NEAR_PX))
