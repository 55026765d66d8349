"""Data types of cleaned points, ready for fitting a distance field, and of the unit frame in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, pick
from capture2vr.edge.capture.nouns import (
    Cloud,
    CloudParts,
    Frame,
    Intrinsics,
    PictureCamera,
    ScaleConfidence,
    UpSource,
)
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.origin import MEASURED, told
from capture2vr.order.edits import NO_EDITS, Edits


@dataclass(frozen=True, slots=True)
class CutReport:
    """What was kept of a capture, and the largest removed part that may belong to it.

    kept     the object in the middle, or everything that was seen
    because  a sentence: why
    doubt    a sentence about a large part that was removed; "" where only surroundings were
    removed  points of that part over the points kept; 0 without one
    """

    kept: Literal["object", "scene"]
    because: str
    doubt: str = ""
    removed: Annotated[float, Field(ge=0)] = 0.0


@dataclass(frozen=True, slots=True)
class UnseenSide:
    """A side of the object that too few cameras see.

    advice  a sentence for the person: from where to shoot
    toward  unit vector in the capture frame, from the object's middle to where the camera should go
    share   of the object's surface that faces this side and is seen too little, in (0,1]
    """

    advice: str
    toward: tuple[float, float, float]
    share: float


@dataclass(frozen=True, slots=True)
class TextureView:
    """A photo or video frame, for texturing or for comparison, with its camera and depth. Images load lazily.

    intrinsics       for images of any resolution with the same field of view
    camera_to_world  (4,4) float64, OpenCV axes, capture frame
    load_rgb         -> (h,w,3) uint8 sRGB
    load_depth_m     -> (H,W) float32 of the same field of view, units of the capture, 0 where unknown
    name             of the photo or frame in the capture
    tracked          whether the pose is a device's tracking, which errs by pixels; poses from photos err by tenths
    load_mask        -> (H,W) bool, where the object is, of the same field of view; None where no mask came with it
    """

    intrinsics: Intrinsics
    camera_to_world: Floats
    load_rgb: Callable[[], Bytes]
    load_depth_m: Callable[[], Floats]
    name: str = ""
    tracked: bool = False
    load_mask: Callable[[], Bools] | None = None


@dataclass(frozen=True, slots=True)
class Points:
    """Point cloud after cleaning, in the capture frame and its units.

    xyz (N,3) float64; rgb (N,3) uint8 sRGB or None; confidence (N,) float32 in [0,1];
    metres_per_unit, scale_confidence, up, up_source as in `Capture`; warnings: sentences for the report;
    unseen: sides to photograph again, the largest first; texture_views: sharp pictures from all sides, for texturing;
    held_out_views: pictures that neither points nor textures are made from, to compare the result with;
    cut: what was kept, None where there was no choice;
    whole: all points of the capture where these are only some of them, without those that the edits cut away;
    scene_views: many more pictures than texture_views, all along a walk through a scene that has a `whole`, so that
    each part of it can be textured from those that show it;
    cameras: of all photos that could be placed, those that are held out too;
    uncut: some of the points that a cut was made from, None without one or where the capture is not on this machine;
    edits: the recipe that was applied;
    drawn_in: posed frames of the pictures that the recipe's lassos are in, until it is applied;
    origin (N,) uint8: which points were measured, proposed or filled, as `edge/origin.py`; None where all are measured;
    closed: whether the object has no true openings, as far as photos and inferred points tell;
    offset (3,): what was subtracted from the coordinates of a survey's file, which are large; None for others;
    crs: coordinate reference system of that file, of xyz + offset, as in `Cloud`;
    models: learned models that had a part in it;
    scale_by_model: whether the scale is what one of them estimates.
    """

    xyz: Floats
    rgb: Bytes | None
    confidence: Floats
    metres_per_unit: float
    scale_confidence: ScaleConfidence
    up: Floats | None
    warnings: tuple[str, ...] = ()
    unseen: tuple[UnseenSide, ...] = ()
    texture_views: tuple[TextureView, ...] = ()
    held_out_views: tuple[TextureView, ...] = ()
    cut: CutReport | None = None
    uncut: Cloud | None = None
    whole: CloudParts | None = None
    scene_views: tuple[TextureView, ...] = ()
    cameras: tuple[PictureCamera, ...] = ()
    up_source: UpSource | None = None
    edits: Edits = NO_EDITS
    drawn_in: tuple[Frame, ...] = ()
    origin: Bytes | None = None
    closed: bool = False
    offset: Floats | None = None
    crs: str = ""
    models: tuple[UsedModel, ...] = ()
    scale_by_model: bool = False

    def __len__(self) -> int:
        return len(self.xyz)

    def subset(self, which: Bools | Ints) -> Points:
        """Return the points of a mask or of indices; the fields about the whole cloud stay as they are."""
        return replace(
            self,
            xyz=self.xyz[which],
            rgb=pick(self.rgb, which),
            confidence=self.confidence[which],
            origin=pick(self.origin, which),
        )

    def joined(self, xyz: Floats, rgb: Bytes | None, confidence: Floats, origin: int) -> Points:
        """Return the points with more of them behind these, all of one origin."""
        known = np.full(len(self), MEASURED, np.uint8) if self.origin is None else self.origin
        return replace(
            self,
            xyz=np.concatenate([self.xyz, xyz]),
            rgb=None if self.rgb is None or rgb is None else np.concatenate([self.rgb, rgb]),
            confidence=np.concatenate([self.confidence, confidence]),
            origin=told(np.append(known, np.full(len(xyz), origin, np.uint8))),
        )

    @property
    def given(self) -> Bools:
        """Mask (N,) of the points that a surface is judged by: the measured ones; of a guess, which has none, all."""
        measured = np.ones(len(self), bool) if self.origin is None else self.origin == MEASURED
        return measured if measured.any() else ~measured

    @property
    def inferred(self) -> Bools | None:
        """Mask (N,) of the points that complete the given ones, where nobody measured any; None without any."""
        inferred = ~self.given
        return inferred if inferred.any() else None


@dataclass(frozen=True, slots=True)
class UnitFrame:
    """Transform to the frame in which the bounding box is centred at 0 with longest side 1, and back.

    xyz_unit = (xyz - centre) / size. The manifest has it.
    """

    centre: Floats
    size: float

    def to_unit(self, xyz: Floats) -> Floats:
        """Transform points (N,3) from the capture frame to the unit frame, float64."""
        unit: Floats = (xyz - self.centre) / self.size
        return unit

    def to_world(self, xyz_unit: Floats) -> Floats:
        """Transform points (N,3) from the unit frame to the capture frame, float64."""
        world: Floats = xyz_unit * self.size + self.centre
        return world
