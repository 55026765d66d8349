"""Survey all frames of a large scene: which of them can be read, how sharp they are, and what part of space they see.

Some pixels of each frame stand for all of it: their rays tell which frames show a box, and which look through
it. That is 20 kB a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints, Tick
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.fusion.observe import at_resolution, back_project, sharpness_of
from capture2vr.edge.fusion.scene_boxes import within
from capture2vr.edge.fusion.viewing_distance import ViewingDistance
from capture2vr.edge.parallel import one_ahead
from capture2vr.edge.points.depth_limits import DepthLimits
from capture2vr.edge.points.frame_faults import FrameFaults

_RAYS = 1_600
"""Pixels of a frame that stand for all: at 2 m they are 5 cm apart."""


@dataclass(frozen=True, slots=True)
class SceneWalk:
    """The M frames of a large scene that can be read, and what they see.

    frames, sharpness (M,)   as of `FusedPoints`
    origin (3,)              capture frame, metres, that all places are relative to
    eyes (M,3) float32       positions of the cameras
    places (N,3) float32     surface points of the sampled pixels, frame by frame; owners (N,): their frames' indices
    distance                 from how near each part of the scene was seen; near (N,): the places that are needed
    """

    frames: tuple[Frame, ...]
    sharpness: Floats
    origin: Floats
    eyes: Floats
    places: Floats
    owners: Ints
    distance: ViewingDistance
    near: Bools

    def frames_that_show(self, low: Floats, high: Floats) -> Ints:
        """Indices of the frames with a surface point from `low` to `high` (3,) that no other saw from much nearer."""
        shown: Ints = np.unique(self.owners[within(self.places, low, high) & self.near])
        return shown

    def frames_that_look_through(self, low: Floats, high: Floats, most: int) -> Ints:
        """Indices of at most `most` frames with rays that end in a box or go through it.

        Of the twice as many with most such rays they are spread evenly over the way. Rays that see what others saw from
        much nearer do not count.
        """
        rays = np.bincount(self.owners[self._crosses(low, high) & self.near], minlength=len(self.frames))
        best = np.argsort(-rays, kind="stable")[: 2 * most]
        able = np.sort(best[rays[best] > 0])
        spread: Ints = able[np.linspace(0, len(able) - 1, min(most, len(able))).round().astype(int)]
        return spread

    def _crosses(self, low: Floats, high: Floats) -> Bools:
        """Mask (N,) of the rays, from camera to surface, that meet a box: by the slab method."""
        eyes = self.eyes[self.owners]
        along = self.places - eyes
        along = np.where(np.abs(along) < 1e-9, np.float32(1e-9), along)
        first, second = (low - eyes) / along, (high - eyes) / along
        enters = np.minimum(first, second).max(axis=1)
        leaves = np.maximum(first, second).min(axis=1)
        met: Bools = (enters <= leaves) & (leaves >= 0) & (enters <= 1)
        return met


def survey_walk(frames: Sequence[Frame], limits: DepthLimits, faults: FrameFaults, tick: Tick) -> SceneWalk:
    """Read every frame once; those that cannot be decoded are left out, and noted in `faults`.

    Raises the first one's CaptureError where more than MAX_BAD_SHARE of the depth images cannot be decoded.
    """
    origin = np.asarray(frames[0].camera_to_world, np.float64)[:3, 3]

    def look(frame: Frame) -> tuple[Frame, float, Floats] | None:
        loaded = faults.read_depth(frame)
        if loaded is None:
            return None
        depth_m, confidence, camera = loaded
        if not depth_m.any():
            faults.empty.append(frame.name)
        rgb = faults.read_picture(frame)
        sharpness = 0.0 if rgb is None else sharpness_of(at_resolution(rgb, depth_m.shape))
        step = max(1, round((depth_m.size / _RAYS) ** 0.5))
        rows, columns = (each.ravel() for each in np.mgrid[: depth_m.shape[0] : step, : depth_m.shape[1] : step])
        z, sure = depth_m[rows, columns], confidence[rows, columns]
        known = (z >= limits.near_m) & (z <= limits.far_m) & (sure >= limits.min_confidence)
        pose = np.asarray(frame.camera_to_world, np.float64)
        places = back_project(camera, pose, rows[known], columns[known], 1 / z[known], origin)
        return (frame if rgb is not None else replace(frame, load_rgb=None)), sharpness, places

    seen = []
    for number, found in enumerate(one_ahead(look, frames)):
        seen += [] if found is None else [found]
        tick((number + 1) / len(frames))
    faults.check(len(frames))
    used, sharpness, places = zip(*seen, strict=True)
    eyes = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, 3] - origin for frame in used])
    owners = np.repeat(np.arange(len(used)), [len(each) for each in places])
    eyes, joined = eyes.astype(np.float32), np.concatenate(places)
    distance = ViewingDistance.of(joined, eyes[owners])
    near = distance.is_near(joined, eyes[owners])
    return SceneWalk(used, np.array(sharpness), origin, eyes, joined, owners, distance, near)
