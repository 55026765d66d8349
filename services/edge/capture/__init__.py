"""Captures: what phones upload, read, checked and normalised to one `Capture`."""

from __future__ import annotations

from services.edge.capture.detect import read_capture
from services.edge.capture.nouns import (
    Capture,
    CaptureKind,
    Cloud,
    Frame,
    Intrinsics,
    ScaleConfidence,
)

__all__ = ["Capture", "CaptureKind", "Cloud", "Frame", "Intrinsics", "ScaleConfidence", "read_capture"]
