"""Filter one depth image: find its valid pixels, estimate its noise, and compute the surface normals.

Symbols: z = depth along the optical axis (m); q = 1/z, which is linear in the pixel on a plane; (x, y, 1) = the pixel's
ray in the camera frame. A plane n·X = 1 has q = n·(x, y, 1), so n = (∂q/∂x, ∂q/∂y, q - x·∂q/∂x - y·∂q/∂y) exactly,
and the cosine between the ray and the normal is q / (|n|·|(x, y, 1)|).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_MAX_GRAZING_DEG = 78.0
"""Largest angle between ray and normal: steeper surfaces have unreliable depth, and look like flying pixels between
two surfaces."""
_MIN_JUMP = 0.012
"""Relative depth step between pixels below which a surface is continuous, however fine the pixels: 12 mm at 1 m."""
_MIN_NOISE, _MAX_NOISE = 0.0007, 0.01
"""Bounds of the relative depth noise: quantised depth looks noiseless, and texture must not be taken for noise."""
_BILATERAL_PX = 5
"""Diameter of the window of the bilateral filter."""


@dataclass(frozen=True, slots=True)
class DepthLimits:
    """Limits of valid pixels: depth between near_m and far_m, confidence of at least min_confidence (0..1)."""

    near_m: float
    far_m: float
    min_confidence: float


@dataclass(frozen=True, slots=True)
class DepthView:
    """A filtered depth image with its pose.

    inverse_depth (H,W) float32 1/m, smoothed, 0 where unknown or filtered out;
    slope: ∂q/∂u and ∂q/∂v (H,W) float32 per pixel, never across a depth jump;
    normal (H,W,3) float32 camera frame, unit, towards the camera; cosine (H,W) float32 of the angle to the ray;
    confidence (H,W) float32; noise: relative standard deviation of the raw depth; read: number of pixels with depth
    before filtering.
    """

    intrinsics: Intrinsics
    camera_to_world: Floats
    inverse_depth: Floats
    slope: tuple[Floats, Floats]
    normal: Floats
    cosine: Floats
    confidence: Floats
    noise: float
    read: int


def load_depth(frame: Frame) -> tuple[Floats, Floats, Intrinsics]:
    """Load depth (H,W) float32 m with 0 for unknown, confidence (H,W) float32, and the intrinsics at that resolution.

    Raises CaptureError: CAPTURE_COUNT_MISMATCH where depth is not two-dimensional.
    """
    import cv2

    depth_m = np.asarray(frame.load_depth_m(), np.float32)
    if depth_m.ndim != 2 or not depth_m.size:
        shape = "x".join(map(str, depth_m.shape))
        reason = say("has_depth_shape_depth_image", shape=shape)
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=frame.name)
    depth_m = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0))
    height, width = depth_m.shape
    confidence: Floats = np.ones_like(depth_m)
    if frame.load_confidence is not None:
        confidence = np.asarray(frame.load_confidence(), np.float32)
        if confidence.shape != depth_m.shape:
            confidence = np.asarray(
                cv2.resize(confidence, (width, height), interpolation=cv2.INTER_NEAREST), np.float32
            )
    camera = frame.intrinsics
    if (camera.width, camera.height) != (width, height):
        camera = camera.scaled_to(width, height)
    return depth_m, confidence, camera


def read_view(frame: Frame, limits: DepthLimits) -> DepthView:
    """Load and filter a frame's depth: keep pixels in range, confident, not flying, and not at a grazing angle."""
    depth_m, confidence, camera = load_depth(frame)
    known = (depth_m >= limits.near_m) & (depth_m <= limits.far_m) & (confidence >= limits.min_confidence)
    noise = depth_noise(depth_m, known)
    smooth_m = _smooth(depth_m, known, noise)
    inverse = np.where(known, 1 / np.where(known, smooth_m, 1), 0).astype(np.float32)
    jump = max_jump(camera, noise)
    dq_du, across = slopes(inverse, jump, axis=1)
    dq_dv, down = slopes(inverse, jump, axis=0)
    normal, cosine = _normals(inverse, dq_du * camera.fx, dq_dv * camera.fy, camera)
    keep = known & across & down & (cosine > np.cos(np.radians(_MAX_GRAZING_DEG)))
    pose = np.asarray(frame.camera_to_world, np.float64)
    read = int(np.count_nonzero(depth_m))
    return DepthView(camera, pose, np.where(keep, inverse, 0), (dq_du, dq_dv), normal, cosine, confidence, noise, read)


