"""Data types of a capture after reading: a point `Cloud`, RGB-D `Frame`s, `Photo`s, or one photo ("image")."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Protocol

from pydantic import ConfigDict, Field

from capture2vr.edge.arrays import Bools, Bytes, Floats, pick
from capture2vr.sentences.sentence import say

CaptureKind = Literal["points", "rgbd", "photos", "image"]
ScaleConfidence = Literal["metric", "estimated", "unknown"]

MIN_PHOTOS = 3  # depth from two views needs a third view that confirms it
FEW_PHOTOS = 8  # up to so many are used as far as they can be placed, however few of them; of none, one may be a relief
WALK_AROUND_ADVICE = say("take_15_to_30_photos")


UpTeller = Literal["person", "app", "gravity", "turntable", "lines", "walk", "plane", "cameras"]
"""What tells which way is up. person: the edits; app: the format or the app, from its sensors; gravity: the photos'
metadata; turntable: its axis; lines: vertical lines in the pictures; walk: the plane of the cameras' way; plane: a
floor, a table or what the thing stands on; cameras: how they were held."""


@dataclass(frozen=True, slots=True)
class UpSource:
    """What told which way is up, and its confidence: 1 for certain, 0 for an error of `_WORST_UP_DEG` or more."""

    teller: UpTeller
    confidence: Annotated[float, Field(ge=0, le=1)]

    @property
    def error_deg(self) -> float:
        """The expected error in degrees."""
        return (1 - self.confidence) * _WORST_UP_DEG


_WORST_UP_DEG = 10.0  # a lean that everybody sees
APP_UP = UpSource("app", 0.95)  # a phone's fusion of its sensors: within half a degree


def certainty(error_deg: float) -> float:
    """Return the confidence of an up direction with this expected error: 1 for none, 0 from `_WORST_UP_DEG` on."""
    return round(max(0.0, 1 - float(error_deg) / _WORST_UP_DEG), 3)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole camera parameters in pixels of an image of `width` x `height`; pixel centres are at integers."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def scaled_to(self, width: int, height: int) -> Intrinsics:
        """Return the intrinsics of the same camera and field of view for images of another resolution."""
        sx, sy = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return Intrinsics(self.fx * sx, self.fy * sy, cx, cy, width, height)


_Row = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class PictureCamera:
    """Camera of a picture as the capture has it: not turned upright, not undistorted, at its full size.

    name             file inside the capture
    size             (width, height) in pixels
    camera           fx, fy, cx, cy in pixels; pixel centres are at integers
    distortion       OpenCV's (k1, k2, p1, p2, k3)
    camera_to_world  first three rows of the pose: OpenCV axes, capture frame
    turns            clockwise quarter turns from the picture to the upright one
    part             left, top, right, bottom of what it shows of its file's picture, as shares of that one's sides
    """

    name: str
    size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    camera: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], float, float]
    distortion: tuple[float, float, float, float, float]
    camera_to_world: tuple[_Row, _Row, _Row]
    turns: Annotated[int, Field(ge=0, le=3)] = 0
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class ShownPicture:
    """The upright picture that a person sees of a frame.

    name        its file inside the capture
    to_upright  positions (N,2) in the frame's images -> positions (N,2) in the upright picture, both as shares of width
                and height: (0, 0) is the top left corner of the top left pixel
    """

    name: str
    to_upright: Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True)
class Frame:
    """A depth image with its camera and, where known, pose and colours. Images load lazily: hundreds cost no memory.

    intrinsics       of the depth image
    camera_to_world  (4,4) float64, OpenCV axes (x right, y down, z forward), translation in metres; None: to be tracked
    load_depth_m     -> (H,W) float32 metres, 0 where unknown
    load_confidence  -> (H,W) float32 in [0,1], or None where the format has none
    load_rgb         -> (h,w,3) uint8 sRGB with the field of view of the depth image, any resolution, or None
    window_px        side of the window that stereo matched per pixel: depth errors within it correlate; 1 for sensors
    picture          camera of the photo that it was made from; None for depth cameras
    shown            the upright picture that a person sees, where that is a file or a key frame; None otherwise
    load_mask        -> (H,W) bool, where the object is, of the same field of view; None where no mask came with it
    """

    name: str
    intrinsics: Intrinsics
    camera_to_world: Floats | None
    load_depth_m: Callable[[], Floats]
    load_confidence: Callable[[], Floats] | None = None
    load_rgb: Callable[[], Bytes] | None = None
    window_px: int = 1
    picture: PictureCamera | None = None
    shown: ShownPicture | None = None
    load_mask: Callable[[], Bools] | None = None


class LoadPhoto(Protocol):
    """Function that decodes a photo: (h,w,3) uint8 sRGB as stored, its longer side at most `longest` pixels.

    The EXIF orientation is not applied, so that portrait and landscape photos share one camera."""

    def __call__(self, longest: int | None = None) -> Bytes: ...


@dataclass(frozen=True, slots=True)
class Photo:
    """A photo with what is known of its camera. Pixels load lazily (`photo_copy`).

    name             file inside the capture
    size             (width, height) in pixels as stored
    camera           key that is equal for photos of one camera at one focal length and image size
    focal_px         focal length in pixels at `size` from the file's metadata, or None
    turns            clockwise quarter turns from the stored picture to the upright one: 0 to 3
    intrinsics       of the picture at `size`, or None where structure from motion has to compute them
    distortion       OpenCV's (k1, k2, p1, p2, k3), for photos with intrinsics
    camera_to_world  (4,4) float64, OpenCV axes, or None where structure from motion has to compute it
    load_alpha       -> (h,w) uint8 as stored, or None when decoding shows that the file has no alpha channel
    load_mask        -> (h,w) bool of any size, from a file of its own; None where the photo has no such file
    mask             (h,w) bool of any size, as stored: True where the picture may be used; None: everywhere
    up_in_camera     unit vector against gravity in the axes of the stored picture, or None where the file has none
    elevation_deg    of the optical axis over the horizon, or None where the file has none
    part             left, top, right, bottom of what it shows of the stored picture, as shares of that one's sides
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
    load_mask: Callable[[], Bools] | None = None
    mask: Bools | None = None
    up_in_camera: tuple[float, float, float] | None = None
    elevation_deg: float | None = None
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)


