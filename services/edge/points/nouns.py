"""Points that a field can be fitted to, and the frame in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from services.edge.arrays import Bytes, Floats
from services.edge.capture.nouns import Intrinsics, ScaleConfidence


@dataclass(frozen=True, slots=True)
class Unseen:
    """A side of the thing that the capture shows too little of.

    advice  a sentence for the person: from where to shoot
    toward  unit vector in the capture frame, from the thing's middle to where the camera should go
    share   of the thing's surface that is seen too little from there, in (0,1]
    """

    advice: str
    toward: tuple[float, float, float]
    share: float


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture that shows the thing, read when asked for: it costs no memory.

    intrinsics       of the field of view, at any resolution
    camera_to_world  (4,4) float64, OpenCV axes, capture frame
    load_rgb         -> (h,w,3) uint8 sRGB
    load_depth_m     -> (H,W) float32 of the same field of view, units of the capture, 0 where unknown
    """

    intrinsics: Intrinsics
    camera_to_world: Floats
    load_rgb: Callable[[], Bytes]
    load_depth_m: Callable[[], Floats]


@dataclass(frozen=True, slots=True)
class Points:
    """Clean points in the capture frame and its units.

    xyz (N,3) float64; rgb (N,3) uint8 sRGB or None; confidence (N,) float32 in [0,1];
    metres_per_unit, scale_confidence, up as in `Capture`; warnings: sentences for the report;
    unseen: sides to shoot again, the largest first; shots: sharp pictures from all sides, for textures, as long as the
    capture lies on this machine's disk.
    """

    xyz: Floats
    rgb: Bytes | None
    confidence: Floats
    metres_per_unit: float
    scale_confidence: ScaleConfidence
    up: Floats | None
    warnings: tuple[str, ...] = ()
    unseen: tuple[Unseen, ...] = ()
    shots: tuple[Shot, ...] = ()

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True, slots=True)
class UnitFrame:
    """Bounding box centred at 0, longest side 1: xyz_unit = (xyz - centre) / size. Kept in the manifest, both ways."""

    centre: Floats
    size: float

    def to_unit(self, xyz: Floats) -> Floats:
        """(N,3) capture frame -> unit frame, float64."""
        unit: Floats = (xyz - self.centre) / self.size
        return unit

    def to_world(self, xyz_unit: Floats) -> Floats:
        """(N,3) unit frame -> capture frame, float64."""
        world: Floats = xyz_unit * self.size + self.centre
        return world
