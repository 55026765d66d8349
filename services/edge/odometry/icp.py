"""The pose of one depth image against another: projective point-to-plane ICP with a photometric term, coarse to fine.

Symbols: q = inverse depth (1/m) of the target's pixel (u, v); m = (∂q/∂x, ∂q/∂y, q - x·∂q/∂x - y·∂q/∂y) its plane, so
that m·X = 1 for every X (3,) of the plane; X = T·p a point of the source in the target's frame. The residual m·X - 1 is
the relative depth by which X misses the plane, however far from the pixel's centre it falls. A small motion (ω, t)
moves X by t + ω×X, and the residual by m·t + (X×m)·ω. The photometric residual is I(π(X)) - I(p), with the gradient of
I(π(X)) by X in the place of m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from services.edge.arrays import Bools, Floats, Ints
from services.edge.points.levels import LEVELS, Level

_ITERATIONS = (12, 8, 5)
"""At most, from coarse to fine."""
_GATES = (0.12, 0.06, 0.03)
"""Relative depth beyond which a pair is no pair, from coarse to fine."""
_SAME_WAY = 0.6
"""Cosine between two normals that can be of one surface."""
_STILL = 2e-5
"""Radians, and shares of the distance, of a step that ends a level: a tenth of what the noise leaves."""
_MIN_RELATIVE, _MIN_GREY = (0.01, 0.004, 0.001), (0.04, 0.02, 0.01)
"""Least spread of the residuals from coarse to fine: relative depth, and grey of 0 to 1. At the end no sensor is
better, quantised as it may look; at first a table that fits must not make outliers of the things on it."""
_MIN_GRADIENT = 0.01
"""Grey per pixel, five times what a noisy picture has once it is blurred: shades that are noise hold no camera."""
_NEAREST, _FARTHEST = 0.3, 3.0
"""Bounds of the weight (median depth / depth): the relative noise of depth grows with depth."""
_MIN_OVERLAP, _MIN_AGREEMENT = 0.2, 0.92
"""Shares as in `Fit`. Right poses agree to 0.97 and more, many wrong ones in furnished rooms to 0.85."""
_FEIGNED = 0.001
"""Share of the pull on a bare wall in its weakest direction, over (spread · focal length)²: tilts that are noise.
Rendered walls, noise of 0.1 to 2 %, 256 and 320 pixels: 0.0002 to 0.001."""
_MIN_HOLD, _FIRM_HOLD = 4.0, 40.0
"""Below the first noise may hold a direction: 0.2 to 1.2 on rendered walls, 1 to 5 where rooms slid. Below the second a
nudge tells whether something does."""
_NUDGE = 0.02
"""Radians, and shares of the median depth: well beyond the noise, well within reach of the alignment."""
_BACK = 0.3
"""Share of the nudge that may be left where the pose is held."""
MIN_PAIRS = 300
"""Fewer pixels that meet do not hold six unknowns."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Where a source is in a target.

    pose         (4,4) float64, source to target
    information  (6,6) of the motion (ω, t) in the target's frame, per rad² and m²: J'WJ over the residuals' variance
    overlap      share of the source's pixels that met a surface of the target
    agreement    of the pixels that fell on a known pixel of the target and not behind it, the share that met it
    hold         how firmly the weakest direction of motion is held, in multiples of what noise feigns: 1 on a wall
    nudged       (4,4) the pose a little off in that direction
    """

    pose: Floats
    information: Floats
    overlap: float
    agreement: float
    hold: float
    nudged: Floats

    @property
    def sound(self) -> bool:
        """Whether the pose is to be believed."""
        return self.overlap > _MIN_OVERLAP and self.agreement > _MIN_AGREEMENT and self.hold > _MIN_HOLD


@dataclass(frozen=True, slots=True)
class _Pairs:
    """index (K,) into the source's pixels, pixel (K,) of the target, x (K,3) points in the target's frame,
    u, v (K,) where they fall; relative (K,) residuals; and the shares that `Fit` has."""

    index: Ints
    pixel: Ints
    x: Floats
    u: Floats
    v: Floats
    relative: Floats
    overlap: float
    agreement: float


def align(source: tuple[Level, ...], target: tuple[Level, ...], guess: Floats) -> Fit | None:
    """The pose (4,4) of the source's camera in the target's, from a guess; None where too little meets.

    A pose that does not come back when it is nudged slides, whatever holds it where it stopped: its `hold` is 0.
    """
    fit = _descend(source, target, guess, range(LEVELS))
    if fit is None or not _MIN_HOLD < fit.hold < _FIRM_HOLD:
        return fit
    back = _descend(source, target, fit.nudged, range(1, LEVELS))
    left = np.inf if back is None else float(np.linalg.norm(back.pose - fit.pose))
    return fit if left < _BACK * float(np.linalg.norm(fit.nudged - fit.pose)) else replace(fit, hold=0.0)


def _descend(source: tuple[Level, ...], target: tuple[Level, ...], guess: Floats, levels: range) -> Fit | None:
    pose: Floats = np.asarray(guess, np.float64)
    fit: Fit | None = None
    for level in levels:
        here, there = source[level], target[level]
        for _ in range(_ITERATIONS[level]):
            pairs = _pairs(here, there, pose, _GATES[level])
            if len(pairs.index) < MIN_PAIRS * here.inverse_depth.size / source[-1].inverse_depth.size:
                return None
            fit, step = _step(here, there, pairs, pose, level)
            pose = fit.pose
            if step < _STILL:
                break
    return fit


def _pairs(source: Level, target: Level, pose: Floats, gate: float) -> _Pairs:
    """Pixels of the source and the pixels of the target on which they fall."""
    camera = target.camera
    known = np.flatnonzero(source.planes[:, 2])
    rotation = pose[:3, :3].astype(np.float32)
    points = source.rays[known] / source.inverse_depth.ravel()[known, None]
    x = points @ rotation.T + pose[:3, 3].astype(np.float32)
    z = np.maximum(x[:, 2], np.float32(1e-6))  # behind the camera: thrown far out of the image
    u = x[:, 0] / z * np.float32(camera.fx) + np.float32(camera.cx)
    v = x[:, 1] / z * np.float32(camera.fy) + np.float32(camera.cy)
    inside = np.flatnonzero((u > 0) & (u < camera.width - 1) & (v > 0) & (v < camera.height - 1))
    x, u, v = x[inside], u[inside], v[inside]
    pixel = np.rint(v).astype(np.int32) * np.int32(camera.width) + np.rint(u).astype(np.int32)
    m = target.planes[pixel]
    relative = np.einsum("ni,ni->n", m, x) - 1
    there = m[:, 2] != 0
    near = there & (np.abs(relative) < gate)
    meet = near & _same_way(source.planes[known[inside]], rotation, m)
    # What falls behind the target's surface is hidden from it and tells nothing; what hangs before it disagrees.
    judged = there & (relative < gate)
    at = np.flatnonzero(meet)
    overlap, agreement = len(at) / max(len(known), 1), len(at) / max(int(np.count_nonzero(judged)), 1)
    return _Pairs(known[inside[at]], pixel[at], x[at], u[at], v[at], relative[at], overlap, agreement)


def _same_way(source: Floats, rotation: Floats, target: Floats) -> Bools:
    turned = source @ rotation.T
    cosine = np.einsum("ni,ni->n", turned, target)
    lengths = np.linalg.norm(turned, axis=1) * np.linalg.norm(target, axis=1)
    same: Bools = cosine > _SAME_WAY * lengths
    return same


def _step(source: Level, target: Level, pairs: _Pairs, pose: Floats, level: int) -> tuple[Fit, float]:
    """One Gauss-Newton step: the fit after it, and its size in radians and shares of the median depth."""
    depth = float(np.median(pairs.x[:, 2]))
    middle = pairs.x.mean(axis=0, dtype=np.float64)
    closer = np.clip(depth / pairs.x[:, 2], _NEAREST, _FARTHEST)
    arms = pairs.x - middle.astype(np.float32)
    planes = closer[:, None] * target.planes[pairs.pixel]
    spread = _spread_of(closer * pairs.relative, _MIN_RELATIVE[level])
    h, b = _normal_equations(planes, arms, closer * pairs.relative, spread)
    if source.grey is not None and target.grey is not None:
        shade, residual = _photometric(source, target, pairs)
        steep = np.abs(target.gradient[pairs.pixel, 1:]).max(axis=1) > _MIN_GRADIENT
        drawn = np.flatnonzero(steep & target.calm[pairs.pixel])
        if len(drawn):
            residual = residual[drawn] - np.median(residual[drawn])
            more = _normal_equations(shade[drawn], arms[drawn], residual, _spread_of(residual, _MIN_GREY[level]))
            h, b = h + more[0], b + more[1]
    # Turns about the points' middle and shifts in units of the distance: then the six weigh alike.
    scale = np.repeat([1.0, depth], 3)
    unit = h * scale[:, None] * scale
    pulls, directions = np.linalg.eigh(unit)
    hold = float(pulls[0] / np.trace(unit)) / (_FEIGNED * (spread * target.camera.fx) ** 2)
    motion = -scale * np.linalg.solve(unit + 1e-9 * np.trace(unit) * np.eye(6), scale * b)
    about = np.eye(6)
    about[3:, :3] = -cross_matrix(middle)
    moved = _moved(pose, motion, middle)
    nudged = _moved(moved, _NUDGE * scale * directions[:, 0], middle)
    fit = Fit(moved, about.T @ h @ about, pairs.overlap, pairs.agreement, hold, nudged)
    return fit, float(np.abs(motion / scale).max())


def _photometric(source: Level, target: Level, pairs: _Pairs) -> tuple[Floats, Floats]:
    """Gradients (K,3) of the target's grey by X, and residuals (K,) without the pictures' difference in exposure."""
    assert source.grey is not None
    camera, (x, y, z) = target.camera, pairs.x.T
    grey, du, dv = target.gradient[pairs.pixel].T
    row, column = np.divmod(pairs.pixel, camera.width)
    residual = grey + du * (pairs.u - column) + dv * (pairs.v - row) - source.grey.ravel()[pairs.index]
    gx, gy = du * np.float32(camera.fx) / z, dv * np.float32(camera.fy) / z
    return np.stack([gx, gy, -(gx * x + gy * y) / z], axis=1), residual


def _spread_of(residual: Floats, least: float) -> float:
    """The standard deviation of most; 1.4826 turns a median into it."""
    return max(1.4826 * float(np.median(np.abs(residual))), least)


def _normal_equations(gradient: Floats, arms: Floats, residual: Floats, spread: float) -> tuple[Floats, Floats]:
    """J'WJ (6,6) and J'Wr (6,) with Cauchy's weights; J = (arm x gradient, gradient) of residuals over their spread."""
    scaled = residual / np.float32(spread)
    weight = 1 / (1 + np.square(scaled / 2))
    # By columns: numpy's own cross product takes three times as long.
    (ax, ay, az), (gx, gy, gz) = arms.T, gradient.T
    turns = (ay * gz - az * gy, az * gx - ax * gz, ax * gy - ay * gx)
    jacobian = np.stack([*turns, gx, gy, gz], axis=1) / np.float32(spread)
    weighted = weight[:, None] * jacobian
    return (weighted.T @ jacobian).astype(np.float64), (weighted.T @ scaled).astype(np.float64)


def _moved(pose: Floats, motion: Floats, middle: Floats) -> Floats:
    """The pose after a turn (radians) about `middle` and a shift: motion (6,) = (ω, t)."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(motion[:3]).as_matrix()
    moved = pose.copy()
    moved[:3, :3] = turn @ pose[:3, :3]
    moved[:3, 3] = turn @ (pose[:3, 3] - middle) + middle + motion[3:]
    return moved


def cross_matrix(a: Floats) -> Floats:
    """(3,3): cross_matrix(a) @ b = a x b."""
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
