"""Tell photos whose camera only turned from those whose camera moved: only these show how far away things are.

Between photos from one spot every point moves as by the homography K·R·K⁻¹ of a rotation R, whatever its distance, and
one focal length makes all of these rotations. Structure from motion does not see that: it takes the turn for a walk
past a bent sheet. Richard Hartley, Andrew Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., ch. 8.4 and
19.3. Photos of a plane differ by homographies too, but not by rotations.
"""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Floats, evenly
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.structure_from_motion import project
from capture2vr.edge.capture.nouns import WALK_AROUND_ADVICE
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_STEPS = (1, 2, 4)  # between the two photos of a pair, in the order of the capture
_MOST_PAIRS = 60  # 0.3 s
_FEWEST = 30  # points that a pair shares
_MOVED = 0.02  # longer sides: least median movement of a pair's points; a smaller one says nothing
# Longer sides: 90th percentile of the distances from the homography. A turn on the spot has 0.0003, a walk around a
# thing on a table 0.05 and more.
_EXACT = 0.003
# Norm of AᵀA - 1 for A = K⁻¹·H·K of determinant 1. A turn on the spot has 0.01, a walk along a picture on a wall 0.1.
_ROTATION = 0.03
_FOCALS = np.geomspace(0.3, 6.0, 80)  # longer sides: from a phone's widest lens to its longest


def require_parallax(alignment: Alignment) -> None:
    """Raise CAPTURE_DEGENERATE when the photos were all taken from one spot, or show only what is far away."""
    pairs = _homographies(alignment)
    if not pairs or not all(exact for _, _, exact in pairs):
        return
    if min(np.median([_off_rotation(h, size, focal) for h, size, _ in pairs]) for focal in _FOCALS) > _ROTATION:
        return
    first, last = alignment.views[0].photo.name, alignment.views[-1].photo.name
    reason = say("from_to_camera_turned", first=first, last=last)
    raise CaptureError(
        "CAPTURE_DEGENERATE", reason, hints=(say("walk_while_you_take_them", advice=WALK_AROUND_ADVICE),)
    )


def _homographies(alignment: Alignment) -> list[tuple[Floats, tuple[int, int], bool]]:
    """Return for pairs of photos the homography between their points, their size, and whether it fits all of them."""
    seen = [np.sort(alignment.seen_point[alignment.seen_view == number]) for number in range(len(alignment.views))]
    count = len(alignment.views)
    pairs = [(first, first + step) for step in _STEPS for first in range(count - step)]
    found = []
    for first, second in evenly(pairs, _MOST_PAIRS):
        views = alignment.views[first], alignment.views[second]
        common = np.intersect1d(seen[first], seen[second])
        if views[0].photo.size == views[1].photo.size and len(common) >= _FEWEST:
            found += _homography(*views, alignment.xyz[common])
    return found


def _homography(first: PhotoView, second: PhotoView, xyz: Floats) -> list[tuple[Floats, tuple[int, int], bool]]:
    """Return the homography (3,3) between the pictures of points (K,3); nothing where they hardly moved."""
    longest = max(first.photo.size)
    here, there = project(first, xyz), project(second, xyz)
    if np.median(np.linalg.norm(there - here, axis=1)) < _MOVED * longest:
        return []
    matrix, _ = cv2.findHomography(here, there, cv2.LMEDS)
    if matrix is None or abs(np.linalg.det(matrix)) < np.finfo(np.float64).eps:
        return [(np.eye(3), first.photo.size, False)]
    off = np.linalg.norm(cv2.perspectiveTransform(here[:, None], matrix)[:, 0] - there, axis=1)
    return [(np.asarray(matrix), first.photo.size, bool(np.percentile(off, 90) < _EXACT * longest))]


def _off_rotation(homography: Floats, size: tuple[int, int], focal: float) -> float:
    """Compare a homography with a pure camera rotation: return their distance, as a share of the longer side."""
    width, height = size
    f = focal * max(size)
    camera = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    turn = np.linalg.inv(camera) @ homography @ camera
    turn /= np.cbrt(np.linalg.det(turn))
    return float(np.linalg.norm(turn.T @ turn - np.eye(3)))
