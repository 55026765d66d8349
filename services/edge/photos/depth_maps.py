"""Photos with known cameras -> posed depth images, the same that a depth sensor's recording holds.

1. sources  every view gets a few others to be compared with
2. sweep    its depth, pixel by pixel
3. agree    what other views do not confirm is dropped
4. outline  and what looks like the background at the outline of a thing
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace

import numpy as np

from services.edge.arrays import Bytes, Floats, Tick, no_tick
from services.edge.capture.nouns import Frame, Intrinsics
from services.edge.errors import Cancelled, CaptureError
from services.edge.photos.agree import confirmations
from services.edge.photos.nouns import Alignment, View
from services.edge.photos.outline import without_rim
from services.edge.photos.pictures import Picture, colours, picture
from services.edge.photos.sources import SOURCES, choose_sources
from services.edge.photos.sweep import DepthMap, StandOf, stand_on, sweep
from services.edge.photos.zncc import WINDOW

LONGEST_PX = 640
"""Longer side of the pictures: 960 takes three times as long and gains nothing on a thing that fills the picture."""
TEXTURE_PX = 1920
"""Longer side of a photo that colours a texture: of a thing that fills it, as many as the texture has."""
_WITNESSES = 8
"""Views asked whether they agree with a view's depth."""
_LEAST_SCORE = 0.2
"""Correlation below which a match is chance, whoever agrees with it."""
_FEW, _MANY = 6, 20
"""Numbers of views: with fewer than the first one confirmation is enough, from the second on three are needed."""
_FLOOR = 0.3
"""Confidence of the poorest match that was confirmed: above what a sensor's lowest level is taken for."""
_WORKERS = min(2, os.cpu_count() or 1)
"""Sweeps at once; each holds some 300 MB, and a worker's other jobs want processors too."""
_CLOCKWISE = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Axes of the picture turned clockwise by a quarter, in those of the picture: its x is -y, its y is x."""
_LOOK_S = 0.2
"""Seconds between two looks at whether the job was cancelled."""


def depth_frames(
    alignment: Alignment, *, longest: int = LONGEST_PX, device: str = "cpu", tick: Tick = no_tick
) -> tuple[Frame, ...]:
    """Posed depth images of the views, pictures of at most `longest` pixels, in units of the alignment.

    device: where the sweep computes, "cpu" or a GPU as PyTorch names it.
    Raises CaptureError: CAPTURE_LOW_OVERLAP where no view has another to be compared with.
    """
    witnesses = choose_sources(alignment, _WITNESSES)
    sources = [others[:SOURCES] for others in witnesses]  # the best come first
    pictures = [picture(view, longest) for view in alignment.views]
    swept = [view for view, others in enumerate(sources) if others]
    if not swept:
        raise CaptureError(
            "CAPTURE_LOW_OVERLAP",
            f"no two of the {len(pictures)} placed photos see the same part from sides that show its depth",
            hints=("walk around the thing in steps of about 10 degrees, a photo at each",),
        )
    stand_of = stand_on(device)
    maps = _all_swept(alignment, pictures, sources, swept, stand_of, lambda fraction: tick(0.9 * fraction))
    depths = [np.zeros(each.grey.shape, np.float32) for each in pictures]
    for view, found in maps.items():
        mask = pictures[view].mask
        believed = found.score > _LEAST_SCORE if mask is None else (found.score > _LEAST_SCORE) & mask
        depths[view] = np.where(believed, found.depth, np.float32(0))
    wanted = 1 if len(swept) < _FEW else 2 if len(swept) < _MANY else 3
    frames = []
    for number, view in enumerate(swept):
        needed = min(wanted, max(1, len(witnesses[view]) // 2))  # a view at the rim has few to ask
        agreed = confirmations(view, witnesses[view], pictures, depths) >= needed
        rgb, _ = colours(alignment.views[view], longest)
        depth = without_rim(np.where(agreed, depths[view], np.float32(0)), rgb)
        frames.append(_frame(pictures[view], depth, maps[view].score, longest))
        tick(0.9 + 0.1 * (number + 1) / len(swept))
    return tuple(frames)


def _all_swept(
    alignment: Alignment,
    pictures: Sequence[Picture],
    sources: Sequence[Sequence[int]],
    swept: Sequence[int],
    stand_of: StandOf,
    tick: Tick,
) -> dict[int, DepthMap]:
    """The depth maps by view. `tick` is heard all the while; when it raises, sweeps under way end within a plane."""
    stop = threading.Event()

    def watch(fraction: float) -> None:
        if stop.is_set():
            raise Cancelled

    def work(view: int) -> DepthMap:
        others = [pictures[other] for other in sources[view]]
        return sweep(pictures[view], others, _depths_of(alignment, view), watch, stand_of=stand_of)

    pool = ThreadPoolExecutor(_WORKERS)
    try:
        futures: dict[int, Future[DepthMap]] = {view: pool.submit(work, view) for view in swept}
        waiting = set(futures.values())
        while waiting:
            _, waiting = wait(waiting, _LOOK_S, FIRST_COMPLETED)
            tick(1 - len(waiting) / len(swept))
        return {view: future.result() for view, future in futures.items()}
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


def _depths_of(alignment: Alignment, view: int) -> Floats:
    """(n,) depths of the sparse points that a view saw."""
    points = alignment.xyz[alignment.seen_point[alignment.seen_view == view]]
    world_to_camera = np.linalg.inv(alignment.views[view].camera_to_world)
    z: Floats = points @ world_to_camera[2, :3] + world_to_camera[2, 3]
    return z[z > 0]


def _frame(seen: Picture, depth: Floats, score: Floats, longest: int) -> Frame:
    """The depth image as a sensor's would be, turned upright as the photo says it was held: which way the thing stands
    is told from how cameras were held."""
    turns = seen.view.photo.turns
    confidence = (_FLOOR + (1 - _FLOOR) * np.clip(score, 0, 1)).astype(np.float16)
    depth, confidence = np.rot90(depth, -turns), np.rot90(confidence, -turns)
    camera, pose = seen.camera, seen.view.camera_to_world
    for _ in range(turns):
        camera, pose = _turned(camera), pose @ _CLOCKWISE
    return Frame(
        seen.view.photo.name,
        camera,
        pose,
        lambda: np.ascontiguousarray(depth),
        lambda: np.ascontiguousarray(confidence, np.float32),
        Colours(seen.view, longest),
        window_px=WINDOW,
    )


def _turned(camera: Intrinsics) -> Intrinsics:
    """The camera of the picture turned clockwise by a quarter: the pixel (u, v) is now at (height - 1 - v, u)."""
    return Intrinsics(camera.fy, camera.fx, camera.height - 1 - camera.cy, camera.cx, camera.height, camera.width)


@dataclass(frozen=True, slots=True)
class Colours:
    """Loads a photo as the picture of its depth image: undistorted and upright, at most `longest` pixels."""

    view: View
    longest: int

    def __call__(self) -> Bytes:
        rgb, _ = colours(self.view, self.longest)
        return np.ascontiguousarray(np.rot90(rgb, -self.view.photo.turns))


def finer(load_rgb: Callable[[], Bytes]) -> Callable[[], Bytes]:
    """What loads a photo for a texture, where it was loaded for its depth; of other pictures the same."""
    return replace(load_rgb, longest=TEXTURE_PX) if isinstance(load_rgb, Colours) else load_rgb
