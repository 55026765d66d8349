"""What a phone sent, normalised: a `Capture` is a cloud, posed RGB-D `Frame`s, `Photo`s, or one photo, an "image"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from services.edge.arrays import Bools, Bytes, Floats

CaptureKind = Literal["points", "rgbd", "photos", "image"]
ScaleConfidence = Literal["metric", "estimated", "unknown"]

MIN_PHOTOS = 3  # two views give no depth that a third confirms
AROUND = "take 15 to 30 photos around the thing, each overlapping the last by two thirds"


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
    """One depth image. Images load lazily, so a capture of hundreds of frames costs no memory.

    intrinsics       of the depth image
    camera_to_world  (4,4) float64, OpenCV axes (x right, y down, z forward), translation in metres; None: to be tracked
    load_depth_m     -> (H,W) float32 metres, 0 where unknown
    load_confidence  -> (H,W) float32 in [0,1], or None where the format has none
    load_rgb         -> (h,w,3) uint8 sRGB with the field of view of the depth image, any resolution, or None
    window_px        side of the window that a pixel's depth was found with: within it errors are alike. 1 for sensors
    """

    name: str
    intrinsics: Intrinsics
    camera_to_world: Floats | None
    load_depth_m: Callable[[], Floats]
    load_confidence: Callable[[], Floats] | None = None
    load_rgb: Callable[[], Bytes] | None = None
    window_px: int = 1


class LoadPhoto(Protocol):
    """The pixels of a photo, (h,w,3) uint8 sRGB as stored: not turned by the orientation tag, so that photos held
    upright and sideways share one camera. `longest` scales the longer side down to at most that many pixels."""

    def __call__(self, longest: int | None = None) -> Bytes: ...


@dataclass(frozen=True, slots=True)
class Photo:
    """One picture, read when asked for: 300 of them cost no memory.

    name             file inside the capture
    size             (width, height) in pixels as stored
    camera           what photos have in common that one camera took at one focal length and size
    focal_px         focal length in pixels at `size` as the file tells it, or None
    turns            quarter turns clockwise that bring the stored picture upright: 0 to 3
    intrinsics       of the picture at `size`, or None where it is to be solved
    distortion       OpenCV's (k1, k2, p1, p2, k3), for photos with intrinsics
    camera_to_world  (4,4) float64, OpenCV axes, or None where it is to be solved
    load_alpha       -> (h,w) uint8 as stored, or None where the file turns out to have no alpha channel
    mask             (h,w) of any size, as stored: what of the picture may be used, or None for all of it
    """

    name: str
    size: tuple[int, int]
    camera: str
    load: LoadPhoto
    focal_px: float | None = None
    turns: int = 0
    intrinsics: Intrinsics | None = None
    distortion: tuple[float, ...] = ()
    camera_to_world: Floats | None = None
    load_alpha: Callable[[], Bytes | None] | None = None
    mask: Bools | None = None


PhotoFault = Literal["ok", "blur", "dark", "duplicate", "no_overlap", "unreadable"]


@dataclass(frozen=True, slots=True)
class PhotoVerdict:
    """What became of one photo; `advice` is a sentence for the person who took it, "" where it was used."""

    name: str
    verdict: PhotoFault
    advice: str = ""


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

    kind              "points" (cloud is set), "rgbd" (frames is not empty) or "photos" (photos is not empty)
    format            the detected format's name: "ply", "pcd", "record3d", "tum", ...
    verdicts          of the photos that reading alone refused, of kind "photos"
    metres_per_unit   metres per unit of the capture frame, as far as known
    scale_confidence  "metric" where format or sensor guarantee it, "unknown" for a bare cloud
    up                (3,) unit vector against gravity in the capture frame, or None when nothing tells
    turntable         whether the thing turned and the cameras stand for how: nothing but it and its plate is there
    warnings          sentences for the report: frames skipped, points dropped, ...
    """

    kind: CaptureKind
    format: str
    cloud: Cloud | None = None
    frames: tuple[Frame, ...] = ()
    photos: tuple[Photo, ...] = ()
    verdicts: tuple[PhotoVerdict, ...] = ()
    metres_per_unit: float = 1.0
    scale_confidence: ScaleConfidence = "unknown"
    up: Floats | None = None
    turntable: bool = False
    warnings: tuple[str, ...] = ()
