"""IS-Net: a mask of the object that a photo is of. Runs as an ONNX graph; its weights are added by whoever wants them.

Xuebin Qin et al., "Highly Accurate Dichotomous Image Segmentation", ECCV 2022. Written from the paper and from what the
file says of its tensors: (RGB - 128) / 256 in channels, rows, columns, the photo stretched to the graph's square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, part_of
from capture2vr.edge.models.nouns import LearnedView, RunGraph
from capture2vr.edge.models.tensors import check_mask, planes, resize

SIDE = 1024
"""Pixels of the square that the graph sees."""

_MEAN, _SPREAD = 128.0, 256.0  # of a channel: what is subtracted, and what it is divided by


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
        check_mask(mask, "IS-Net")
        return resize(mask, rgb.shape[1::-1]).clip(0, 1)


def _tensor(rgb: Bytes) -> Floats:
    """Photo (h,w,3) uint8 sRGB -> (1,3,SIDE,SIDE) float32."""
    return planes((resize(rgb.astype(np.float32), (SIDE, SIDE)) - _MEAN) / _SPREAD)
