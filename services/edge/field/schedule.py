"""The learning rate schedule: a short linear warm-up, then a cosine decay to 0."""

from __future__ import annotations

import math

RISE_SHARE = 0.1  # most of the steps that the warm-up may take: a preset of 2,000 must not spend half of them


def warm_up_cosine(step: int, steps: int, rise: int) -> float:
    """Share of the highest rate at step 0, 1, … `steps` − 1. It rises for `rise` steps, at most a tenth of all."""
    rise = min(rise, max(1, int(RISE_SHARE * steps)))
    if step < rise:
        return (step + 1) / rise
    return 0.5 * (1 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))
