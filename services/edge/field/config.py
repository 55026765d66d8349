"""Settings of the training of the product's own field. A preset states only how it differs from these defaults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

BLOCK_BYTES = 1 << 28  # of distances at once on a GPU: 5,000 queries × 13,000 points; larger blocks are no faster


@dataclass(frozen=True, slots=True)
class AnchorConfig:
    """Settings of the training of anchors: a curved patch at every point.

    steps          steps of the last round: 20 lose 1 to 8 % of what training gains, 160 gain nothing on most things
    learning_rate  Adam's highest rate, in spacings and slopes; a cosine takes it to 0
    """

    model: Literal["anchors"] = "anchors"
    steps: int = 60
    learning_rate: float = 0.1

    @property
    def total_steps(self) -> int:
        """Steps of the last round. The number of steps before it depends on the points."""
        return self.steps
