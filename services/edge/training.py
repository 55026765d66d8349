"""The training behind a preview: steps as progress, and steps down where a GPU's memory does not suffice."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from services.edge.arrays import DistanceFn, Floats
from services.edge.errors import EdgeError
from services.edge.field.config import FitConfig
from services.edge.field.noise import Noise
from services.edge.progress import Bar, Clock, Progress

if TYPE_CHECKING:
    from services.edge.field.fit import Step

_ETA_FROM = 20  # steps before the rate says anything: the first ones warm the caches
_RATE_OF = 50  # yields that the rate is taken from: a second or two of steps


@dataclass(frozen=True, slots=True)
class Training:
    """What a field is trained on and how.

    xyz_unit    (N,3) points; noise: theirs, None where it was taken off
    base        the local field of the same denoised, smooth (N,3)
    watched     (W,3) held-out points that may end it early
    checkpoint  file that it writes and goes on from, or None
    """

    xyz_unit: Floats
    noise: Noise | None
    config: FitConfig
    device: str
    base: DistanceFn
    smooth: Floats
    watched: Floats
    checkpoint: Path | None = None
    halved: bool = False

    def lower(self) -> tuple[Training, str] | None:
        """The same in less memory of a GPU, and what to say of it: half a network's batch, the CPU, then nothing."""
        if self.device == "cpu":
            return None
        if not self.halved and self.config.model != "anchors":  # a step of anchors sees them all
            smaller = replace(self.config, batch=max(1, self.config.batch // 2))
            return replace(self, config=smaller, halved=True), "the batch was halved"
        return replace(self, device="cpu"), "it was trained on the CPU"


@dataclass(frozen=True, slots=True)
class Trained:
    """A field and how it was come by; `warnings` tell of steps down on the way.

    near  (N,3) the points that its surface lies near: where anchors were trained, where they have come to lie
    """

    distance: DistanceFn
    near: Floats
    steps: int
    losses: Mapping[str, float]
    device: str
    warnings: tuple[str, ...]


def train(training: Training, clock: Clock, bar: Bar) -> Generator[Progress, None, Trained]:
    """Train to the end. Raises EdgeError as `fit` does, GPU_OOM only where stepping down does not help."""
    warnings: tuple[str, ...] = ()
    while True:
        try:
            with clock("FITTING"):
                return (yield from _steps(training, bar, warnings))
        except EdgeError as error:
            below = training.lower()
            if error.code != "GPU_OOM" or below is None:
                raise
            training, said = below
            warnings = (*warnings, f"{error.message}; {said}")
        # Here, not inside: the error holds the frames that it came through, and they the tensors that filled the GPU.
        if training.checkpoint:  # of another batch or another device
            training.checkpoint.unlink(missing_ok=True)


def _steps(training: Training, bar: Bar, warnings: tuple[str, ...]) -> Generator[Progress, None, Trained]:
    # Here, not above: who only makes previews needs no torch.
    from services.edge.field.anchors import AnchorField
    from services.edge.field.fit import fit

    config = training.config
    yield bar.starts("FITTING", f"training on {training.device}")
    steps = fit(
        training.xyz_unit,
        config,
        device=training.device,
        base=training.base,
        noise=training.noise,
        held_out=training.watched,
        checkpoint=training.checkpoint,
    )
    losses: Mapping[str, float] = {}
    eta = _Eta()
    with closing(steps):
        for step in steps:
            losses = step.losses or losses
            message = f"step {step.number:,} of {step.of:,}{eta(step)}" if step.number else "looking at the points"
            yield bar.at("FITTING", step.number / step.of, message, step.losses)
    near = step.field.points if isinstance(step.field, AnchorField) else training.smooth
    return Trained(step.field, near, step.number, losses, training.device, warnings)


class _Eta:
    """How long the rest takes at the rate of the latest steps: those of the warm start are quicker than the others."""

    def __init__(self) -> None:
        self._latest: deque[tuple[int, float]] = deque(maxlen=_RATE_OF)

    def __call__(self, step: Step) -> str:
        self._latest.append((step.number, time.monotonic()))
        (first, began), (last, now) = self._latest[0], self._latest[-1]
        if last - first < _ETA_FROM or last >= step.of:
            return ""
        seconds = (now - began) / (last - first) * (step.of - last)
        return f", {seconds:.0f} s left" if seconds < 100 else f", {seconds / 60:.0f} min left"
