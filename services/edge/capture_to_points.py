"""The first half of the method: capture (→ depth) → points, from which another worker may go on."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

from services.edge.capture.nouns import Capture, CaptureKind
from services.edge.photos import finer, to_depth
from services.edge.points import Points, to_points, with_longest
from services.edge.prepared import Prepared, Source
from services.edge.progress import Bar, Clock, Progress

# Where each stage begins on the bar's part up to the preview, from the seconds of a 10,000-point cloud and of an RGB-D
# room on two cores.
STARTS = {"VALIDATING": 0.0, "POINT_CLOUD": 0.05, "FITTING": 0.25}
# The same of photos, which have to become depth images first: that takes longer than all the rest.
PHOTO_STARTS = {"VALIDATING": 0.0, "ALIGNING": 0.01, "POINT_CLOUD": 0.62, "FITTING": 0.7}

PREVIEW_SHARE = 0.15
"""Of the bar up to the preview, where a second pass follows."""

_PHOTO_PREVIEW_SHARE = 0.6


def preview_share(kind: CaptureKind) -> float:
    """Of the bar up to the preview, where a second pass follows and the points are made on the same bar."""
    return _PHOTO_PREVIEW_SHARE if kind == "photos" else PREVIEW_SHARE


def prepare(
    capture: Capture,
    bar: Bar,
    *,
    refines: bool,
    device: str = "cpu",
    isolate: bool | None = None,
    longest_m: float | None = None,
) -> Generator[Progress, None, Prepared]:
    """Points of a capture; `bar` then stands where fitting begins. Arguments and errors as of `reconstruct`.

    refines  whether a second pass may follow the preview
    """
    clock = Clock()
    starts = PHOTO_STARTS if capture.kind == "photos" else STARTS
    bar.covers(starts, 0.0, preview_share(capture.kind) if refines else 1.0)
    source = Source.of(capture)
    if capture.kind == "photos":
        yield bar.starts("ALIGNING", f"{len(capture.photos)} photos")
        with clock("ALIGNING"):
            capture = to_depth(capture, device=device, tick=bar.inside("ALIGNING"))
            source = replace(source, verdicts=capture.verdicts)
    yield bar.starts("POINT_CLOUD", f"reading {source.format}")
    with clock("POINT_CLOUD"):
        points = _points(capture, isolate, bar)
        points = with_longest(points, longest_m) if longest_m else points
        points = replace(points, shots=tuple(replace(shot, load_rgb=finer(shot.load_rgb)) for shot in points.shots))
    bar.at("POINT_CLOUD", 1.0)
    return Prepared(points, source, clock.seconds)


def _points(capture: Capture, isolate: bool | None, bar: Bar) -> Points:
    if capture.kind == "image":
        from services.edge.guess.to_points import to_points as guessed_points  # loads torch

        return guessed_points(capture, tick=bar.inside("POINT_CLOUD"))
    return to_points(capture, isolate=isolate, tick=bar.inside("POINT_CLOUD"))
