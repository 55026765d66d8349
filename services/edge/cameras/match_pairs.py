"""Choose the pairs of photos to match, and check matches against known poses (epipolar error).

All pairs are matched where that is affordable, else neighbours and a skeleton of every n-th photo.
"""

from __future__ import annotations

import math

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints

FEW = 30  # photos up to which all pairs are matched at once; of 20, neighbours and skeleton placed 10, 2 s earlier
MANY = 100  # photos up to which all pairs, 4,950, are ever matched

_WINDOW = 4  # neighbours on either side in the capture's order; with these alone one gap split the model of 50 photos
_WIDE_WINDOW = 12  # the same for more than MANY photos, where all pairs are too many
_STEP = 4  # every 4th photo is matched with every other 4th: as exact as all pairs, at a third of the time
_PARTNERS = 8  # photos that look most like one; among them are nearly all of its four neighbours
_BESIDE = 2  # neighbours on either side, in the order of the capture, that are matched however they look
_SKELETON = 100  # most photos of the skeleton, which keeps the number of pairs linear in that of the photos


def sequential(count: int) -> Ints:
    """Return pairs (M,2), first < second: neighbours within 4 and the skeleton; all pairs of up to FEW photos."""
    if count <= FEW:
        return exhaustive(count)
    return _neighbours_and_skeleton(count, _WINDOW)


def exhaustive(count: int) -> Ints:
    """Return all pairs (M,2), first < second, of up to MANY photos; of more, wider neighbourhoods and the skeleton."""
    if count > MANY:
        return _neighbours_and_skeleton(count, _WIDE_WINDOW)
    return _pairs(np.ones((count, count), np.bool_))


def with_all(pairs: Ints, chosen: Ints, count: int) -> Ints:
    """Return the pairs (M,2), and those of the chosen photos with all others."""
    wanted = np.zeros((count, count), np.bool_)
    wanted[pairs[:, 0], pairs[:, 1]] = True
    wanted[:, chosen] = True
    wanted[chosen] = True
    return _pairs(wanted)


def promising(alike: Floats, wanted: Ints) -> Ints:
    """Return pairs (M,2), first < second: each wanted photo with the photos most like it, and with its neighbours.

    alike (N,N): how alike two photos are, 0 for not at all. The most promising pairs come first: every photo's best
    partner, then every photo's second best. The last photo is the first one's neighbour: a walk around closes.
    """
    count = len(alike)
    ranked: dict[tuple[int, int], int] = {}
    for one in wanted.tolist():
        best = np.argsort(-alike[one], kind="stable")[:_PARTNERS]
        beside = [(one + step) % count for step in range(-_BESIDE, _BESIDE + 1)]
        for rank, other in enumerate([*best[alike[one, best] > 0].tolist(), *beside]):
            pair = (min(one, other), max(one, other))
            if one != other:
                ranked[pair] = min(rank, ranked.get(pair, rank))
    return np.array(sorted(ranked, key=lambda pair: (ranked[pair], pair)), np.int32).reshape(-1, 2)


def _neighbours_and_skeleton(count: int, window: int) -> Ints:
    """Return the pairs within `window` of each other, and all pairs of the skeleton."""
    index = np.arange(count)
    chosen = index % max(_STEP, math.ceil(count / _SKELETON)) == 0
    near = np.abs(index[:, None] - index) <= window
    return _pairs(near | (chosen[:, None] & chosen))


def _pairs(wanted: Bools) -> Ints:
    """Return the True entries above the diagonal of a matrix (N,N) as pairs, sorted by first, then second photo."""
    return np.argwhere(np.triu(wanted, 1)).astype(np.int32)


def epipolar_errors(first: Floats, second: Floats, first_pose: Floats, second_pose: Floats) -> Floats:
    """Return the Sampson distances (K,) of matches from the epipolar geometry of two camera_to_world (4,4).

    They are in units of the focal length.

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
    # Without a baseline the essential matrix is 0, and every match is allowed.
    errors: Floats = np.abs(algebraic) / np.sqrt(np.maximum(slope, 1e-20))
    return errors