PhotoFault = Literal["ok", "blur", "dark", "duplicate", "no_overlap", "unreadable"]


@dataclass(frozen=True, slots=True)
class PhotoVerdict:
    """Whether a photo was used or why not. `advice` is a sentence for the photographer, "" where it was used."""

    name: str
    verdict: PhotoFault
    advice: str = ""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Point cloud as read from a file, in the capture's own frame and units.

    xyz (N,3) float64, finite; rgb (N,3) uint8 sRGB or None; normals (N,3) float32 unit length or None; notes: what
    is to be said of them; origin: what was subtracted from the file's coordinates (3,), which are of a survey, or None;
    crs: the coordinate reference system of xyz + origin, as well-known text or "EPSG:25832"; "" where it is unknown;
    of_table: of a table of numbers its first rows and what its columns were taken for, as a question's values.
    """

    xyz: Floats
    rgb: Bytes | None = None
    normals: Floats | None = None
    notes: tuple[str, ...] = ()
    origin: Floats | None = None
    crs: str = ""
    of_table: Mapping[str, Any] = field(default_factory=dict)

    def subset(self, which: Bools) -> Cloud:
        """Return the points where the mask `which` (N,) is True."""
        rgb, normals = pick(self.rgb, which), pick(self.normals, which)
        return replace(self, xyz=self.xyz[which], rgb=rgb, normals=normals)


@dataclass(frozen=True, slots=True)
class CloudParts:
    """All points of a cloud that is too large to be in memory at once, in parts.

    count  of all points
    read   -> the parts, one after the other, with xyz, and rgb in all of them or in none; it can be called again
    """

    count: int
    read: Callable[[], Iterator[Cloud]]


@dataclass(frozen=True, slots=True)
class Capture:
    """A capture that was read and validated.

    kind              "points" (cloud is set), "rgbd" (frames is not empty), "photos" (photos is not empty) or
                      "image" (photos has one photo)
    format            the detected format's name: "ply", "pcd", "record3d", "tum", ...
    whole             all points where `cloud` holds only some of them
    verdicts          on the photos that could not be read
    metres_per_unit   metres per unit of the capture frame, as far as known
    scale_confidence  "metric" where format or sensor guarantee it, "unknown" for a bare cloud
    up                (3,) unit vector against gravity in the capture frame, or None where it is unknown
    up_source         what told `up`, and how surely
    turntable         whether the object turned in front of a fixed camera: the poses are relative to it, and only it
                      and its plate are in the masks
    warnings          sentences for the report: frames skipped, points dropped, ...
    """

    kind: CaptureKind
    format: str
    cloud: Cloud | None = None
    whole: CloudParts | None = None
    frames: tuple[Frame, ...] = ()
    photos: tuple[Photo, ...] = ()
    verdicts: tuple[PhotoVerdict, ...] = ()
    metres_per_unit: float = 1.0
    scale_confidence: ScaleConfidence = "unknown"
    up: Floats | None = None
    up_source: UpSource = APP_UP
    turntable: bool = False
    warnings: tuple[str, ...] = ()
