"""Inflate an outline like a membrane: a closed shape whose outline from the front is that of a mask.

The height above the middle plane is the root of a function H of the place, which is 0 on the outline:

    h = √H,   H = T² · u / L²   with   Δu − u / L² = −1 inside of the outline, u = 0 on it

A disc without a limit to its width (L = ∞, H = 4 k² u) becomes an ellipsoid whose half thickness is k radii, since
u = (R² − r²) / 4 there; a strip, the middle of something long, a cylinder √2 k half widths thick. With a limit L, what
is wider than a few L is a plate of half thickness T with rounded edges. The surface is where H − z² = 0: marching
cubes give it closed, with an edge that is round. It is symmetric, or its front is higher than its back by a ratio that
is given for each place: there it is where H − (z / ratio)² = 0. numpy, scipy and scikit-image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.single_photo.outline_kind import Inflation

_SMOOTH = 1.0  # pixels: the outline is smoothed by so much, because a mask's is a staircase
_EDGE = 1.5  # pixels: half the thickness of the thinnest parts; a field of distances would merge sheets nearer together
_RATIO = 2.0  # pixels over which the slope of H at the outline is averaged: there a solution on pixels is rough
_DEEP = 4.0  # pixels from the outline from which on H is the solution alone


@dataclass(frozen=True, slots=True)
class Membrane:
    """An inflated mask: H (h,w) in square pixels, negative outside; its root is the height over the middle plane.

    ratio  (h,w) > 0, of the front's height to that
    """

    squared: Floats
    ratio: Floats | float = 1.0

    @property
    def height(self) -> Floats:
        """Height (h,w) of the back in pixels over the middle plane; 0 outside."""
        return np.asarray(np.sqrt(np.maximum(self.squared, 0)))

    @property
    def front(self) -> Floats:
        """Height (h,w) of the front in pixels over the middle plane; 0 outside."""
        return np.asarray(self.height * self.ratio)


def inflate(mask: Bools, inflation: Inflation) -> Membrane:
    """Inflate a mask (h,w) that does not touch the picture's border."""
    within = _signed_distance(mask)
    solved = _solve(within > 0, inflation.limit)
    solved *= (inflation.thickness / inflation.limit) ** 2 if inflation.limit else 4 * inflation.thickness**2
    deep = np.clip(within / _DEEP, 0, 1)
    squared = deep * solved + (1 - deep) * _slope(solved, within) * within
    return Membrane(squared + _edge(within))


def closed_mesh(membrane: Membrane) -> Mesh:
    """Mesh of the surface, closed; x to the right, y up, z to the front, in pixels from the picture's middle."""
    from skimage.measure import marching_cubes  # half a second to load

    squared = membrane.squared
    half, front = (int(np.ceil(each.max())) + 2 for each in (membrane.height, membrane.front))
    z = np.arange(-half, front + 1, dtype=np.float32)
    ratio = np.broadcast_to(np.asarray(membrane.ratio, np.float32), squared.shape)
    solid = squared.astype(np.float32)[..., None] - (z / np.where(z > 0, ratio[..., None], 1)) ** 2
    vertices, faces, _, _ = marching_cubes(solid, 0.0)  # type: ignore[no-untyped-call]
    rows, columns, depth = vertices.T.astype(np.float64)
    height, width = squared.shape
    xyz = np.stack([columns - (width - 1) / 2, (height - 1) / 2 - rows, depth - half], axis=1)
    return Mesh(xyz, np.ascontiguousarray(faces[:, ::-1], np.int32))


def _signed_distance(mask: Bools) -> Floats:
    """Distance (h,w) in pixels to the smoothed outline, negative outside."""
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _SMOOTH)
    inside = soft > 0.5
    away = [cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (inside, ~inside)]
    # Beside the outline the soft mask tells its place between pixels: its slope there is that of a Gaussian's integral.
    near = (soft - 0.5) * np.sqrt(2 * np.pi) * _SMOOTH
    far = np.where(inside, away[0] - 0.5, 0.5 - away[1])
    return np.asarray(np.where(np.abs(far) < 1, near, far), np.float64)


def _solve(inside: Bools, limit: float) -> Floats:
    """u (h,w) of the equation above, 0 outside; limit: L in pixels, 0 where there is none."""
    height, width = inside.shape
    count = int(inside.sum())
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(count)
    rows, columns = np.nonzero(inside)
    own = number[inside]
    centre = np.full(count, 4.0 + (1 / limit**2 if limit else 0.0))
    entries = [(own, own, centre)]
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        other = number[np.clip(rows + down, 0, height - 1), np.clip(columns + right, 0, width - 1)]
        beside = other >= 0
        entries.append((own[beside], other[beside], np.full(int(beside.sum()), -1.0)))
    row, column, value = (np.concatenate(each) for each in zip(*entries, strict=True))
    u = np.zeros(inside.shape)
    u[inside] = spsolve(csr_matrix((value, (row, column)), (count, count)), np.ones(count))
    return u


def _slope(solved: Floats, within: Floats) -> Floats:
    """Slope (h,w) of H across the outline, also outside: what H is over the distance, averaged along the outline."""
    weight = np.maximum(within, 0)
    total, norm = 1e-12 * solved, np.full(solved.shape, 1e-12)
    for sigma, share in ((_RATIO, 1.0), (4 * _RATIO, 1e-6)):  # the second only where the first reaches nothing
        total = total + share * cv2.GaussianBlur(solved * weight, (0, 0), sigma)
        norm = norm + share * cv2.GaussianBlur(weight * weight, (0, 0), sigma)
    return np.asarray(total / norm)


def _edge(within: Floats) -> Floats:
    """What is added to H (h,w), so that the edge is round and no part is thinner than a field can tell."""
    return np.where(within < _EDGE, within * (2 * _EDGE - np.maximum(within, -_EDGE)), _EDGE**2)
