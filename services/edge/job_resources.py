"""What a process lends to one job: a device, a checkpoint file, an encoder, an engine, learned models, a generator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.models.folder import ModelFolder


@dataclass(frozen=True, slots=True)
class JobResources:
    """What the process that runs a job lends to it. None of it changes what is made, but for the device's
    rounding, what learned models propose and what a generator makes up.

    device      device that compares photos and trains the field: "cpu", "cuda:0"
    checkpoint  file that the training writes and resumes from; the caller removes it
    encode      encoder of KTX2 textures, for targets that want them
    engine      works at the tiles of a large scene; None: this process
    models      learned models that may help; None: none
    generator   makes objects from one photo, for the preset that asks it; None: that preset is refused
    """

    device: str = "cpu"
    checkpoint: Path | None = None
    encode: EncodeKtx2 | None = None
    engine: OpenEngine | None = None
    models: ModelFolder | None = None
    generator: GeneratorServer | None = None


CPU_ALONE = JobResources()
"""Of a process that has a CPU and nothing else."""
