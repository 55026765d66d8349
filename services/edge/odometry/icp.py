"""Align two depth images: projective point-to-plane ICP with a photometric term, coarse to fine.

Symbols: q = inverse depth (1/m) of the target's pixel (u, v); m = (∂q/∂x, ∂q/∂y, q - x·∂q/∂x - y·∂q/∂y) its plane, so
that m·X = 1 for every X (3,) of the plane; X = T·p a point of the source in the target's frame. The residual m·X - 1 is
the relative depth by which X misses the plane, however far from the pixel's centre it projects. A small motion (ω, t)
moves X by t + ω×X, and the residual by m·t + (X×m)·ω. The photometric residual is I(π(X)) - I(p), with the gradient of
I(π(X)) by X in place of m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.odometry.pyramid import LEVELS, PyramidLevel

_ITERATIONS = (12, 8, 5)
"""Most iterations, from coarse to fine."""
_GATES = (0.12, 0.06, 0.03)
"""Largest relative depth difference of a pair, from coarse to fine."""
_SAME_WAY = 0.6
"""Least cosine between two normals of one surface."""
_STILL = 2e-5
"""Step size that ends a level, in radians and shares of the distance: a tenth of the error that noise leaves."""
_MIN_RELATIVE, _MIN_GREY = (0.01, 0.004, 0.001), (0.04, 0.02, 0.01)
"""Least spread assumed for the residuals, from coarse to fine: relative depth, and grey of 0 to 1. On the finest level
no sensor is better, even if its quantised depth looks so; on the coarse ones, a table that already fits must not make
the objects on it outliers."""
_MIN_GRADIENT = 0.01
"""Least gradient used, grey per pixel: five times that of a noisy picture after blurring. Noise must not constrain the
camera."""
_NEAREST, _FARTHEST = 0.3, 3.0
"""Bounds of the weight (median depth / depth): the relative noise of depth grows with depth."""
_MIN_OVERLAP, _MIN_AGREEMENT = 0.2, 0.92
"""Least shares, as in `IcpFit`. Right poses have an agreement of 0.97 and more, many wrong ones in furnished rooms up
to 0.85."""
_NOISE_HOLD = 0.001
"""Share of the constraint that noise alone gives the weakest direction, as the noisy normals of a bare wall do, over
(spread · focal length)². Measured on rendered walls, noise of 0.1 to 2 %, 256 and 320 pixels: 0.0002 to 0.001."""
_MIN_HOLD, _FIRM_HOLD = 4.0, 40.0
"""Below the first, only noise may constrain a direction: 0.2 to 1.2 on rendered walls, 1 to 5 where rooms slid. Between
the two, aligning again from a perturbed pose decides."""
_PERTURBATION = 0.02
"""Size of that perturbation in radians and shares of the median depth: well beyond the noise, well within the
convergence range of the alignment."""
_BACK = 0.3
"""Largest share of the perturbation that may remain after the alignment, if the pose is constrained."""
MIN_PAIRS = 300
"""Least number of pixel pairs; fewer do not determine six unknowns."""


@dataclass(frozen=True, slots=True)
class IcpFit:
    """Result of aligning a source to a target.

    pose         (4,4) float64, source to target
    information  (6,6) of the motion (ω, t) in the target's frame, per rad² and m²: J'WJ over the residuals' variance
    overlap      share of the source's pixels that match a surface of the target
    agreement    of the pixels that project to a known pixel of the target and not behind it, the share that match it
    hold         constraint of the weakest direction of motion, in multiples of what noise alone gives: 1 on a wall
    perturbed       (4,4) the pose, perturbed in that direction
    """

    pose: Floats
    information: Floats
    overlap: float
    agreement: float
    hold: float
    perturbed: Floats

    @property
    def sound(self) -> bool:
        """Whether the pose is reliable: enough overlap, agreement and constraint."""
        return self.overlap > _MIN_OVERLAP and self.agreement > _MIN_AGREEMENT and self.hold > _MIN_HOLD


@dataclass(frozen=True, slots=True)
class _Correspondences:
    """Matched pixels of source and target.

    index (K,) into the source's pixels, pixel (K,) of the target, x (K,3) points in the target's frame, u, v (K,) their
    projections; relative (K,) residuals; overlap and agreement as in `IcpFit`.
    """

    index: Ints
    pixel: Ints
    x: Floats
    u: Floats
    v: Floats
    relative: Floats
    overlap: float
    agreement: float


def align(source: tuple[PyramidLevel, ...], target: tuple[PyramidLevel, ...], guess: Floats) -> IcpFit | None:
    """Align the source to the target from an initial pose `guess` (4,4); None where too few pixels match.

    If the pose is weakly constrained, it is perturbed and aligned again: if it does not return, it can slide along the
    surface, and `hold` is 0.
    """
    fit = _align_levels(source, target, guess, range(LEVELS))
    if fit is None or not _MIN_HOLD < fit.hold < _FIRM_HOLD:
        return fit
    back = _align_levels(source, target, fit.perturbed, range(1, LEVELS))
    left = np.inf if back is None else float(np.linalg.norm(back.pose - fit.pose))
    return fit if left < _BACK * float(np.linalg.norm(fit.perturbed - fit.pose)) else replace(fit, hold=0.0)


def _align_levels(
    source: tuple[PyramidLevel, ...], target: tuple[PyramidLevel, ...], guess: Floats, levels: range
) -> IcpFit | None:
    """Run ICP over the levels from coarse to fine; None where too few pixels match."""
    pose: Floats = np.asarray(guess, np.float64)
    fit: IcpFit | None = None
    for level in levels:
        here, there = source[level], target[level]
        for _ in range(_ITERATIONS[level]):
            pairs = _match_pixels(here, there, pose, _GATES[level])
            if len(pairs.index) < MIN_PAIRS * here.inverse_depth.size / source[-1].inverse_depth.size:
                return None
            fit, step = _gauss_newton_step(here, there, pairs, pose, level)
            pose = fit.pose
            if step < _STILL:
                break
    return fit


def _match_pixels(source: PyramidLevel, target: PyramidLevel, pose: Floats, gate: float) -> _Correspondences:
    """Match the source's pixels with the target's pixels to which they project (projective data association)."""
    camera = target.camera
    known = np.flatnonzero(source.planes[:, 2])
    rotation = pose[:3, :3].astype(np.float32)
    points = source.rays[known] / source.inverse_depth.ravel()[known, None]
    x = points @ rotation.T + pose[:3, 3].astype(np.float32)
    z = np.maximum(x[:, 2], np.float32(1e-6))  # points behind the camera project far outside the image
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
    # A point behind the target's surface is occluded and does not count; a point in front of it is a disagreement.
    judged = there & (relative < gate)
    at = np.flatnonzero(meet)
    overlap, agreement = len(at) / max(len(known), 1), len(at) / max(int(np.count_nonzero(judged)), 1)
    return _Correspondences(known[inside[at]], pixel[at], x[at], u[at], v[at], relative[at], overlap, agreement)


def _same_way(source: Floats, rotation: Floats, target: Floats) -> Bools:
    """Return a mask (N,): True where the normals of both planes (N,3) agree within `_SAME_WAY`."""
    turned = source @ rotation.T
    cosine = np.einsum("ni,ni->n", turned, target)
    lengths = np.linalg.norm(turned, axis=1) * np.linalg.norm(target, axis=1)
    same: Bools = cosine > _SAME_WAY * lengths
    return same


def _gauss_newton_step(
    source: PyramidLevel, target: PyramidLevel, pairs: _Correspondences, pose: Floats, level: int
) -> tuple[IcpFit, float]:
    """Do one Gauss-Newton step: return the fit after it, and its size in radians and shares of the median depth."""
    depth = float(np.median(pairs.x[:, 2]))
    middle = pairs.x.mean(axis=0, dtype=np.float64)
    closer = np.clip(depth / pairs.x[:, 2], _NEAREST, _FARTHEST)
    arms = pairs.x - middle.astype(np.float32)
    planes = closer[:, None] * target.planes[pairs.pixel]
    spread = _robust_spread(closer * pairs.relative, _MIN_RELATIVE[level])
    h, b = _normal_equations(planes, arms, closer * pairs.relative, spread)
    if source.grey is not None and target.grey is not None:
        shade, residual = _photometric(source, target, pairs)
        steep = np.abs(target.gradient[pairs.pixel, 1:]).max(axis=1) > _MIN_GRADIENT
        drawn = np.flatnonzero(steep & target.off_edges[pairs.pixel])
        if len(drawn):
            residual = residual[drawn] - np.median(residual[drawn])
            more = _normal_equations(shade[drawn], arms[drawn], residual, _robust_spread(residual, _MIN_GREY[level]))
            h, b = h + more[0], b + more[1]
    # Rotations about the points' centre and translations in units of the distance make the six unknowns comparable.
    scale = np.repeat([1.0, depth], 3)
    unit = h * scale[:, None] * scale
    pulls, directions = np.linalg.eigh(unit)
    hold = float(pulls[0] / np.trace(unit)) / (_NOISE_HOLD * (spread * target.camera.fx) ** 2)
    motion = -scale * np.linalg.solve(unit + 1e-9 * np.trace(unit) * np.eye(6), scale * b)
    about = np.eye(6)
    about[3:, :3] = -cross_matrix(middle)
    moved = _apply_motion(pose, motion, middle)
    perturbed = _apply_motion(moved, _PERTURBATION * scale * directions[:, 0], middle)
    fit = IcpFit(moved, about.T @ h @ about, pairs.overlap, pairs.agreement, hold, perturbed)
    return fit, float(np.abs(motion / scale).max())


def _photometric(source: PyramidLevel, target: PyramidLevel, pairs: _Correspondences) -> tuple[Floats, Floats]:
    """Return the gradients (K,3) of the target's grey by X, and the photometric residuals (K,).

    The caller subtracts the median of the residuals, the pictures' difference in exposure.
    """
    assert source.grey is not None
    camera, (x, y, z) = target.camera, pairs.x.T
    grey, du, dv = target.gradient[pairs.pixel].T
    row, column = np.divmod(pairs.pixel, camera.width)
    residual = grey + du * (pairs.u - column) + dv * (pairs.v - row) - source.grey.ravel()[pairs.index]
    gx, gy = du * np.float32(camera.fx) / z, dv * np.float32(camera.fy) / z
    return np.stack([gx, gy, -(gx * x + gy * y) / z], axis=1), residual


def _robust_spread(residual: Floats, least: float) -> float:
    """Estimate the standard deviation robustly from the median (1.4826 is its factor); at least `least`."""
    return max(1.4826 * float(np.median(np.abs(residual))), least)


def _normal_equations(gradient: Floats, arms: Floats, residual: Floats, spread: float) -> tuple[Floats, Floats]:
    """Build J'WJ (6,6) and J'Wr (6,) with Cauchy weights; J = (arm x gradient, gradient) of residuals over spread."""
    scaled = residual / np.float32(spread)
    weight = 1 / (1 + np.square(scaled / 2))
    # Cross product by columns: numpy.cross takes three times as long.
    (ax, ay, az), (gx, gy, gz) = arms.T, gradient.T
    turns = (ay * gz - az * gy, az * gx - ax * gz, ax * gy - ay * gx)
    jacobian = np.stack([*turns, gx, gy, gz], axis=1) / np.float32(spread)
    weighted = weight[:, None] * jacobian
    return (weighted.T @ jacobian).astype(np.float64), (weighted.T @ scaled).astype(np.float64)


def _apply_motion(pose: Floats, motion: Floats, middle: Floats) -> Floats:
    """Return the pose after a rotation (radians) about `middle` and a translation: motion (6,) = (ω, t)."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(motion[:3]).as_matrix()
    moved = pose.copy()
    moved[:3, :3] = turn @ pose[:3, :3]
    moved[:3, 3] = turn @ (pose[:3, 3] - middle) + middle + motion[3:]
    return moved


def cross_matrix(a: Floats) -> Floats:
    """Return the skew-symmetric matrix (3,3) of a vector: cross_matrix(a) @ b = a x b."""
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
