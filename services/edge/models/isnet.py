"""IS-Net: a mask of the object that a photo is of. Runs as an ONNX graph; its weights are added by whoever wants them.

Xuebin Qin et al., "Highly Accurate Dichotomous Image Segmentation", ECCV 2022. Written from the paper and from what the
file says of its tensors: (RGB - 128) / 256 in channels, rows, columns, the photo stretched to the graph's square.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, part_of
from capture2vr.edge.models.graph import failed
from capture2vr.edge.models.nouns import LearnedView
from capture2vr.sentences.sentence import say

SIDE = 1024
"""Pixels of the square that the graph sees."""

_MEAN, _SPREAD = 128.0, 256.0  # of a channel: what is subtracted, and what it is divided by
_ROUNDED = 1e-3  # how far the last sigmoid may miss [0,1] by rounding

RunGraph = Callable[[Mapping[str, Floats], Tick], Mapping[str, Floats]]
"""Runs a graph: tensors by name -> tensors by name. Raises ModelError."""


@dataclass(frozen=True, slots=True)
class IsNet:
    """A `LearnedViews` that proposes masks. run: the graph, such as `Graph.run`."""

    run: RunGraph

    def __call__(self, photos: Sequence[Bytes], tick: Tick) -> tuple[LearnedView, ...]:
        """Propose a mask of each photo. Raises ModelError, and what `tick` raises."""
        count = len(photos)
        return tuple(
            LearnedView(self._mask(rgb, part_of(tick, at / count, (at + 1) / count))) for at, rgb in enumerate(photos)
        )

    def _mask(self, rgb: Bytes, tick: Tick) -> Floats:
        """Mask (h,w) float32 in [0,1] of a photo."""
        mask = self.run({"input": _tensor(rgb)}, tick)["output"][0, 0]
        if mask.min() < -_ROUNDED or mask.max() > 1 + _ROUNDED:
            raise failed(say("model_gave_no_mask", model="IS-Net", low=float(mask.min()), high=float(mask.max())))
        return _resize(mask, rgb.shape[1::-1]).clip(0, 1)


def _tensor(rgb: Bytes) -> Floats:
    """Photo (h,w,3) uint8 sRGB -> (1,3,SIDE,SIDE) float32."""
    square = _resize(rgb.astype(np.float32), (SIDE, SIDE))
    return np.ascontiguousarray(((square - _MEAN) / _SPREAD).transpose(2, 0, 1)[None])


def _resize(picture: Floats, size: tuple[int, ...]) -> Floats:
    """Resize to (width, height): averages where it gets smaller, interpolates where larger."""
    smaller = picture.shape[0] * picture.shape[1] > size[0] * size[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, (size[0], size[1]), interpolation=way), np.float32)
