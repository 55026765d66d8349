"""Child process that runs an ONNX graph: `python -m capture2vr.edge.models.graph_child FOLDER`.

Reads the order and the inputs in FOLDER, and writes the outputs there, or why there are none.
"""

from __future__ import annotations

import json
import re
import resource
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from capture2vr.edge.child_process import die_with_parent
from capture2vr.edge.models.card import FREE
from capture2vr.edge.models.graph import FAULT, INPUTS, ORDER, OUTPUTS, GraphFault, GraphOrder

_ON_CPU = "CPUExecutionProvider"
_ON_CUDA = "CUDAExecutionProvider"
_ERRORS_ONLY = 3  # ONNX Runtime's severity; below it are hints to the authors of graphs
_WHY_LENGTH = 200  # characters of ONNX Runtime's words that are passed on
# Paths of this machine, which are nobody's business, those of ONNX Runtime's source, and the names of its functions.
_NOISE = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |Load model from .*? failed:|/\S+:\d+ [^)]*\)(?: const)?|(?<!\w)/\S+"
)
_OF_MEMORY = ("bad allocation", "bad_alloc", "allocate memory", "out of memory", "allocation failed")


class _Stop(Exception):  # noqa: N818 - it carries the fault
    """Ends the run with a fault."""

    def __init__(self, kind: str, why: str) -> None:
        super().__init__(why)
        self.fault = GraphFault(kind, why)


def main(folder: Path) -> int:
    """Run the graph; return the exit status, and leave the fault in the folder where there is one."""
    die_with_parent()
    order = GraphOrder(**json.loads((folder / ORDER).read_text(encoding="utf-8")))
    _limit(order)
    try:
        np.savez(folder / OUTPUTS, **_work(order, folder))
    except (MemoryError, _Stop) as error:
        fault = error.fault if isinstance(error, _Stop) else GraphFault("memory", "")
        (folder / FAULT).write_text(json.dumps(asdict(fault)), encoding="utf-8")
        return 1
    return 0


def _limit(order: GraphOrder) -> None:
    """Limit the memory; a GPU's driver reserves more than it uses, so there only what an operator has set counts.

    An inspection has lower limits, for what captures cost that nobody knows. The graph is the operator's own.
    """
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    most = hard if _on_gpu(order) else _at_most(order.most_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    processor = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (processor, processor))  # the parent's clock ends it


def _at_most(wanted: int, hard: int) -> int:
    return wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)


def _on_gpu(order: GraphOrder) -> bool:
    return order.device.startswith("cuda") and _ON_CUDA in onnxruntime.get_available_providers()


def _work(order: GraphOrder, folder: Path) -> Mapping[str, Any]:
    """Load the graph, compare its tensors with the order's, and run it, if it is to run. Raises _Stop, MemoryError."""
    if _on_gpu(order):
        try:
            return _on(order, folder, [(_ON_CUDA, {"device_id": order.device.partition(":")[2] or "0"}), _ON_CPU])
        except (MemoryError, _Stop) as error:  # the GPU has no room, or lacks an operator
            sys.stderr.write(f"on {order.device}: {error}; once more on the CPU\n")
    return _on(order, folder, [_ON_CPU])


def _on(order: GraphOrder, folder: Path, providers: list[Any]) -> Mapping[str, Any]:
    """Do the work on the named providers of ONNX Runtime."""
    session = _guarded("load", lambda: onnxruntime.InferenceSession(order.file, _options(order), providers=providers))
    _compare(order.inputs, order.integers, session.get_inputs(), lambda length: isinstance(length, str | None))
    _compare(order.outputs, order.integers, session.get_outputs(), lambda length: True)
    if not order.runs:
        return {}
    with np.load(folder / INPUTS) as file:
        inputs = dict(file)
    outputs = _guarded("run", lambda: session.run(list(order.outputs), inputs))
    return dict(zip(order.outputs, outputs, strict=True))


def _options(order: GraphOrder) -> Any:
    """Options of least memory: IS-Net takes 0.9 GB with them, 1.4 GB without, and a fifth more processor time."""
    options = onnxruntime.SessionOptions()
    options.enable_cpu_mem_arena = options.enable_mem_pattern = False
    # Higher levels keep the weights of convolutions once more, in another layout.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.intra_op_num_threads, options.inter_op_num_threads = order.threads, 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # other jobs want the cores too
    options.log_severity_level = _ERRORS_ONLY
    return options


def _guarded(kind: str, call: Any) -> Any:
    """Call ONNX Runtime, and tell its lack of memory from its other errors, which are all of classes of their own."""
    try:
        return call()
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - its exceptions share no base class
        why = " ".join(_NOISE.sub(" ", str(error)).split())
        raise _Stop(
            "memory" if any(word in why.lower() for word in _OF_MEMORY) else kind, why[:_WHY_LENGTH].rstrip(". ")
        ) from None


def _compare(
    wanted: Mapping[str, Iterable[int]],
    integers: Iterable[str],
    found: Iterable[Any],
    may_be_free: Callable[[Any], bool],
) -> None:
    """Raises _Stop where a tensor is missing, or has another shape or type. Further outputs do no harm.

    may_be_free  whether a length in the file will do where the table leaves it open
    """
    there = {each.name: (list(each.shape), each.type.removeprefix("tensor(").removesuffix(")")) for each in found}
    for name, shape in wanted.items():
        lengths, kind = list(shape), "int64" if name in integers else "float"
        has, its_kind = there.get(name, ([], ""))
        fits = len(has) == len(lengths) and all(
            may_be_free(length) if one == FREE else length == one for one, length in zip(lengths, has, strict=True)
        )
        if not fits or its_kind != kind:
            shown = ", ".join("any" if one == FREE else str(one) for one in lengths)
            raise _Stop("tensors", f"{name} [{shown}] {kind}, {_named(there, name)}")


def _named(there: Mapping[str, tuple[list[Any], str]], name: str) -> str:
    """Name what the graph has instead of a tensor."""
    if name in there:
        shape, kind = there[name]
        return f"{name} {shape} {kind}"
    return ", ".join(sorted(there)) or "-"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
