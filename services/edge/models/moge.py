"""MoGe-2: depth, normals and true size of what one photo shows. Runs as an ONNX graph that its authors publish.

Ruicheng Wang et al., "MoGe-2: Accurate Monocular Geometry with Metric Scale and Sharp Details", NeurIPS 2025, and of
the points' shift "MoGe", CVPR 2025. Written from the papers and from what https://github.com/microsoft/MoGe says of the
graph (docs/onnx.md, moge/model/v2.py): it takes RGB in [0,1] in channels, rows, columns, of any size, and how many
patches of 14 x 14 pixels it shall look at; it gives points in OpenCV's axes but for an unknown shift along the optical
axis, normals, a mask of where there is a surface, and the factor to metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, part_of
from capture2vr.edge.models.graph import failed
from capture2vr.edge.models.nouns import LearnedView, RunGraph
from capture2vr.edge.models.tensors import check_mask, planes, resize
from capture2vr.sentences.sentence import say

TOKENS = 1800
"""Patches that the graph looks at; it was trained with 1,200 to 3,600."""

_NAME = "MoGe-2"
_PATCH = 14  # pixels of a patch's side
_SURFACE = 0.5  # of the mask: where there is a surface
_SAMPLES = 64  # places along each side by which shift and focal length are found, as its authors do
_LEAST = 16  # places on a surface that tell them
_NO_SHIFT = 3e-4  # weight of having no shift, against a place that is seen half a diagonal off


@dataclass(frozen=True, slots=True)
class MoGe:
    """A `LearnedViews` that proposes depth and normals. run: the graph, such as `Graph.run`."""

    run: RunGraph

    def __call__(self, photos: Sequence[Bytes], tick: Tick) -> tuple[LearnedView, ...]:
        """Propose depth, normals and focal length of each photo. Raises ModelError, and what `tick` raises."""
        count = len(photos)
        return tuple(self._view(rgb, part_of(tick, at / count, (at + 1) / count)) for at, rgb in enumerate(photos))

    def _view(self, rgb: Bytes, tick: Tick) -> LearnedView:
        width, height = picture_size(rgb.shape)
        picture = planes(resize(rgb.astype(np.float32), (width, height)) / 255)
        found = self.run({"image": picture, "num_tokens": np.array(TOKENS, np.int64)}, tick)
        points, normals, mask, factor = _checked(found, (height, width))
        surface = mask > _SURFACE
        if not (camera := _camera(points, surface)):
            return LearnedView()
        focal, shift = camera
        depth = (points[..., 2] + shift) * factor
        surface &= depth > 0
        rows, columns = (_nearest(now, then) for now, then in zip(rgb.shape[:2], (height, width), strict=True))
        at = np.ix_(rows, columns)
        return LearnedView(
            depth_m=np.where(surface, depth, 0).astype(np.float32)[at],
            normals=np.where(surface[..., None], normals, 0).astype(np.float32)[at],
            focal_px=float(focal * np.hypot(*rgb.shape[:2]) / 2),
        )


def picture_size(shape: Sequence[int]) -> tuple[int, int]:
    """Width and height of the picture that the graph is given for a photo (h,w,...): its pixels are `TOKENS` patches.

    It keeps the photo's shape but for half a pixel, so that the focal length is one number.
    """
    height, width = shape[:2]
    by = np.sqrt(TOKENS * _PATCH**2 / (height * width))
    return max(1, round(width * by)), max(1, round(height * by))


def _checked(found: Mapping[str, Floats], size: tuple[int, int]) -> tuple[Floats, Floats, Floats, float]:
    """Points (h,w,3), normals (h,w,3), mask (h,w) and the factor to metres. Raises ModelError for other shapes."""
    points, normals, mask, factor = (found[name] for name in ("points", "normal", "mask", "scale"))
    if (points.shape, normals.shape) != ((1, *size, 3),) * 2 or (mask.shape, factor.shape) != ((1, *size), (1,)):
        shapes = ", ".join(str(list(each.shape)) for each in (points, normals, mask, factor))
        raise failed(say("model_gave_other_shapes", model=_NAME, shapes=shapes))
    check_mask(mask, _NAME)
    if factor[0] <= 0:
        raise failed(say("model_gave_no_size", model=_NAME, factor=float(factor[0])))
    return points[0], normals[0], mask[0], float(factor[0])


def _camera(points: Floats, surface: Bools) -> tuple[float, float] | None:
    """Focal length, in halves of the picture's diagonal, and the shift of points (h,w,3) along the optical axis.

    They are those with which the points are seen where they are: f · (x, y) / (z + t) = (u, v), by least squares, with
    (u, v) in halves of the diagonal from the picture's middle. The best f for a t follows from that (as in MoGe), the
    best t by Gauss and Newton's method (scipy) from where f · (x, y) = (u, v) · (z + t), which is linear, holds best.

    None where hardly any surface is seen. Raises ModelError where no camera sees the points so.
    """
    height, width = surface.shape
    rows, columns = (_nearest(min(_SAMPLES, side), side) for side in (height, width))
    at = np.ix_(rows, columns)
    chosen = surface[at]
    if chosen.sum() < _LEAST:
        return None
    across, down = (2 * (each + 0.5) - side for each, side in ((columns, width), (rows, height)))
    seen = np.stack(np.meshgrid(across, down), axis=-1)[chosen] / np.hypot(width, height)
    xyz = points[at][chosen].astype(np.float64)
    focal, shift = _solved(seen, xyz[:, :2], xyz[:, 2])
    if not (np.isfinite([focal, shift]).all() and focal > 0):
        raise failed(say("model_gave_no_camera", model=_NAME))
    return focal, shift


def _solved(seen: Floats, xy: Floats, z: Floats) -> tuple[float, float]:
    """Focal length and shift of places (n,2) in the picture and points xy (n,2), z (n,).

    Of something flat that faces the camera many shifts explain the picture as well: the least is taken.
    """
    from scipy.optimize import least_squares  # a third of a second to load

    least_shift = _NO_SHIFT * np.sqrt(len(z))

    def focal_of(across: Floats) -> float:
        return float((across * seen).sum() / max((across * across).sum(), 1e-12))

    def off(shift: Floats) -> Floats:
        across = xy / (z + shift)[:, None]
        return np.append(focal_of(across) * across - seen, least_shift * shift / typical)

    typical = max(float(np.median(np.abs(z))), 1e-6)
    linear = np.append(np.stack([xy.ravel(), -seen.ravel()], axis=1), [[0, least_shift]], axis=0)
    (_, start), *_ = np.linalg.lstsq(linear, np.append(seen * z[:, None], 0), rcond=None)
    least = 1e-3 * typical - float(z.min())  # all points stay before the camera
    shift = float(least_squares(off, max(start, least + 1e-3 * typical), bounds=(least, np.inf)).x[0])
    return focal_of(xy / (z + shift)[:, None]), shift


def _nearest(count: int, side: int) -> Ints:
    """Indices (count,) of the pixels of a side that lie nearest to the middles of as many others."""
    return ((np.arange(count) + 0.5) / count * side).astype(int)
