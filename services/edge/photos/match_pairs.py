"""Which photos to hold against each other, and which matches of two photos their known poses allow.

All pairs where that is affordable, else neighbours and a skeleton.
"""

from __future__ import annotations

import math

import numpy as np

from services.edge.arrays import Bools, Floats, Ints

FEW = 30  # photos up to which every pair is tried at once; of 20, neighbours and skeleton placed 10, 2 s earlier
MANY = 100  # photos up to which every pair is ever tried: 4,950 pairs

_WINDOW = 4  # neighbours in the order of the capture; 50 photos purely so: one gap split the model
_WIDE_WINDOW = 12  # where MANY forbids every pair
_STEP = 4  # every 4th photo meets every other 4th: as exact as every pair, at a third of its time
_SKELETON = 100  # photos of the skeleton at most, which keeps the number of pairs linear in that of the photos


def sequential(count: int) -> Ints:
    """Neighbours within 4 and the every-4th skeleton, (M,2) with first < second; every pair of FEW photos."""
    if count <= FEW:
        return exhaustive(count)
    return _neighbours_and_skeleton(count, _WINDOW)


def exhaustive(count: int) -> Ints:
    """Every pair of up to MANY photos, (M,2) with first < second; of more, wider neighbourhoods and the skeleton."""
    if count > MANY:
        return _neighbours_and_skeleton(count, _WIDE_WINDOW)
    return _pairs(np.ones((count, count), np.bool_))


def _neighbours_and_skeleton(count: int, window: int) -> Ints:
    index = np.arange(count)
    chosen = index % max(_STEP, math.ceil(count / _SKELETON)) == 0
    near = np.abs(index[:, None] - index) <= window
    return _pairs(near | (chosen[:, None] & chosen))


def _pairs(wanted: Bools) -> Ints:
    """The pairs above the diagonal of a (N,N) matrix, by first and then second photo."""
    return np.argwhere(np.triu(wanted, 1)).astype(np.int32)


def epipolar_errors(first: Floats, second: Floats, first_pose: Floats, second_pose: Floats) -> Floats:
    """Sampson distances (K,) of matches from what two camera_to_world (4,4) allow; all in units of the focal length.

    first, second (K,2): the matched points in the plane one unit before each camera, x right, y down.
    Richard Hartley, Andrew Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., eq. 11.9.
    """
    second_from_first = np.linalg.inv(second_pose) @ first_pose
    tx, ty, tz = second_from_first[:3, 3]
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ second_from_first[:3, :3]
    one = np.ones((len(first), 1))
    to_second = np.hstack([first, one]) @ essential.T
    to_first = np.hstack([second, one]) @ essential
    algebraic = (np.hstack([second, one]) * to_second).sum(axis=1)
    slope = (to_second[:, :2] ** 2).sum(axis=1) + (to_first[:, :2] ** 2).sum(axis=1)
    # Without a baseline every line vanishes, and every match is allowed.
    errors: Floats = np.abs(algebraic) / np.sqrt(np.maximum(slope, 1e-20))
    return errors
