"""What a manifest tells of a capture, and whether the shape that is made of it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from capture2vr.edge.capture.nouns import Capture, CaptureKind, PhotoVerdict

Origin = Literal["measured", "guess", "generated"]
"""Where a shape is from. measured: from depths or several views; guess: one photo's outline, inflated; generated: made
up by a generator that was shown one photo."""


@dataclass(frozen=True, slots=True)
class CaptureFacts:
    """The manifest's facts about a capture: kind, format, number of frames or photos, each photo's verdict, and whether
    a generator made the shape."""

    kind: CaptureKind
    format: str
    frames: Annotated[int, Field(ge=0)]
    verdicts: tuple[PhotoVerdict, ...] = ()
    generated: bool = False

    @classmethod
    def of(cls, capture: Capture, *, generated: bool = False) -> CaptureFacts:
        """Summarise a capture: its kind, format and number of frames or points, for reports."""
        frames = len(capture.frames) or len(capture.photos)
        return cls(capture.kind, capture.format, frames, capture.verdicts, generated)

    @property
    def origin(self) -> Origin:
        """Where the shape is from. Only what was measured has a grade: others were made to look like their photo."""
        if self.generated:
            return "generated"
        return "guess" if self.kind == "image" else "measured"
