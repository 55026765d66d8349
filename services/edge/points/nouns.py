"""Points that a field can be fitted to, and the frame in which it is fitted."""

from __future__ import annotations

from dataclasses import dataclass

from services.edge.arrays import Bytes, Floats
from services.edge.capture.nouns import ScaleConfidence


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
class Points:
    """Clean points in the capture frame and its units.

    xyz (N,3) float64; rgb (N,3) uint8 sRGB or None; confidence (N,) float32 in [0,1];
    metres_per_unit, scale_confidence, up as in `Capture`; warnings: sentences for the report;
    unseen: sides to shoot again, the largest first.
    """

    xyz: Floats
    rgb: Bytes | None
    confidence: Floats
    metres_per_unit: float
    scale_confidence: ScaleConfidence
    up: Floats | None
    warnings: tuple[str, ...] = ()
    unseen: tuple[Unseen, ...] = ()

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
