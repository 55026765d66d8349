"""Find the vertical from line segments in posed pictures: edges of houses, doors, shelves and posts meet in it.

A segment and its camera span a plane; the edge that it shows lies in that plane, so the plane's normal is at right
angles to the edge. The vertical is at right angles to the normals of many segments in many pictures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Frame, Intrinsics, UpSource, certainty
from capture2vr.edge.parallel import in_threads

_PICTURES = 24
"""Most pictures that are searched, 20 ms each."""
_LONGEST_PX = 640
"""Longer side of the pictures: the detector finds the long edges, and not every brick."""
_LEAST_LENGTH = 0.05
"""Least length of a segment, over the picture's longer side: 30 pixels tell its direction to a degree."""
_AGREE_DEG = 1.0
"""Largest angle between a segment and the vertical that it votes for."""
_TRIES, _ROUNDS = 400, 5
"""Pairs of segments tried, and rounds of least squares after them."""
_LEAST_SEGMENTS, _LEAST_PICTURES = 20, 3
"""Segments, and pictures with any, that must agree."""
_NO_LINES, _ALL_LINES = 0.2, 0.5
"""Share of the length of all nearly vertical segments that agree on one direction: leaves, rubble and fur have up to
the first (by chance 0.07), rooms and streets the second or more."""
_LEAST_SPREAD = 0.02
"""Least variance of the normals along their second axis: planes that are parallel leave their line open."""
_SYSTEMATIC_DEG = 0.5
"""Error that all lines share: lenses, and walls that lean."""


def vertical_lines(frames: Sequence[Frame], held: Floats, within_deg: float) -> tuple[Floats, UpSource] | None:
    """Return the unit vector (3,) along the vertical lines in posed frames and its confidence; None where hardly any.

    held (3,): roughly up, as the cameras were held; within_deg: largest angle of the vertical to it. Where it is
    small, edges of a thing that leans are not taken for the vertical.
    """
    normal, length, picture = _segments(frames)
    near = np.abs(normal @ held) < np.sin(np.radians(within_deg))
    normal, length, picture = normal[near], length[near], picture[near]
    if len(normal) < _LEAST_SEGMENTS:
        return None
    up = _most_agreed(normal, length, held, within_deg)
    if up is None:
        return None
    agree = np.abs(normal @ up) < np.sin(np.radians(_AGREE_DEG))
    spread = np.linalg.eigvalsh(normal[agree].T @ normal[agree] / max(1, agree.sum()))[1]
    if agree.sum() < _LEAST_SEGMENTS or len(np.unique(picture[agree])) < _LEAST_PICTURES or spread < _LEAST_SPREAD:
        return None
    share = float(length[agree].sum() / length.sum())
    doubt = 1 - np.clip((share - _NO_LINES) / (_ALL_LINES - _NO_LINES), 0, 1)
    error_deg = _SYSTEMATIC_DEG + float(np.degrees(np.std(normal[agree] @ up)) / np.sqrt(agree.sum() * spread))
    return up, UpSource("lines", round(certainty(error_deg) * (1 - float(doubt)), 3))


def _segments(frames: Sequence[Frame]) -> tuple[Floats, Floats, Ints]:
    """Find line segments: unit normals (S,3) of their planes in the frame of the poses, lengths (S,) in shares of the
    picture's longer side, and the number (S,) of their picture."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, _PICTURES).astype(int)).tolist()

    def segments_of(number: int) -> tuple[Floats, Floats, Ints]:
        frame = frames[number]
        if frame.load_rgb is None or frame.camera_to_world is None:
            return np.zeros((0, 3)), np.zeros(0), np.zeros(0, int)
        normal, length = _planes(frame.load_rgb(), frame.intrinsics)
        turned = normal @ np.asarray(frame.camera_to_world, np.float64)[:3, :3].T
        return turned, length, np.full(len(length), number)

    normals, lengths, pictures = zip(*in_threads(segments_of, chosen), strict=True)
    return np.concatenate(normals), np.concatenate(lengths), np.concatenate(pictures)


def _planes(rgb: Bytes, camera: Intrinsics) -> tuple[Floats, Floats]:
    """Return the unit normals (S,3) of a picture's segments in the camera's axes, and their lengths (S,)."""
    import cv2

    shrink = min(1.0, _LONGEST_PX / max(rgb.shape[:2]))
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    grey = cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA) if shrink < 1 else grey
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(np.float64)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / max(grey.shape)
    ends, length = ends[length >= _LEAST_LENGTH], length[length >= _LEAST_LENGTH]
    at = camera.scaled_to(grey.shape[1], grey.shape[0])
    rays = np.ones((len(ends), 2, 3))
    rays[..., :2] = (ends - [at.cx, at.cy]) / [at.fx, at.fy]
    normal = np.cross(rays[:, 0], rays[:, 1])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), length


def _most_agreed(normal: Floats, length: Floats, held: Floats, within_deg: float) -> Floats | None:
    """Return the direction (3,) near `held` that the longest segments agree on (RANSAC, then least squares)."""
    pairs = np.random.default_rng(0).integers(len(normal), size=(_TRIES, 2))
    tries = np.cross(normal[pairs[:, 0]], normal[pairs[:, 1]])
    size = np.linalg.norm(tries, axis=1)
    tries = tries[size > _LEAST_SPREAD] / size[size > _LEAST_SPREAD, None]
    tries *= np.sign(tries @ held)[:, None]
    tries = tries[tries @ held > np.cos(np.radians(within_deg))]
    if not len(tries):
        return None
    limit = np.sin(np.radians(_AGREE_DEG))
    up: Floats = tries[int(((np.abs(tries @ normal.T) < limit) @ length).argmax())]
    for _ in range(_ROUNDS):
        agree = np.abs(normal @ up) < limit
        weighted = normal[agree] * length[agree, None]
        up = np.linalg.eigh(weighted.T @ normal[agree])[1][:, 0]
        up = up * np.sign(up @ held)
    return up if up @ held > np.cos(np.radians(within_deg)) else None
