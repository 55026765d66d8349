"""Small ONNX graphs with IS-Net's tensors whose outputs are known, and a model folder that has one of them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.models.card import ModelCard, model_cards
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.isnet import SIDE
from capture2vr.edge.models.nouns import RunGraph
from tests.conftest import missing

IN, OUT = [1, 3, SIDE, SIDE], [1, 1, SIDE, SIDE]
_OPSET, _IR = 15, 8  # IS-Net's own


def require_onnx() -> None:
    """Skip (fail in CI) where the extra `models`, or what writes graphs, is not installed."""
    try:
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
    except ImportError:
        missing("the extra models, and onnx")


def graph_of(
    nodes: Sequence[Any],
    constants: Mapping[str, Any] | None = None,
    *,
    shapes: tuple[list[int], list[int]] = (IN, OUT),
    kind: str = "FLOAT",
    opset: int = _OPSET,
) -> bytes:
    """A graph from nodes between `input` and `output`."""
    ends = ({name: (kind, shape)} for name, shape in zip(("input", "output"), shapes, strict=True))
    return model_of(nodes, constants or {}, *ends, opset)


Tensors = Mapping[str, tuple[str, Sequence[int | str | None]]]
"""Types and shapes of tensors by name."""


def model_of(
    nodes: Sequence[Any], constants: Mapping[str, Any], inputs: Tensors, outputs: Tensors, opset: int
) -> bytes:
    """A graph from nodes between its inputs and its outputs."""
    from onnx import TensorProto, helper, numpy_helper

    ends = [
        [helper.make_tensor_value_info(name, getattr(TensorProto, kind), shape) for name, (kind, shape) in side.items()]
        for side in (inputs, outputs)
    ]
    kept = [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()]
    graph = helper.make_graph(list(nodes), "known", *ends, kept)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=_IR)
    return bytes(model.SerializeToString())


def node(kind: str, inputs: Sequence[str], output: str, **attributes: Any) -> Any:
    """A node of a graph."""
    from onnx import helper

    return helper.make_node(kind, list(inputs), [output], **attributes)


def _channel(at: int) -> tuple[list[Any], dict[str, Any]]:
    """Take one channel of the input as `channel`, in [-0.5,0.5)."""
    bounds = {"first": [at], "end": [at + 1], "axis": [1]}
    return [node("Slice", ("input", "first", "end", "axis"), "channel")], {
        name: np.array(value, np.int64) for name, value in bounds.items()
    }


def scaled_channel(at: int, scale: float = 1.0, shift: float = 0.0) -> bytes:
    """The mask is a channel of the photo, of 0…1, times `scale` plus `shift`."""
    nodes, constants = _channel(at)
    nodes += [node("Mul", ("channel", "by"), "times"), node("Add", ("times", "plus"), "output")]
    by, plus = 256 / 255 * scale, 128 / 255 * scale + shift
    return graph_of(nodes, {**constants, "by": np.float32(by), "plus": np.float32(plus)})


def constant_mask(mask: Floats) -> bytes:
    """The mask is always this one, (SIDE,SIDE) or what is broadcast to it, whatever the photo shows."""
    nodes, constants = _channel(0)
    nodes += [node("Mul", ("channel", "zero"), "nothing"), node("Add", ("nothing", "mask"), "output")]
    return graph_of(nodes, {**constants, "zero": np.float32(0), "mask": np.asarray(mask, np.float32)})


def not_finite() -> bytes:
    """The mask is the logarithm of a negative number."""
    nodes, constants = _channel(0)
    return graph_of([*nodes, node("Sub", ("channel", "one"), "less"), node("Log", ("less",), "output")], {
        **constants, "one": np.float32(1)
    })  # fmt: skip


def hungry() -> bytes:
    """The mask is a sum over 32 GB."""
    nodes, constants = _channel(0)
    many = np.array([8192, 1, SIDE, SIDE], np.int64)
    nodes += [
        node("Expand", ("channel", "many"), "copies"),
        node("Neg", ("copies",), "turned"),
        node("ReduceMean", ("turned",), "output", axes=[0], keepdims=1),
    ]
    return graph_of(nodes, {**constants, "many": many})


def endless() -> bytes:
    """The mask is what a loop of a thousand billion rounds leaves."""
    from onnx import TensorProto, helper

    names = (("round", TensorProto.INT64, []), ("go", TensorProto.BOOL, []), ("in", TensorProto.FLOAT, OUT))
    left = (("on", TensorProto.BOOL, []), ("out", TensorProto.FLOAT, OUT))
    body = helper.make_graph(
        [node("Identity", ("go",), "on"), node("Sin", ("in",), "out")],
        "body",
        [helper.make_tensor_value_info(*each) for each in names],
        [helper.make_tensor_value_info(*each) for each in left],
    )
    nodes, constants = _channel(0)
    loop = node("Loop", ("rounds", "always", "channel"), "output", body=body)
    return graph_of([*nodes, loop], {**constants, "rounds": np.int64(10**12), "always": np.bool_(True)})


def out_of_bounds() -> bytes:
    """The mask is the sixth of two, which shows only when the graph is run."""
    from onnx import TensorProto

    nodes = [
        node("Mul", ("input", "zero"), "nothing"),
        node("ReduceMax", ("nothing",), "none", keepdims=0),
        node("Add", ("none", "sixth"), "number"),
        node("Cast", ("number",), "at", to=TensorProto.INT64),
        node("Gather", ("masks", "at"), "output", axis=0),
    ]
    masks = np.zeros((2, 1, SIDE, SIDE), np.float32)
    return graph_of(nodes, {"zero": np.float32(0), "sixth": np.array([5], np.float32), "masks": masks})


def run_here(graph: bytes) -> RunGraph:
    """Run a graph in this process, as `Graph.run` does in a child."""
    import onnxruntime

    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    names = [each.name for each in session.get_outputs()]
    return lambda inputs, tick: dict(zip(names, session.run(names, dict(inputs)), strict=True))


def card_of(graph: bytes, name: str = "isnet", **changes: Any) -> ModelCard:
    """A row of the table, by default IS-Net's, for another file."""
    known = {"sha256": hashlib.sha256(graph).hexdigest(), "bytes": len(graph)}
    return replace(model_cards()[name], **{**known, **changes})


def folder_with(
    folder: Path, graph: bytes, patch: pytest.MonkeyPatch, name: str = "isnet", **changes: Any
) -> ModelFolder:
    """Make a folder in which this graph is a model of the table, by default IS-Net."""
    card = card_of(graph, name, **changes)
    table = {**model_cards(), card.name: card}
    patch.setattr("capture2vr.edge.models.folder.model_cards", lambda: table)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / card.file).write_bytes(graph)
    return ModelFolder(folder)
