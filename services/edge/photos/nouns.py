"""What is known of photos once their cameras are: posed `View`s and the sparse points that they share."""

from __future__ import annotations

from dataclasses import dataclass

from services.edge.arrays import Floats, Ints
from services.edge.capture.nouns import Intrinsics, Photo, PhotoVerdict


@dataclass(frozen=True, slots=True)
class View:
    """A photo with its camera.

    intrinsics       of the photo at its stored size, behind the lens's distortion
    distortion       OpenCV's (k1, k2, p1, p2, k3)
    camera_to_world  (4,4) float64, OpenCV axes, in units of the alignment
    """

    photo: Photo
    intrinsics: Intrinsics
    distortion: tuple[float, float, float, float, float]
    camera_to_world: Floats


@dataclass(frozen=True, slots=True)
class Alignment:
    """The cameras of a capture and the points that they agree on.

    views        the photos that could be placed, in the order of the capture
    xyz          (P,3) float64 sparse points
    seen_point, seen_view  (T,) which point was seen in which view: one row for every observation
    error_px     mean distance between an observation and its point's projection, pixels of the features' pictures
    verdicts     of every photo that went in, placed or not
    warnings     sentences for the report
    """

    views: tuple[View, ...]
    xyz: Floats
    seen_point: Ints
    seen_view: Ints
    error_px: float
    verdicts: tuple[PhotoVerdict, ...]
    warnings: tuple[str, ...] = ()
