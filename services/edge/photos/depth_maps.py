"""Multi-view stereo: compute posed depth images, like those of a depth sensor, from photos with known cameras.

1. sources      select a few other views for every view
2. sweep        compute its depth, pixel by pixel (plane sweep)
3. consistency  drop depth that other views do not confirm; what they confirm only loosely counts less
4. rim          drop depth at the outline of an object where the picture shows the background
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, no_tick, part_of
from capture2vr.edge.cameras.nouns import Alignment, PhotoView, picture_camera
from capture2vr.edge.capture.nouns import Frame, Intrinsics, ShownPicture
from capture2vr.edge.capture.photo_copy import COPY_PX
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.photos.depth_consistency import confirmations
from capture2vr.edge.photos.depth_rim import remove_rim
from capture2vr.edge.photos.plane_sweep import DepthMap, SweepBackendOf, backend_on, sweep
from capture2vr.edge.photos.plane_sweep_cpu import CpuSweep
from capture2vr.edge.photos.source_views import SOURCES, choose_sources
from capture2vr.edge.photos.undistorted import UndistortedPhoto, load_undistorted_grey, load_undistorted_rgb
from capture2vr.edge.photos.upright_photo import UprightPhoto
from capture2vr.edge.photos.zncc import WINDOW
from capture2vr.sentences.sentence import say

LONGEST_PX = 640
"""Longer side of the pictures for stereo: 960 takes three times as long, without gain for an object that fills them."""
TEXTURE_PX = COPY_PX
"""Longer side of photos for texturing: if the object fills the photo, about as many pixels as the texture has."""
_WITNESSES = 8
"""Views in which a view's depth is checked."""
_LEAST_SCORE = 0.2
"""Least correlation (ZNCC) of a match: below it a match is random, even if other views confirm it."""
_FEW, _MANY = 6, 20
"""Numbers of views: with fewer than the first, one confirmation is enough; from the second on, three are needed, or
one less of depth that is confirmed only loosely."""
_LOOSE = 2
"""Least loose confirmations: one alone is wrong too often (18 % of the pixels of rendered garments)."""
_GOOD_SCORE, _SEEN_WELL = 0.7, 4
"""Least correlation of a match for which one loose confirmation is enough, and the least number of witnesses then."""
_FLOOR = 0.3
"""Confidence of the worst match, and of one confirmed only loosely: above the level at which a sensor's depth is
dropped."""
_WORKERS = min(2, os.cpu_count() or 1)
"""Sweeps in parallel; each needs some 300 MB, and the worker's other jobs need processors too."""
_CLOCKWISE = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Camera axes of the picture rotated clockwise by a quarter turn, in those of the picture: its x is -y, its y is x."""
_POLL_S = 0.2
"""Seconds between two checks whether the job was cancelled."""

_log = logging.getLogger(__name__)


def depth_frames(
    alignment: Alignment, *, longest: int = LONGEST_PX, device: str = "cpu", tick: Tick = no_tick
) -> tuple[Frame, ...]:
    """Compute posed depth images of the views, at most `longest` pixels long, in units of the alignment.

    device: where the sweep computes, "cpu" or a GPU as PyTorch names it.
    Raises CaptureError: CAPTURE_LOW_OVERLAP where no view has a source view.
    """
    witnesses = choose_sources(alignment, _WITNESSES)
    sources = [others[:SOURCES] for others in witnesses]  # the best come first
    pictures = in_threads(lambda view: load_undistorted_grey(view, longest), alignment.views)
    swept = [view for view, others in enumerate(sources) if others]
    if not swept:
        raise CaptureError(
            "CAPTURE_LOW_OVERLAP",
            say("no_two_placed_photos_see", count=len(pictures)),
            hints=(say("walk_around_thing_in_steps"),),
        )
    backend_of = backend_on(device)
    maps = _sweep_views(alignment, pictures, sources, swept, backend_of, part_of(tick, 0.0, 0.9))
    depths = [np.zeros(each.grey.shape, np.float32) for each in pictures]
    for view, found in maps.items():
        mask = pictures[view].mask
        valid = found.score > _LEAST_SCORE if mask is None else (found.score > _LEAST_SCORE) & mask
        depths[view] = np.where(valid, found.depth, np.float32(0))
    wanted = 1 if len(swept) < _FEW else 2 if len(swept) < _MANY else 3

    def frame_of(view: int) -> Frame:
        needed = min(wanted, max(1, len(witnesses[view]) // 2))  # a view at the end of the path has few neighbours
        strict, loose = confirmations(view, witnesses[view], pictures, depths)
        sure, agreed = strict >= needed, loose >= max(_LOOSE, needed - 1)
        if len(witnesses[view]) >= _SEEN_WELL:
            agreed |= (loose >= 1) & (maps[view].score > _GOOD_SCORE)
        rgb, _ = load_undistorted_rgb(alignment.views[view], longest)
        depth = remove_rim(np.where(sure | agreed, depths[view], np.float32(0)), rgb)
        return _frame(pictures[view], depth, np.where(sure, maps[view].score, np.float32(0)), longest)

    return tuple(in_threads(frame_of, swept, part_of(tick, 0.9, 1.0)))


def _sweep_views(
    alignment: Alignment,
    pictures: Sequence[UndistortedPhoto],
    sources: Sequence[Sequence[int]],
    swept: Sequence[int],
    backend_of: SweepBackendOf,
    tick: Tick,
) -> dict[int, DepthMap]:
    """Compute the depth maps of the views in `swept`, in parallel; on the CPU those for which a GPU has no room.

    `tick` is called regularly; when it raises, running sweeps stop within one plane."""
    stop = threading.Event()

    def watch(fraction: float) -> None:
        if stop.is_set():
            raise Cancelled

    def work(view: int) -> DepthMap:
        others = [pictures[other] for other in sources[view]]
        try:
            return sweep(pictures[view], others, _depths_of(alignment, view), watch, backend_of=backend_of)
        except MemoryError:
            if backend_of is CpuSweep:
                raise
            _log.warning(
                "the GPU has no room for the depth of %s: it is computed on the CPU", pictures[view].view.photo.name
            )
        return sweep(pictures[view], others, _depths_of(alignment, view), watch)

    pool = ThreadPoolExecutor(_WORKERS)
    try:
        futures: dict[int, Future[DepthMap]] = {view: pool.submit(work, view) for view in swept}
        waiting = set(futures.values())
        while waiting:
            _, waiting = wait(waiting, _POLL_S, FIRST_COMPLETED)
            tick(1 - len(waiting) / len(swept))
        return {view: future.result() for view, future in futures.items()}
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


def _depths_of(alignment: Alignment, view: int) -> Floats:
    """Return the depths (n,) of the sparse points that a view sees."""
    points = alignment.xyz[alignment.seen_point[alignment.seen_view == view]]
    world_to_camera = np.linalg.inv(alignment.views[view].camera_to_world)
    z: Floats = points @ world_to_camera[2, :3] + world_to_camera[2, 3]
    return z[z > 0]


def _frame(seen: UndistortedPhoto, depth: Floats, score: Floats, longest: int) -> Frame:
    """Make a frame from a depth image, rotated upright by the photo's orientation tag.

    Upright matters, since the up direction is estimated from how the cameras were held."""
    turns = seen.view.photo.turns
    confidence = (_FLOOR + (1 - _FLOOR) * np.clip(score, 0, 1)).astype(np.float16)
    depth, confidence = np.rot90(depth, -turns), np.rot90(confidence, -turns)
    camera, pose, photo = seen.camera, seen.view.camera_to_world, seen.view.photo
    given = seen.mask if photo.load_mask or photo.load_alpha else None
    mask = None if given is None else np.ascontiguousarray(np.rot90(given, -turns))
    for _ in range(turns):
        camera, pose = _rotate_clockwise(camera), pose @ _CLOCKWISE
    return Frame(
        seen.view.photo.name,
        camera,
        pose,
        lambda: np.ascontiguousarray(depth),
        lambda: np.ascontiguousarray(confidence, np.float32),
        PhotoColours(seen.view, longest),
        window_px=WINDOW,
        picture=picture_camera(seen.view),
        shown=ShownPicture(photo.name, UprightPhoto(seen.view)),
        load_mask=None if mask is None else lambda: mask,
    )


def _rotate_clockwise(camera: Intrinsics) -> Intrinsics:
    """Return the camera of the picture rotated clockwise by 90 degrees: pixel (u, v) moves to (height - 1 - v, u)."""
    return Intrinsics(camera.fy, camera.fx, camera.height - 1 - camera.cy, camera.cx, camera.height, camera.width)


@dataclass(frozen=True, slots=True)
class PhotoColours:
    """Loads a photo to match its depth image: undistorted and upright, at most `longest` pixels long."""

    view: PhotoView
    longest: int

    def __call__(self) -> Bytes:
        rgb, _ = load_undistorted_rgb(self.view, self.longest)
        return np.ascontiguousarray(np.rot90(rgb, -self.view.photo.turns))


def at_texture_resolution(load_rgb: Callable[[], Bytes]) -> Callable[[], Bytes]:
    """Return a loader of the same photo at the resolution for texturing; other loaders are returned unchanged."""
    return replace(load_rgb, longest=TEXTURE_PX) if isinstance(load_rgb, PhotoColours) else load_rgb
