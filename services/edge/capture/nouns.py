"""What a phone sent, normalised: a `Capture` is a point cloud or a list of posed RGB-D `Frame`s."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from services.edge.arrays import Bytes, Floats

CaptureKind = Literal["points", "rgbd"]
ScaleConfidence = Literal["metric", "estimated", "unknown"]


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole camera in pixels of an image `width` x `height`; pixel centres at integers."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def scaled_to(self, width: int, height: int) -> Intrinsics:
        """The same camera for the same field of view at another resolution."""
        sx, sy = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return Intrinsics(self.fx * sx, self.fy * sy, cx, cy, width, height)


@dataclass(frozen=True, slots=True)
class Frame:
    """One posed depth image. Images load lazily, so a capture of hundreds of frames costs no memory.

    intrinsics       of the depth image
    camera_to_world  (4,4) float64, OpenCV axes (x right, y down, z forward), translation in metres
    load_depth_m     -> (H,W) float32 metres, 0 where unknown
    load_confidence  -> (H,W) float32 in [0,1], or None where the format has none
    load_rgb         -> (h,w,3) uint8 sRGB with the field of view of the depth image, any resolution, or None
    """

    name: str
    intrinsics: Intrinsics
    camera_to_world: Floats
    load_depth_m: Callable[[], Floats]
    load_confidence: Callable[[], Floats] | None = None
    load_rgb: Callable[[], Bytes] | None = None


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points as read from files: capture frame and units.

    xyz (N,3) float64, finite; rgb (N,3) uint8 sRGB or None; normals (N,3) float32 unit length or None.
    """

    xyz: Floats
    rgb: Bytes | None = None
    normals: Floats | None = None


@dataclass(frozen=True, slots=True)
class Capture:
    """A validated capture.

    kind              "points" (cloud is set) or "rgbd" (frames is not empty)
    format            the detected format's name: "ply", "pcd", "record3d", "tum", ...
    metres_per_unit   metres per unit of the capture frame, as far as known
    scale_confidence  "metric" where format or sensor guarantee it, "unknown" for a bare cloud
    up                (3,) unit vector against gravity in the capture frame, or None when nothing tells
    warnings          sentences for the report: frames skipped, points dropped, ...
    """

    kind: CaptureKind
    format: str
    cloud: Cloud | None = None
    frames: tuple[Frame, ...] = ()
    metres_per_unit: float = 1.0
    scale_confidence: ScaleConfidence = "unknown"
    up: Floats | None = None
    warnings: tuple[str, ...] = ()
