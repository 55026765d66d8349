"""What learned models have in common: how one is asked about photos, what it proposes, and how it fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from capture2vr.edge.arrays import Bytes, Floats, Ints, Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.sentences.sentence import in_row


@dataclass(frozen=True, slots=True)
class UsedModel:
    """A model that had a part in a result: its name in the table, and its file's SHA-256 as the version."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class LearnedView:
    """What a model proposes of one photo, in the photo's own shape (h,w). It is never a measurement.

    mask     (h,w) float32 in [0,1], how surely a pixel shows the object; None where the model proposes none
    depth_m  (h,w) float32, metres along the optical axis, 0 where it sees no surface; None where it proposes none
    normals  (h,w,3) float32 unit vectors out of the surface, OpenCV axes, 0 where depth_m is; None as there
    focal_px focal length in pixels, the optical axis in the picture's middle; 0 where the model proposes none
    """

    mask: Floats | None = None
    depth_m: Floats | None = None
    normals: Floats | None = None
    focal_px: float = 0.0


RunGraph = Callable[[Mapping[str, Floats | Ints], Tick], Mapping[str, Floats]]
"""Runs a graph: tensors by name -> tensors by name. Raises ModelError."""


class LearnedViews(Protocol):
    """A learned model: it looks at photos together, and proposes something of each."""

    def __call__(self, photos: Sequence[Bytes], tick: Tick) -> tuple[LearnedView, ...]:
        """Look at upright photos (h,w,3) uint8 sRGB, each of its own size. Raises ModelError and what `tick` raises."""
        ...


class ModelError(EdgeError):
    """A model cannot be used, or fails: MODEL_UNAVAILABLE or MODEL_FAILED. A capture goes on without the model."""

    @property
    def with_remedy(self) -> str:
        """The message and what to do about it, as one sentence."""
        return in_row("; ", (self.message, *self.hints))
