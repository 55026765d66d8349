"""A model's graph runs in a process of its own: each fault of file, runtime or graph is one sentence with a remedy."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.jobs.reading_limits import limited_reading
from capture2vr.edge.models.card import model_cards
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.isnet import SIDE
from capture2vr.edge.models.nouns import ModelError
from tests.support.command_lines import children_running
from tests.support.patience import CANCEL_S
from tests.support.photos import mask_graphs
from tests.support.photos.mask_graphs import card_of, graph_of, node, require_onnx, run_here, scaled_channel

CHILD = "capture2vr.edge.models.graph_child"
SMALL = [1, 3, 512, 512], [1, 1, 512, 512]


def graph_in(folder: Path, content: bytes, device: str = "cpu", **changes: object) -> Graph:
    card = card_of(content, **changes)
    file = folder / card.file
    file.write_bytes(content)
    return Graph(card, file, device)


def inputs() -> dict[str, Floats]:
    return {"input": np.random.default_rng(5).uniform(-0.5, 0.5, (1, 3, SIDE, SIDE)).astype(np.float32)}


def fails(graph: Graph) -> ModelError:
    with pytest.raises(ModelError) as caught:
        graph.run(inputs())
    assert len(caught.value.hints) == 1
    assert "\n" not in caught.value.with_remedy
    return caught.value


def test_the_table_can_be_used() -> None:
    for card in model_cards().values():
        assert re.fullmatch(r"[a-z0-9.-]+\.onnx", card.file)
        assert re.fullmatch(r"[0-9a-f]{64}", card.sha256)
        assert card.bytes < card.most_bytes
        assert card.inputs
        assert card.outputs


@pytest.mark.parametrize("cut", [0, 10])
def test_a_file_that_is_cut_off_is_said_to_be(tmp_path: Path, cut: int) -> None:
    graph = graph_in(tmp_path, b"x" * cut, bytes=4096)
    with pytest.raises(ModelError, match=f"is cut off: it has {cut} of 4,096 bytes") as caught:
        graph.check_file()
    assert caught.value.hints == ("`capture2vr models get isnet --accept-licence` brings its file again",)


def test_another_file_of_the_same_length_is_told_by_its_hash(tmp_path: Path) -> None:
    graph = graph_in(tmp_path, b"a" * 100, sha256="0" * 64)
    with pytest.raises(
        ModelError, match=r"not the one that is known: its SHA-256 begins with 28165978\w+, not with 0{12}"
    ):
        graph.check_file()


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "isnet.onnx").mkdir()
    graph = ModelFolder(tmp_path).find("isnet")
    assert graph is not None
    with pytest.raises(ModelError, match=r"isnet\.onnx cannot be read: Is a directory") as caught:
        graph.check_file()
    assert caught.value.hints == ("let the worker read the files in the folder EDGE_MODELS",)


def test_a_model_that_is_not_there_is_no_fault_but_a_folder_that_is_not_is_one(tmp_path: Path) -> None:
    assert ModelFolder(tmp_path).find("isnet") is None
    with pytest.raises(ModelError, match="the folder of learned models cannot be read: No such file") as caught:
        ModelFolder(tmp_path / "gone").find("isnet")
    assert str(tmp_path) not in caught.value.with_remedy  # phones see it


def test_without_onnx_runtime_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.models.graph.find_spec", lambda name: None)
    error = fails(graph_in(tmp_path, b"never read"))
    assert (error.code, error.message) == ("MODEL_UNAVAILABLE", "IS-Net needs ONNX Runtime, which is not installed")
    assert error.hints == ("install the extra capture2vr[models] where the worker runs",)


@pytest.mark.slow
@pytest.mark.essential
def test_the_child_gives_what_onnx_runtime_gives_here(tmp_path: Path) -> None:
    require_onnx()
    content, heard = scaled_channel(1), list[float]()
    graph = graph_in(tmp_path, content)
    graph.check()
    found = graph.run(inputs(), heard.append)["output"]
    assert np.array_equal(found, run_here(content)(inputs(), heard.append)["output"])
    assert heard == sorted(heard)
    assert graph.used.sha256 == card_of(content).sha256


FAULTS: dict[str, tuple[Callable[[], bytes], dict[str, object], str, str]] = {
    "opset": (
        lambda: graph_of([node("Identity", ("input",), "output")], opset=999),
        {},
        "MODEL_UNAVAILABLE",
        "ONNX Runtime cannot load its file: .*opset",
    ),
    "no graph": (lambda: b"\x08\x08 no graph", {}, "MODEL_UNAVAILABLE", "ONNX Runtime cannot load its file"),
    "shape": (
        lambda: graph_of([node("ReduceMean", ("input",), "output", axes=[1])], shapes=SMALL),
        {},
        "MODEL_UNAVAILABLE",
        r"input \[1, 3, 1024, 1024\] float, input \[1, 3, 512, 512\] float",
    ),
    "type": (
        lambda: graph_of([node("ReduceMean", ("input",), "output", axes=[1])], kind="FLOAT16"),
        {},
        "MODEL_UNAVAILABLE",
        r"input \[1, 3, 1024, 1024\] float16",
    ),
    "name": (
        lambda: scaled_channel(0),
        {"outputs": {"mask": (1, 1, SIDE, SIDE)}},
        "MODEL_UNAVAILABLE",
        r"mask \[1, 1, 1024, 1024\] float, output",
    ),
    "not finite": (mask_graphs.not_finite, {}, "MODEL_FAILED", "IS-Net gave numbers that are not finite"),
    "memory": (mask_graphs.hungry, {}, "MODEL_FAILED", "needs more than 1.3 GB of memory"),
    "time": (mask_graphs.endless, {"most_s": 5.0}, "MODEL_FAILED", "IS-Net took more than 5 s"),
    "at run": (mask_graphs.out_of_bounds, {}, "MODEL_FAILED", "ONNX Runtime cannot run it: .*out of"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_with_a_graph_is_one_sentence_with_a_remedy(tmp_path: Path, name: str) -> None:
    require_onnx()
    make, changes, code, words = FAULTS[name]
    error = fails(graph_in(tmp_path, make(), **changes))
    assert error.code == code
    assert re.search(words, error.message), error.message
    assert str(tmp_path) not in error.message
    assert "onnxruntime_src" not in error.message


@pytest.mark.slow
def test_who_no_longer_wants_it_stops_the_child(tmp_path: Path) -> None:
    require_onnx()
    graph, began = graph_in(tmp_path, mask_graphs.endless()), time.monotonic()

    def stop(_: float) -> None:
        if children_running(CHILD):
            raise Cancelled

    with pytest.raises(Cancelled):
        graph.run(inputs(), stop)
    assert time.monotonic() - began < CANCEL_S
    assert children_running(CHILD) == []


@pytest.mark.slow
def test_an_inspection_s_limits_are_not_the_model_s(tmp_path: Path) -> None:
    """They are for what a capture may cost; the graph is the operator's own, and has limits of its own."""
    require_onnx()
    graph = graph_in(tmp_path, scaled_channel(0))
    with limited_reading(tmp_path):
        assert graph.run(inputs())["output"].shape == (1, 1, SIDE, SIDE)


@pytest.mark.slow
def test_without_the_gpu_that_was_named_the_cpu_computes(tmp_path: Path) -> None:
    require_onnx()
    graph = graph_in(tmp_path, scaled_channel(0), "cuda:0")
    assert graph.run(inputs())["output"].shape == (1, 1, SIDE, SIDE)
