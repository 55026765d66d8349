"""Plane sweep: the depth of every pixel of a view, from a few other views.

R. T. Collins, "A Space-Sweep Approach to True Multi-Image Matching", 1996. Planes parallel to the view's image stand at
equal steps of inverse depth q = 1/z; on each the other pictures are brought into the view's place by a homography and
compared (`zncc`); `sgm` chooses a plane for every pixel; the depth is then refined pixel by pixel between the planes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Bytes, Floats, Tick, no_tick
from services.edge.photos.pictures import Picture
from services.edge.photos.sgm import Costs, aggregate
from services.edge.photos.zncc import BestTwo, Windows

_NEARER, _FARTHER = 0.7, 1.25
"""Of the nearest and the farthest sparse point of a view: how far the sweep goes beyond them."""
_PERCENTILES = (0.5, 99.0)
_STEP_PX = 1.0
"""Shift of a source's pixels from plane to plane; the refinement looks between them."""
_FEWEST, _MOST = 24, 128
"""Planes. Memory is 4 bytes a pixel and plane: 128 of 640 x 480 are 160 MB."""
_REFINEMENTS = (0.5, 0.25, 0.08)
"""Steps of the refinement in planes."""


@dataclass(frozen=True, slots=True)
class DepthMap:
    """depth (H,W) float32 in units of the alignment, along the optical axis; score (H,W) float32: ZNCC, -1 to 1."""

    depth: Floats
    score: Floats


def sweep(reference: Picture, sources: Sequence[Picture], z: Floats, tick: Tick = no_tick) -> DepthMap:
    """Depth of all pixels of `reference`. z (n,): depths of the sparse points that it saw.

    Planes are chosen on pictures of half the size, an eighth of the work, and the depth is refined on the whole ones.
    """
    near, far = np.percentile(z, _PERCENTILES)
    q_far, q_near = 1 / (_FARTHER * far), 1 / (_NEARER * near)
    coarse = _Stand.of(reference.halved(), [source.halved() for source in sources])
    planes = np.linspace(q_far, q_near, _planes(coarse, q_far, q_near))
    q = _chosen(coarse, planes, lambda fraction: tick(0.6 * fraction))
    fine = _Stand.of(reference, sources)
    q = _enlarged(q, reference.grey.shape)
    for number, step in enumerate(_REFINEMENTS):
        q = _refined(fine, q, step * (planes[1] - planes[0]))
        tick(0.6 + 0.4 * (number + 1) / len(_REFINEMENTS))
    q = np.clip(q, q_far, q_near).astype(np.float32)
    return DepthMap(1 / q, _score(fine, q))


def _chosen(stand: _Stand, planes: Floats, tick: Tick) -> Floats:
    """(H,W) float32 inverse depth of the plane that SGM chooses for each pixel, or a little beside it."""
    cost = np.empty((*stand.shape, len(planes)), np.uint8)
    for number, q in enumerate(planes):
        cost[..., number] = _cost(stand, q)
        tick((number + 1) / len(planes))
    chosen = _lowest(aggregate(cost, stand.windows.grey.astype(np.uint8)))
    inverse: Floats = (planes[0] + (planes[1] - planes[0]) * chosen).astype(np.float32)
    return inverse


def _enlarged(q: Floats, shape: tuple[int, ...]) -> Floats:
    import cv2

    return np.asarray(cv2.resize(q, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))


@dataclass(frozen=True, slots=True)
class _Stand:
    """A reference and the other pictures, at one size."""

    windows: Windows
    rays: _Rays
    others: Sequence[_Source]

    @classmethod
    def of(cls, reference: Picture, sources: Sequence[Picture]) -> _Stand:
        others = [_Source.of(reference, source) for source in sources]
        return cls(Windows.of(reference.grey), _Rays.of(reference), others)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.windows.grey.shape


@dataclass(frozen=True, slots=True)
class _Rays:
    """x (W,), y (H,): the pixel (u, v) looks along (x, y, 1)."""

    x: Floats
    y: Floats

    @classmethod
    def of(cls, picture: Picture) -> _Rays:
        height, width = picture.grey.shape
        camera = picture.camera
        x = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)
        y = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)
        return cls(x, y)


