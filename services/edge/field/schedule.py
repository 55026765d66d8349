"""The learning rate of every step: a short rise, then a cosine to 0."""

from __future__ import annotations

import math

from services.edge.field.config import FitConfig

WARM_START_RISE = 50  # steps: a regression is tame, but Adam's first steps know no variance
RISE_SHARE = 0.1  # of the steps, at the most: a preset of 2,000 must not spend half of them rising


def learning_rate(step: int, config: FitConfig) -> float:
    """Of step 0, 1, … `total_steps` − 1, the warm start first: it has a rise and a cosine of its own."""
    if step < config.warm_start:
        return config.learning_rate * rise_and_fall(step, config.warm_start, WARM_START_RISE)
    return config.learning_rate * rise_and_fall(step - config.warm_start, config.loss_steps, config.warm_up)


def rise_and_fall(step: int, steps: int, rise: int) -> float:
    """The share of the highest rate at step 0, 1, … `steps` − 1, which rises for `rise` steps or a tenth of all."""
    rise = min(rise, max(1, int(RISE_SHARE * steps)))
    if step < rise:
        return (step + 1) / rise
    return 0.5 * (1 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))
