"""Small ONNX graphs with MoGe-2's tensors: the photo's colours are the depth, seen by a camera that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.models.moge import TOKENS
from tests.support.photos.mask_graphs import model_of, node

IMAGE = ["batch", 3, "height", "width"]
_OPSET = 15


@dataclass(frozen=True)
class Seen:
    """What a graph makes of a photo.

    near, span  depth in metres where red and green are 0, and how much deeper all of red is; green is 255 times finer
    focal       in halves of the diagonal
    factor      metres of the graph's unit; shift: of its points along the optical axis, in that unit
    bend        by which its normals lean to the sides, with the place in the picture; facing: their z before
    """

    near: float = 0.8
    span: float = 0.5
    focal: float = 1.3
    factor: float = 2.5
    shift: float = 0.11
    bend: tuple[float, float] = (0.0, 0.0)
    facing: float = -1.0

    def painted(self, depth: Floats, surface: Bools | None = None) -> Bytes:
        """The photo (h,w,3) that has this depth in metres, with blue where there is a surface."""
        levels = ((depth - self.near) / self.span * 255).clip(0, 255.99)
        red = np.floor(levels)
        blue = np.full(depth.shape, 255) if surface is None else np.where(surface, 255, 0)
        return np.stack([red, np.floor((levels - red) * 255), blue], axis=-1).astype(np.uint8)

    def depth_of(self, rgb: Bytes) -> Floats:
        """Depth (h,w) in metres of a photo."""
        return np.asarray(self.near + self.span * (rgb[..., 0] / 255 + rgb[..., 1] / 255**2), np.float64)

    def focal_px(self, shape: tuple[int, ...]) -> float:
        return float(self.focal * np.hypot(*shape[:2]) / 2)

    def graph(self, **changes: Any) -> bytes:
        """The graph; its metres count for `TOKENS` patches alone. changes: of its inputs, as `model_of` has them"""
        nodes, constants = _places()
        constants |= {
            "weights": np.array([1, 1 / 255, 0], np.float32)[None, :, None, None] * self.span / self.factor,
            "near": self.near / self.factor, "shift": self.shift, "by": 1 / self.focal, "facing": self.facing,
            "bend x": self.bend[0], "bend y": self.bend[1], "share": self.factor / TOKENS,
            "one": np.array([1], np.int64), "last": np.array([-1], np.int64),
            "front": np.array([0], np.int64), "blue": np.array([2], np.int64), "end": np.array([3], np.int64),
        }  # fmt: skip
        nodes += [
            node("Mul", ("image", "weights"), "weighted"),
            node("ReduceSum", ("weighted", "one"), "code", keepdims=0),
            node("Add", ("code", "near"), "z"),
            node("Mul", ("z", "by"), "z over f"),
            node("Mul", ("z over f", "u"), "x"),
            node("Mul", ("z over f", "v"), "y"),
            node("Sub", ("z", "shift"), "shifted"),
            *_stacked(("x", "y", "shifted"), "points"),
            node("Mul", ("z", "zero"), "nothing"),
            node("Mul", ("u", "bend x"), "lean x"),
            node("Mul", ("v", "bend y"), "lean y"),
            *(node("Add", ("nothing", name), f"normal {name}") for name in ("lean x", "lean y", "facing")),
            *_stacked(("normal lean x", "normal lean y", "normal facing"), "leaning"),
            node("ReduceL2", ("leaning",), "length", axes=[-1]),
            node("Div", ("leaning", "length"), "normal"),
            node("Slice", ("image", "blue", "end", "one"), "surface"),
            node("Squeeze", ("surface", "one"), "mask"),
            node("Cast", ("num_tokens",), "count", to=1),
            node("Mul", ("count", "share"), "metres"),
            node("Unsqueeze", ("metres", "front"), "scale"),
        ]
        kept = {name: np.asarray(value, None if isinstance(value, np.ndarray) else np.float32)
                for name, value in constants.items()}  # fmt: skip
        inputs = {"image": ("FLOAT", IMAGE), "num_tokens": ("INT64", [])}
        outputs = {name: ("FLOAT", [None] * rank) for name, rank in _RANKS.items()}
        return model_of(nodes, kept, {**inputs, **changes}, outputs, _OPSET)


_RANKS = {"points": 4, "normal": 4, "mask": 3, "scale": 1}


def _places() -> tuple[list[Any], dict[str, Any]]:
    """Places u (1,w) and v (h,1) of the pixels, in halves of the diagonal from the picture's middle."""
    nodes = [node("Shape", ("image",), "sides"), node("Cast", ("sides",), "lengths", to=1)]
    for name, at in (("h", "2"), ("w", "3")):
        nodes += [
            node("Gather", ("lengths", at), name),
            node("Mul", (name, name), f"{name} squared"),
            node("Range", ("zero", name, "step"), f"{name} range"),
            node("Add", (f"{name} range", "half"), f"{name} middles"),
            node("Mul", (f"{name} middles", "two"), f"{name} doubled"),
            node("Sub", (f"{name} doubled", name), f"{name} centred"),
        ]
    nodes += [
        node("Add", ("h squared", "w squared"), "squared"),
        node("Sqrt", ("squared",), "diagonal"),
        node("Div", ("h centred", "diagonal"), "v flat"),
        node("Div", ("w centred", "diagonal"), "u flat"),
        node("Unsqueeze", ("v flat", "one"), "v"),
        node("Unsqueeze", ("u flat", "front"), "u"),
    ]
    return nodes, {
        "2": np.array(2, np.int64),
        "3": np.array(3, np.int64),
        "zero": 0.0,
        "step": 1.0,
        "half": 0.5,
        "two": 2.0,
    }


def _stacked(names: tuple[str, str, str], output: str) -> list[Any]:
    """Stack three tensors along a new last axis."""
    parts = [node("Unsqueeze", (name, "last"), f"{name} for {output}") for name in names]
    return [*parts, node("Concat", [f"{name} for {output}" for name in names], output, axis=-1)]
