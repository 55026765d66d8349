"""Collect the frames whose images cannot be decoded, or are empty, so that the others can be used without them."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.frame_records import MAX_BAD_SHARE, as_warnings
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.depth_limits import DepthLimits, DepthView, load_depth, read_view
from capture2vr.sentences.sentence import say

_NAMED = 3  # frames that a sentence names


@dataclass(frozen=True, slots=True)
class FrameFaults:
    """What was wrong with frames so far. Headers are checked when a capture is read; damage within, only here.

    undecodable  errors of depth images; colourless: of pictures; empty: names of frames without a pixel of depth
    """

    undecodable: list[CaptureError] = field(default_factory=list)
    colourless: list[CaptureError] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)

    def read_depth(self, frame: Frame) -> tuple[Floats, Floats, Intrinsics] | None:
        """Load a frame's depth, confidence and intrinsics, as `load_depth` does; None where it cannot be decoded."""
        try:
            return load_depth(frame)
        except CaptureError as error:
            self.undecodable.append(error)
            return None

    def read_view(self, frame: Frame, limits: DepthLimits) -> DepthView | None:
        """Load and filter a frame's depth; None where it cannot be decoded."""
        try:
            view = read_view(frame, limits)
        except CaptureError as error:
            self.undecodable.append(error)
            return None
        if not view.read:
            self.empty.append(frame.name)
        return view

    def read_picture(self, frame: Frame) -> Bytes | None:
        """Load a frame's picture; None where there is none, or where it cannot be decoded."""
        try:
            return None if frame.load_rgb is None else frame.load_rgb()
        except CaptureError as error:
            self.colourless.append(error)
            return None

    def check(self, frames: int) -> None:
        """Raise the first error when more than MAX_BAD_SHARE of the `frames` (and more than one) are undecodable."""
        if len(self.undecodable) > max(1, MAX_BAD_SHARE * frames):
            raise self.undecodable[0]

    def warnings(self, frames: int) -> tuple[str, ...]:
        """Sentences for the report that name the frames that were not used."""
        more = ", ..." if len(self.empty) > _NAMED else ""
        names = ", ".join(self.empty[:_NAMED]) + more
        empty = say("depth_images_empty_not_used", empty=len(self.empty), frames=frames, names=names)
        return (
            *as_warnings(say("frame_skipped"), self.undecodable),
            *as_warnings(say("colours_skipped"), self.colourless),
            *((empty,) if self.empty else ()),
        )
