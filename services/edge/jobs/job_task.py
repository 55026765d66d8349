"""What the process of a job is told, and how both sides write what they say to each other."""

from __future__ import annotations

import pickle
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf.message import Message

from capture2vr.edge.engine.nouns import Needs
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.preset import AUTOMATIC, Preset, memory_bytes
from capture2vr.order.job_options import JobOptions
from capture2vr.sentences.sentence import say

BUNDLE, MANIFEST = "bundle", "manifest.json"
"""Folder in the scratch folder in which a process hands a bundle over: its files in `files`, and its manifest."""


@dataclass(frozen=True, slots=True)
class Machine:
    """What of a worker's machine its jobs may use.

    device        that compares photos and trains fields: "cpu", "cuda:0"
    memory_bytes  for fits, of all jobs together
    encode        encoder of KTX2 textures; None: targets that want them are refused
    engine        the setting EDGE_ENGINE, which works at the tiles of large scenes, and the room of one job there
    models        learned models that its operator has added; None: none
    generator     that its operator has named; None: none
    """

    device: str
    memory_bytes: int
    encode: EncodeKtx2 | None = None
    engine: tuple[str, Needs] | None = None
    models: ModelFolder | None = None
    generator: GeneratorServer | None = None


@dataclass(frozen=True, slots=True)
class JobTask:
    """A job, as its process is told.

    archive     of the capture, or where `prepared` of the points that another worker made
    scratch     folder for temporary files; checkpoint: file that survives a killed process
    preset      that the job names; trains: whether a refined version may follow the preview
    saves       whether the points are saved beside the checkpoint, to be sent to central
    whole       whether points that are to be sent keep all that they were thinned from, for tiles
    log_level   of the worker
    most_seconds  that the job may compute; 0: the worker's own limit alone
    """

    job: str
    tenant: str
    archive: Path
    scratch: Path
    checkpoint: Path
    options: JobOptions
    preset: Preset | None
    machine: Machine
    trains: bool
    prepared: bool
    saves: bool
    whole: bool
    log_level: int
    most_seconds: float = 0.0

    def as_order(self) -> dict[str, Any]:
        """Return the order that is sent to the process."""
        return {"task": b64encode(pickle.dumps(self)).decode()}

    @classmethod
    def of(cls, order: Mapping[str, Any]) -> JobTask:
        """Read an order. It is pickled, as it goes from the worker to the process alone, and never back."""
        task: JobTask = pickle.loads(b64decode(order["task"]))  # noqa: S301
        return task

    def refusal(self, preset: Preset, points: int) -> str:
        """Why a preset cannot be trained on so many points: "" where it can. Who named a preset is told later."""
        return too_large(preset, points, self.machine) if self.options.preset == AUTOMATIC else ""


def fit_bytes(preset: Preset, points: int, machine: Machine) -> int:
    """Memory that a preset's fit or tiles take; 0 where neither follows the preview, which is finished by then."""
    return memory_bytes(preset, points, machine.device) if preset.refines else 0


def too_large(preset: Preset, points: int, machine: Machine) -> str:
    """Why a preset cannot be trained on so many points: "" where the whole budget suffices."""
    needed, total = fit_bytes(preset, points, machine), machine.memory_bytes
    if needed <= total:
        return ""
    return say("preset_needs_bytes_points_worker", preset=preset.name, needed=needed, points=points, total=total)


def on_wire(message: Message) -> str:
    """Write a message of the wire as text."""
    return b64encode(message.SerializeToString()).decode()


def off_wire(text: str) -> bytes:
    """Read a text of `on_wire`: the serialised message. Raises ValueError."""
    return b64decode(text, validate=True)
