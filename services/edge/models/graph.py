"""Run a model's ONNX graph by ONNX Runtime, in a child process that is limited in memory and time.

The file is checked before each run: its SHA-256 is the model's version in all that it has a part in. ONNX Runtime is
loaded in the child alone.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.models.card import ModelCard, Shapes
from capture2vr.edge.models.nouns import ModelError, UsedModel
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say

ORDER, INPUTS, OUTPUTS, FAULT = "order.json", "inputs.npz", "outputs.npz", "fault.json"
"""Files in the folder by which the child is told what to do, and tells what came of it."""

_BLOCK_BYTES = 1 << 20
_DIGITS = 12  # of a SHA-256, by which people tell two files

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class GraphOrder:
    """What the child is told.

    runs     whether the graph is run on the inputs, or only loaded and compared with the shapes
    device   "cpu", "cuda:0"; without room or support there, the CPU
    threads  of one operator
    """

    file: str
    inputs: Shapes
    outputs: Shapes
    integers: tuple[str, ...]
    runs: bool
    device: str
    threads: int
    most_bytes: int


@dataclass(frozen=True, slots=True)
class GraphFault:
    """Why the child gave up: what is wrong, and in what words ONNX Runtime or the child says so."""

    kind: str
    why: str


@dataclass(frozen=True, slots=True)
class Graph:
    """A model's file on this machine, and the device that runs it."""

    card: ModelCard
    file: Path
    device: str = "cpu"

    @property
    def used(self) -> UsedModel:
        """The model as a result names it."""
        return UsedModel(self.card.name, self.card.sha256)

    def check(self, tick: Tick = no_tick) -> None:
        """Check the file's hash, load the graph, and compare its tensors with the table. Raises ModelError."""
        self._in_child({}, tick)

    def run(self, inputs: Mapping[str, Floats | Ints], tick: Tick = no_tick) -> dict[str, Floats]:
        """Run the graph: tensors by name, float32, or int64 where the table says so -> its outputs by name, float32.

        Raises ModelError MODEL_UNAVAILABLE for a file or a runtime that cannot be used, MODEL_FAILED where the graph
        takes too much memory or time or gives numbers that are not finite, and what `tick` raises.
        """
        outputs = self._in_child(inputs, tick)
        if not all(np.isfinite(each).all() for each in outputs.values()):
            raise failed(say("model_gave_numbers_not_finite", model=self.card.title), self._get_again)
        return outputs

    def check_file(self) -> None:
        """Check the file's size and SHA-256. Raises ModelError MODEL_UNAVAILABLE."""
        card = self.card
        try:
            size, found = self.file.stat().st_size, sha256_of(self.file)
        except OSError as error:
            why = say("model_file_cannot_be_read", model=card.title, file=card.file, why=error.strerror or error)
            raise unavailable(why, say("let_worker_read_models")) from None
        if size < card.bytes:
            why = say("model_file_is_cut_off", model=card.title, file=card.file, size=size, wanted=card.bytes)
            raise unavailable(why, self._get_again)
        if found != card.sha256:
            known = card.sha256[:_DIGITS]
            why = say("model_file_is_another", model=card.title, file=card.file, found=found[:_DIGITS], wanted=known)
            raise unavailable(why, self._get_again)

    @property
    def _get_again(self) -> str:
        return say("get_model_again", name=self.card.name)

    def _in_child(self, inputs: Mapping[str, Floats | Ints], tick: Tick) -> dict[str, Floats]:
        """Run the child on inputs; without any, it only loads the graph and compares its tensors with the table."""
        card = self.card
        self.check_file()
        if find_spec("onnxruntime") is None:
            raise unavailable(say("model_needs_onnx_runtime", model=card.title), say("install_extra_models"))
        shapes = card.inputs, card.outputs, card.integers
        order = GraphOrder(str(self.file), *shapes, bool(inputs), self.device, _threads(), card.most_bytes)
        with tempfile.TemporaryDirectory(prefix="model-") as name:
            folder = Path(name)
            (folder / ORDER).write_text(json.dumps(asdict(order)), encoding="utf-8")
            np.savez(folder / INPUTS, **inputs)  # type: ignore[arg-type]
            self._follow(folder, tick)
            with np.load(folder / OUTPUTS) as file:
                return dict(file)

    def _follow(self, folder: Path, tick: Tick) -> None:
        """Run the child to its end. Raises ModelError with its fault."""
        command = python_command("-m", "capture2vr.edge.models.graph_child", str(folder))
        title = self.card.title
        try:
            run_child(command, title, folder / "log", tick, most_seconds=self.card.most_s)
        except ChildError as error:
            if error.too_slow:
                raise failed(str(error), say("give_model_more_cores")) from None
            raise self._ended(folder / FAULT, str(error)) from None
        except OSError as error:
            raise failed(say("model_process_cannot_start", model=title, why=error.strerror or error)) from None

    def _ended(self, fault: Path, ending: str) -> ModelError:
        """Return the error of a child that has not ended well. ending: how it ended, for one that left no fault."""
        title, gigabytes = self.card.title, self.card.most_bytes / 1e9
        try:
            found = GraphFault(**json.loads(fault.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            _log.warning("%s", ending)  # its last words have paths, which are nobody else's business
            how = ending.partition(": ")[0]
            return failed(say("model_process_ended", model=title, how=how), say("give_worker_more_memory"))
        match found.kind:
            case "memory":
                needed = say("model_needs_more_memory", model=title, gigabytes=gigabytes)
                return failed(needed, say("give_worker_more_memory"))
            case "tensors":
                return unavailable(say("model_graph_has_other_tensors", model=title, why=found.why), self._get_again)
            case "load":
                loads = say("model_graph_cannot_be_loaded", model=title, why=found.why)
                return unavailable(loads, say("update_onnx_runtime"))
        return failed(say("model_graph_failed", model=title, why=found.why), say("update_onnx_runtime"))


def sha256_of(file: Path) -> str:
    """Return a file's SHA-256 in hexadecimal digits. Raises OSError."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while block := opened.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def unavailable(why: str, *hints: str) -> ModelError:
    """Return the error for a model that is not there as it should be."""
    return ModelError("MODEL_UNAVAILABLE", why, hints=hints)


def failed(why: str, *hints: str) -> ModelError:
    """Return the error for a model that was run in vain."""
    return ModelError("MODEL_FAILED", why, hints=hints)


def _threads() -> int:
    """Threads that a graph may use: the cores of this process, or OMP_NUM_THREADS, by which operators divide them."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    named = os.environ.get("OMP_NUM_THREADS", "")
    return min(cores, int(named)) if named.isdigit() and int(named) else cores
