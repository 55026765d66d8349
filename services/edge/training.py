"""Train the field that refines a preview: report its progress, and retry with less memory where a GPU is full."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.sentences.sentence import in_row, say

if TYPE_CHECKING:
    from capture2vr.edge.field.step import Step

_ETA_FROM = 20  # steps before a remaining time is shown: the first ones warm the caches
_RATE_OF = 50  # latest yields that the rate is measured over: a second or two of steps


@dataclass(frozen=True, slots=True)
class FieldTraining:
    """Inputs of a training: points, configuration and device.

    xyz_unit    (N,3) points; noise: their noise, None where they were denoised
    base        the local field of the denoised points, smooth (N,3)
    watched     (W,3) held-out points for early stopping
    checkpoint  file that the training writes and resumes from, or None
    metres      length of the unit frame's longest side, None where the unit of the points is unknown
    halved      whether the batch was halved to save memory
    """

    xyz_unit: Floats
    noise: Noise | None
    config: AnchorConfig | NetworkConfig
    device: str
    base: DistanceFn
    smooth: Floats
    watched: Floats
    checkpoint: Path | None = None
    metres: float | None = None
    halved: bool = False

    def with_less_memory(self) -> tuple[FieldTraining, str] | None:
        """The same training in less GPU memory, and a warning: half a network's batch, then the CPU, then None."""
        if self.device == "cpu":
            return None
        if not self.halved and isinstance(self.config, NetworkConfig):  # anchors have no batch: a step uses them all
            densify = self.config.densify
            if densify is not None:  # its batch is the larger one, and may be the one that did not fit
                densify = replace(densify, batch=max(1, densify.batch // 2))
            smaller = replace(self.config, batch=max(1, self.config.batch // 2), densify=densify)
            return replace(self, config=smaller, halved=True), "the batch was halved"
        return replace(self, device="cpu"), "the field was trained on the CPU"


@dataclass(frozen=True, slots=True)
class TrainedField:
    """A trained field with its figures; `warnings` say whether memory ran out on the way.

    near  (N,3) points that its surface lies near; for anchors, the anchors' trained positions
    """

    distance: DistanceFn
    near: Floats
    steps: int
    losses: Mapping[str, float]
    device: str
    warnings: tuple[str, ...]


def train(training: FieldTraining, clock: Clock, bar: Bar) -> Generator[Progress, None, TrainedField]:
    """Train to the end, with less memory whenever the GPU's is exhausted. Raises EdgeError as the fits do; GPU_OOM only
    where nothing smaller is left."""
    warnings: tuple[str, ...] = ()
    while True:
        try:
            with clock("FITTING"):
                return (yield from _steps(training, bar, warnings))
        except EdgeError as error:
            smaller = training.with_less_memory()
            if error.code != "GPU_OOM" or smaller is None:
                raise
            training, change = smaller
            warnings = (*warnings, in_row("; ", (error.message, change)))
        # Outside the `except`: until it ends, the error keeps the stack frames alive whose tensors fill the GPU.
        if training.checkpoint:  # it was written for another batch or another device
            training.checkpoint.unlink(missing_ok=True)


def _steps(training: FieldTraining, bar: Bar, warnings: tuple[str, ...]) -> Generator[Progress, None, TrainedField]:
    # Imported here: a worker that makes previews only must not load torch.
    from capture2vr.edge.field.anchors import AnchorField

    yield bar.begin("FITTING", say("training_on_device", device=training.device))
    steps = _fit(training)
    losses: Mapping[str, float] = {}
    eta = _Eta()
    with closing(steps):
        for step in steps:
            losses = step.losses or losses
            message = (
                eta(step, say("step_of_all", step=step.number, all=step.of)) if step.number else say("analysing_points")
            )
            yield bar.advance("FITTING", step.number / step.of, message, step.losses)
    near = step.field.points if isinstance(step.field, AnchorField) else training.smooth
    return TrainedField(step.field, near, step.number, losses, training.device, warnings)


def _fit(training: FieldTraining) -> Generator[Step, None, None]:
    """Start the fit for the config's model: anchors or a network."""
    from capture2vr.edge.field.anchor_fit import fit_anchors
    from capture2vr.edge.paper_field.network_fit import fit_network

    if isinstance(training.config, AnchorConfig):
        return fit_anchors(
            training.xyz_unit,
            training.config,
            device=training.device,
            base=training.base,
            noise=training.noise,
            checkpoint=training.checkpoint,
        )
    return fit_network(
        training.xyz_unit,
        training.config,
        device=training.device,
        base=training.base,
        held_out=training.watched,
        checkpoint=training.checkpoint,
        metres=training.metres,
    )


class _Eta:
    """Estimates the remaining time from the rate of the latest steps: the first steps, a warm start, are quicker."""

    def __init__(self) -> None:
        self._latest: deque[tuple[int, float]] = deque(maxlen=_RATE_OF)

    def __call__(self, step: Step, what: str) -> str:
        """Return what is done, with the time that is left once it can be told."""
        self._latest.append((step.number, time.monotonic()))
        (first, began), (last, now) = self._latest[0], self._latest[-1]
        if last - first < _ETA_FROM or last >= step.of:
            return what
        seconds = (now - began) / (last - first) * (step.of - last)
        if seconds < 100:
            return say("s_left", what=what, seconds=seconds)
        return say("min_left", what=what, minutes=seconds / 60)
