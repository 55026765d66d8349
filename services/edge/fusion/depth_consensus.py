"""Check points against several depth images: average the views that agree, count the views that see free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.parallel import in_threads, slices
from capture2vr.edge.points.depth_limits import DepthView

_MIN_GATE, _MAX_GATE = 0.004, 0.03
"""Bounds of the gate, the relative depth difference that counts as the same surface: every sensor's noise reaches the
lower one; above the upper one the two sides of a thin object would be averaged into one."""
_GATE_SIGMAS = 3.0
"""Gate over the standard deviation of the views' disagreement."""
_FREE_SPACE_GATES = 2.0
"""A view contradicts a point when it sees this many gates past it: pose errors must not carve surfaces away."""
_CHUNK = 1 << 15
"""Points per batch: their dozen temporary arrays fit into the processor's cache."""
_PROBE = 20_000
"""Points sampled to measure by how much the views disagree."""


@dataclass(frozen=True, slots=True)
class ViewAgreement:
    """Votes of the views on N points: xyz (N,3) float32 after averaging; agree, contradict (N,) numbers of views."""

    xyz: Floats
    agree: Ints
    contradict: Ints


@dataclass(frozen=True, slots=True)
class VotingView:
    """Lookup tables of a depth image with its pose, one row per pixel, so that a point needs one memory access.

    surface (H·W,4): q, ∂q/∂u, ∂q/∂v, and the largest q of 3x3 pixels, in 1/m; q is 0 where unknown
    facing (H·W,4): the measurement's weight, and the surface's normal in the world
    """

    intrinsics: Intrinsics
    camera_to_world: Floats
    surface: Floats
    facing: Floats

    @classmethod
    def of(cls, view: DepthView) -> VotingView:
        """Build the lookup tables of a view: 32 bytes a pixel."""
        import cv2

        q = view.inverse_depth
        closest = cv2.dilate(q, np.ones((3, 3), np.uint8))
        surface = np.stack([q, *view.slope, closest], axis=-1, dtype=np.float32)
        weight = view.cosine * view.confidence * q * q
        normal = view.normal @ view.camera_to_world[:3, :3].T.astype(np.float32)
        facing = np.concatenate([weight[..., None], normal], axis=-1, dtype=np.float32)
        return cls(view.intrinsics, view.camera_to_world, surface.reshape(-1, 4), facing.reshape(-1, 4))


@dataclass(frozen=True, slots=True)
class _Sighting:
    """One view's measurements of the points that project into its image.

    index (M,) into the points; pixel (M,) flat; shift (M,): how far the seen surface is behind the point, relative to
    its depth; free (M,): the same for the nearest of 3x3 pixels, so that a silhouette one pixel off removes no point.
    """

    index: Ints
    pixel: Ints
    shift: Floats
    free: Floats


def vote_on_points(
    xyz: Floats, normal: Floats, views: Sequence[VotingView], origin: Floats, tick: Tick = no_tick
) -> ViewAgreement:
    """Remove outliers by a vote of free space: every view votes on every point that it can see.

    xyz (N,3) float32 m relative to `origin` (3,); normal (N,3) mean normals, shorter than 1 where they disagreed.
    A point moves to the weighted mean of the surfaces that the agreeing views see along their own rays: so several
    layers of voxels from one noisy surface become one.
    """
    gate = _gate(xyz, normal, views, origin)
    moved = np.zeros((len(xyz), 3), np.float32)
    weight = np.zeros(len(xyz), np.float32)
    agree, contradict = np.zeros(len(xyz), np.int32), np.zeros(len(xyz), np.int32)

    def vote(part: slice) -> None:
        points = xyz[part]
        for view, eye in zip(views, eyes, strict=True):
            sighting = _sight(points, view, origin)
            index, shift, w = _select_agreeing(sighting, normal[part], view, gate)
            moved[part][index] += (w * shift)[:, None] * (points[index] - eye)
            weight[part][index] += w
            agree[part][index] += 1
            contradict[part][sighting.index[sighting.free > _FREE_SPACE_GATES * gate]] += 1

    eyes = [_eye(view, origin) for view in views]
    in_threads(vote, slices(len(xyz), _CHUNK), tick)
    return ViewAgreement(xyz + moved / np.maximum(weight, np.float32(1e-12))[:, None], agree, contradict)


def _select_agreeing(sighting: _Sighting, normal: Floats, view: VotingView, gate: float) -> tuple[Ints, Floats, Floats]:
    """Return index, shift and weight of the measurements within the gate whose normal agrees with the point's."""
    near = np.flatnonzero(np.abs(sighting.shift) < gate)
    index = sighting.index[near]
    row = view.facing[sighting.pixel[near]]
    same = np.flatnonzero(np.einsum("ni,ni->n", row[:, 1:], normal[index]) > 0)
    return index[same], sighting.shift[near[same]], row[same, 0]


def _gate(xyz: Floats, normal: Floats, views: Sequence[VotingView], origin: Floats) -> float:
    """Measure the relative depth difference that noise and pose errors explain, on a sample of points and views."""
    probe = np.random.default_rng(0).permutation(len(xyz))[:_PROBE]
    shifts = []
    for view in views[:: max(1, len(views) // 8)]:
        _, shift, _ = _select_agreeing(_sight(xyz[probe], view, origin), normal[probe], view, _MAX_GATE)
        shifts.append(np.abs(shift))
    every = np.concatenate(shifts)
    return float(np.clip(_GATE_SIGMAS * 1.4826 * np.median(every), _MIN_GATE, _MAX_GATE)) if every.size else _MAX_GATE


def _sight(xyz: Floats, view: VotingView, origin: Floats) -> _Sighting:
    """Project points (N,3) into a view, and compare their depth with what it measured there."""
    camera = view.intrinsics
    height, width = camera.height, camera.width
    x, y, z = view.camera_to_world[:3, :3].T.astype(np.float32) @ (xyz - _eye(view, origin)).T
    z = np.maximum(z, np.float32(1e-6))  # points behind the camera project far outside the image
    u = x / z * np.float32(camera.fx) + np.float32(camera.cx)
    v = y / z * np.float32(camera.fy) + np.float32(camera.cy)
    index = np.flatnonzero((u > 0) & (u < width - 1) & (v > 0) & (v < height - 1))
    z, u, v = z[index], u[index], v[index]
    column, row = np.rint(u).astype(np.int32), np.rint(v).astype(np.int32)
    pixel = row * np.int32(width) + column
    q, dq_du, dq_dv, closest = view.surface[pixel].T
    known = np.flatnonzero(q > 0)
    # Between pixel centres q is interpolated linearly, which is exact on a plane.
    q = (q + dq_du * (u - column) + dq_dv * (v - row))[known]
    z = z[known]
    shift = 1 / (np.maximum(q, np.float32(1e-6)) * z) - 1
    return _Sighting(index[known], pixel[known], shift, np.minimum(shift, 1 / (closest[known] * z) - 1))


def _eye(view: VotingView, origin: Floats) -> Floats:
    """Return the camera's position (3,) relative to `origin`."""
    return np.asarray(view.camera_to_world[:3, 3] - origin, np.float32)