@dataclass(frozen=True, slots=True)
class _Source:
    """Another picture as seen from the reference: pixel ~ turn·(x, y, 1) + q·shift, with turn = K R and shift = K t.

    turn (3,3), shift (3,); grey (H,W) float32; unproject (3,3): the reference's inverse camera matrix.
    """

    grey: Floats
    turn: Floats
    shift: Floats
    unproject: Floats

    @classmethod
    def of(cls, reference: Picture, source: Picture) -> _Source:
        relative = source.world_to_camera @ np.linalg.inv(reference.world_to_camera)
        k = source.k
        unproject = np.linalg.inv(reference.k)
        return cls(source.grey.astype(np.float32), k @ relative[:3, :3], k @ relative[:3, 3], unproject)

    def on_plane(self, q: float, shape: tuple[int, ...]) -> Floats:
        """The picture as the reference would see it if all of it lay on the plane at inverse depth q."""
        import cv2

        homography = self.turn @ self.unproject
        homography = homography + q * np.outer(self.shift, self.unproject[2])
        return np.asarray(
            cv2.warpPerspective(
                self.grey, homography, (shape[1], shape[0]), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            )
        )

    def at(self, rays: _Rays, q: Floats) -> Floats:
        """The picture brought to the reference through the inverse depth q (H,W) of each pixel."""
        import cv2

        turn, shift = self.turn.astype(np.float32), self.shift.astype(np.float32)
        u, v, w = (
            turn[axis, 0] * rays.x[None] + (turn[axis, 1] * rays.y + turn[axis, 2])[:, None] + shift[axis] * q
            for axis in range(3)
        )
        w = np.where(w > 0, w, np.float32(np.nan))  # behind the source: outside its picture
        return np.asarray(cv2.remap(self.grey, u / w, v / w, cv2.INTER_LINEAR))


def _planes(stand: _Stand, q_far: float, q_near: float) -> int:
    """Planes so that the picture's middle moves about `_STEP_PX` from one to the next in the median source."""
    middle = np.array([stand.rays.x[len(stand.rays.x) // 2], stand.rays.y[len(stand.rays.y) // 2], 1.0])
    moved = []
    for other in stand.others:
        far, near = (other.turn @ middle + q * other.shift for q in (q_far, q_near))
        moved.append(float(np.linalg.norm(near[:2] / near[2] - far[:2] / far[2])))
    return int(np.clip(np.median(moved) / _STEP_PX, _FEWEST, _MOST))


def _cost(stand: _Stand, q: float) -> Bytes:
    best = BestTwo(stand.shape)
    for other in stand.others:
        best.add(stand.windows.zncc(other.on_plane(q, stand.shape)))
    return (127.5 * (1 - np.clip(best.mean(), -1, 1))).astype(np.uint8)


def _score(stand: _Stand, q: Floats) -> Floats:
    best = BestTwo(stand.shape)
    for other in stand.others:
        best.add(stand.windows.zncc(other.at(stand.rays, q)))
    return best.mean()


def _lowest(total: Costs) -> Floats:
    """(H,W) plane of the least sum, between planes by a parabola through it and its neighbours."""
    count = total.shape[2]
    index = np.clip(total.argmin(axis=2), 1, count - 2)[..., None]
    before, here, after = (
        np.take_along_axis(total, index + step, axis=2)[..., 0].astype(np.float32) for step in (-1, 0, 1)
    )
    plane: Floats = index[..., 0] + vertex(before, here, after)
    return plane


def vertex(before: Floats, here: Floats, after: Floats) -> Floats:
    """Where the parabola through three values one step apart is least, in steps from the middle, at most one away."""
    bend = before - 2 * here + after
    offset = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1), np.sign(before - after))
    return np.clip(offset, -1, 1).astype(np.float32)


def _refined(stand: _Stand, q: Floats, step: float) -> Floats:
    """q moved by at most `step` to where the pictures agree best; windows follow the depth of each of their pixels."""
    scores = [_score(stand, q + np.float32(offset * step)) for offset in (-1, 0, 1)]
    return q + np.float32(step) * vertex(-scores[0], -scores[1], -scores[2])