def depth_noise(depth_m: Floats, known: Bools) -> float:
    """Estimate the relative standard deviation of the depth, from second differences of 1/z along rows.

    They vanish on planes."""
    inverse = np.where(known, 1 / np.where(known, depth_m, 1), 0)
    centre = inverse[:, 1:-1]
    both = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    bends = np.abs(inverse[:, :-2] - 2 * centre + inverse[:, 2:])[both] / centre[both]
    if not bends.size:
        return _MIN_NOISE
    # A second difference of independent noise has variance (1 + 4 + 1)·σ²; 1.4826 turns a median into a σ.
    return float(np.clip(1.4826 * np.median(bends) / np.sqrt(6), _MIN_NOISE, _MAX_NOISE))


def _smooth(depth_m: Floats, known: Bools, noise: float) -> Floats:
    """Smooth with a bilateral filter on log depth: pixels within three standard deviations are averaged."""
    import cv2

    unknown = np.float32(-20)  # so far from any log depth that its weight is 0
    log_m = np.where(known, np.log(np.where(known, depth_m, 1)), unknown).astype(np.float32)
    return np.exp(cv2.bilateralFilter(log_m, _BILATERAL_PX, 3 * noise, _BILATERAL_PX / 2))


def max_jump(camera: Intrinsics, noise: float) -> float:
    """Return the largest relative depth step between two neighbouring pixels of one surface."""
    return float(max(np.tan(np.radians(_MAX_GRAZING_DEG)) / max(camera.fx, camera.fy), _MIN_JUMP, 4 * noise))


def slopes(inverse: Floats, jump: float, *, axis: int) -> tuple[Floats, Bools]:
    """Compute the change of q per pixel along an axis (H,W), averaged over the sides without a depth jump.

    Also returns a mask (H,W): True where a pixel has such a side. A flying pixel, between two surfaces, has none; the
    last pixel of a surface has one.
    """
    step = np.diff(inverse, axis=axis)
    first, second = (inverse[:, :-1], inverse[:, 1:]) if axis == 1 else (inverse[:-1], inverse[1:])
    smooth = (np.abs(step) <= jump * np.minimum(first, second)) & (first > 0) & (second > 0)
    step = np.where(smooth, step, 0)
    before, after = ((1, 0), (0, 1))
    pad = [(0, 0), (0, 0)]
    pad[axis] = before
    total, sides = np.pad(step, pad), np.pad(smooth, pad).astype(np.float32)
    pad[axis] = after
    total, sides = total + np.pad(step, pad), sides + np.pad(smooth, pad)
    return total / np.maximum(sides, 1), sides > 0


def _normals(inverse: Floats, dq_dx: Floats, dq_dy: Floats, camera: Intrinsics) -> tuple[Floats, Floats]:
    """Compute unit normals (H,W,3) towards the camera and the cosines (H,W) to the rays, as in the module's text."""
    height, width = inverse.shape
    x = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)[None, :]
    y = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    normal = -np.stack([dq_dx, dq_dy, inverse - x * dq_dx - y * dq_dy], axis=-1)
    length = np.maximum(np.linalg.norm(normal, axis=-1), np.float32(1e-12))
    cosine = inverse / (length * np.sqrt(x * x + y * y + 1))
    return (normal / length[..., None]).astype(np.float32), cosine.astype(np.float32)
