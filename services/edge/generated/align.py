"""Turn a generated object to where it looks like its photo: by its silhouette, then by its colours. numpy and OpenCV.

M   the object's mask in the photo; S(φ, θ) the object's silhouette, turned by φ about the vertical, from a camera θ
    above the horizon. Both are squares around the object, in pixels
IoU = |M ∩ S| / |M ∪ S|

For each of a grid of φ and θ the size and the place of S follow from the areas and centroids of M and S. Silhouettes
from the front and from behind are alike, so that among those nearly as good as the best one the photo's colours decide.
The best is refined by a simplex search (Nelder and Mead 1965) of all five numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import minimize

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick
from capture2vr.edge.single_photo.photo_window import DISTANCE, GRID, SIDE

_COARSE, _FINE = 64, 192  # pixels along the sides of a silhouette in the grid, and in the simplex search
_COARSE_POINTS = 12_000  # of the object, three to a pixel; at a fine silhouette all are looked at
_TURNS = 7.5  # degrees from one φ of the grid to the next
_HEIGHTS = (0.0, 15.0, 30.0, 45.0)  # θ in degrees: phones are held level, or look down on what stands on a table
_ROUNDS = 3  # in which size and place settle
_PEAKS, _TRIES = 6, 80  # of the grid's poses are refined, so many tries each, before colours decide
_ALIKE = 0.04  # of IoU below the best one, within which they do
_SAME = 4.0  # levels of 255 within which colours are alike: then the least turn counts
_STEPS = (3.0, 3.0, 0.02, 0.01, 0.01)  # with which the search begins: degrees, degrees, share, longer sides
_MOST_TRIES = 150  # of the last search


@dataclass(frozen=True, slots=True)
class Pose:
    """How a generated object stands in the frame of its photo: y up, the camera on the side of +z, the longer side of
    the object's outline 1.

    turn    degrees about the vertical; height: of the camera, degrees over the horizon
    scale   of the object, whose longest side was 1; right, up: of its middle from the optical axis
    iou     of its silhouette and the photo's mask
    """

    turn: float
    height: float
    scale: float = 1.0
    right: float = 0.0
    up: float = 0.0
    iou: float = 0.0

    def placed(self, xyz: Floats) -> Floats:
        """Turn and scale points (N,3), whose bounding box is around 0 with longest side 1; Y stays up."""
        turned: Floats = self.scale * xyz @ _about_y(self.turn).T
        return turned


def align(xyz: Floats, rgb: Bytes | None, mask: Bools, photo: Bytes, tick: Tick = no_tick) -> Pose:
    """Find the pose in which an object looks most like its photo.

    xyz    (N,3) points all over its surface, Y up, their bounding box around 0 with longest side 1; rgb (N,3) or None
    mask   (S,S) of the object in the square around it; photo (S',S',3) uint8 sRGB, of the same square
    """
    every = -(-len(xyz) // _COARSE_POINTS)
    some, colours = xyz[::every], None if rgb is None else rgb[::every]
    coarse = _shrunk(mask, _COARSE)
    turned = []
    turns = np.arange(0.0, 360.0, _TURNS)
    for number, turn in enumerate(turns):
        poses = (_settled(Pose(float(turn), height), some, coarse) for height in _HEIGHTS)
        turned.append(max(poses, key=lambda pose: pose.iou))
        tick(0.5 * (number + 1) / len(turns))
    found = [_refined(pose, some, coarse, _TRIES) for pose in _peaks(turned)]
    tick(0.7)
    least = max(pose.iou for pose in found) - _ALIKE
    seen = np.asarray(cv2.resize(photo, (_COARSE, _COARSE), interpolation=cv2.INTER_AREA), np.float64)
    alike = [pose for pose in found if pose.iou >= least]
    best = _refined(
        min(alike, key=lambda pose: _unlike(pose, some, colours, coarse, seen)), xyz, _shrunk(mask, _FINE), _MOST_TRIES
    )
    tick(1.0)
    return best


def _peaks(turned: Sequence[Pose]) -> list[Pose]:
    """The best of the poses, one for each turn, that are better than their neighbours."""
    round_about = zip([turned[-1], *turned[:-1]], turned, [*turned[1:], turned[0]], strict=True)
    peaks = [pose for before, pose, after in round_about if before.iou <= pose.iou >= after.iou]
    return sorted(peaks, key=lambda pose: -pose.iou)[:_PEAKS]


def _refined(start: Pose, xyz: Floats, mask: Bools, tries: int) -> Pose:
    """Refine a pose by the IoU with a mask."""
    numbers = _numbers(start)
    found = minimize(
        lambda numbers: 1 - _iou(_pose(numbers), xyz, mask),
        numbers,
        method="Nelder-Mead",
        options={"initial_simplex": np.vstack([numbers, numbers + np.diag(_STEPS)]), "maxfev": tries},
    )
    return replace(_pose(found.x), iou=1 - float(found.fun))


def _settled(pose: Pose, xyz: Floats, mask: Bools) -> Pose:
    """Fit size and place of a pose to a mask, by the areas and the centroids of both silhouettes."""
    wanted, area = _centroid(mask), mask.sum()
    for _ in range(_ROUNDS):
        seen = _silhouette(pose, xyz, len(mask))
        if not seen.any():
            return pose
        by = float(np.sqrt(area / seen.sum()))
        off = (wanted - _centroid(seen)) * SIDE / GRID / len(mask)
        pose = replace(pose, scale=pose.scale * by, right=pose.right + off[0], up=pose.up - off[1])
    return replace(pose, iou=_iou(pose, xyz, mask))


def _unlike(pose: Pose, xyz: Floats, rgb: Bytes | None, mask: Bools, photo: Floats) -> tuple[int, float, float]:
    """How much less a pose is like the photo: by colours, then by its turn from how it was made, then by silhouette."""
    away = abs((pose.turn + 180) % 360 - 180)
    if rgb is None:
        return 0, away, -pose.iou
    column, row, near = _pixels(pose, xyz, len(mask))
    order = np.argsort(near)  # the nearest comes last, and stays
    drawn = np.full((*mask.shape, 3), np.nan)
    drawn[row[order], column[order]] = rgb[order]
    both = mask & np.isfinite(drawn[..., 0])
    differs = float(np.abs(drawn[both] - photo[both]).mean()) if both.any() else 255.0
    return int(differs / _SAME), away, -pose.iou


def _iou(pose: Pose, xyz: Floats, mask: Bools) -> float:
    seen = _silhouette(pose, xyz, len(mask))
    return float((mask & seen).sum() / max(1, (mask | seen).sum()))


def _silhouette(pose: Pose, xyz: Floats, side: int) -> Bools:
    """The silhouette (side,side) of points, whose gaps are closed."""
    column, row, _ = _pixels(pose, xyz, side)
    drawn = np.zeros((side, side), np.uint8)
    drawn[row, column] = 1
    return np.asarray(cv2.morphologyEx(drawn, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0)


def _pixels(pose: Pose, xyz: Floats, side: int) -> tuple[Ints, Ints, Floats]:
    """Columns and rows (M,) of the points that a picture of side × side pixels shows, and how near they are."""
    x, y, z = (pose.scale * xyz @ (_about_x(pose.height) @ _about_y(pose.turn)).T).T
    by = DISTANCE / np.maximum(DISTANCE - z, 0.1) * GRID / SIDE * side
    column = np.floor(side / 2 + by * (x + pose.right)).astype(np.int64)
    row = np.floor(side / 2 - by * (y + pose.up)).astype(np.int64)
    shown = (column >= 0) & (column < side) & (row >= 0) & (row < side)
    return column[shown], row[shown], z[shown]


def _about_y(degrees: float) -> Floats:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_x(degrees: float) -> Floats:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _centroid(mask: Bools) -> Floats:
    """The centroid (column, row) of a mask that is not empty."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def _shrunk(mask: Bools, side: int) -> Bools:
    return np.asarray(cv2.resize(255 * mask.astype(np.uint8), (side, side), interpolation=cv2.INTER_AREA) >= 128)


def _numbers(pose: Pose) -> Floats:
    return np.array([pose.turn, pose.height, pose.scale, pose.right, pose.up])


def _pose(numbers: Floats) -> Pose:
    turn, height, scale, right, up = (float(number) for number in numbers)
    return Pose(turn, height, scale, right, up)
