"""Photos of a wide lens: their cameras are found as exactly as those of others, and the lens bends them straight."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.features import Features
from capture2vr.edge.cameras.match_pairs import exhaustive
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem, solve
from capture2vr.edge.cameras.wide_lens import FISHEYE, lens_of_fisheye
from capture2vr.edge.capture.nouns import Intrinsics
from tests.edge.cameras.test_structure_from_motion import centre_errors
from tests.support.scenes import look_at

WIDTH, HEIGHT = 1280, 960
CENTRE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
VIEWS = 12


def fisheye_pixels(local: Floats, focal: float, k1: float, k2: float) -> tuple[Floats, Floats]:
    """Pixels (N,2) of points (N,3) in a fisheye's frame, and their angles (N,) from its axis."""
    across = np.linalg.norm(local[:, :2], axis=1)
    angle = np.arctan2(across, local[:, 2])
    seen_at = focal * angle * (1 + k1 * angle**2 + k2 * angle**4)
    return CENTRE + local[:, :2] / across[:, None] * seen_at[:, None], angle


@given(k1=st.floats(-0.05, 0.05), k2=st.floats(-0.01, 0.01), turn=st.floats(0, 6.28), angle=st.floats(0.01, 0.87))
def test_near_the_axis_the_lens_sees_places_where_the_fisheye_does(
    k1: float, k2: float, turn: float, angle: float
) -> None:
    focal = 667.0
    params = [focal, focal, *(CENTRE + 0.5), k1, k2, 0, 0]
    lens = lens_of_fisheye(pycolmap.Camera(model=FISHEYE, width=WIDTH, height=HEIGHT, params=params))
    place = np.array([[np.cos(turn) * np.tan(angle), np.sin(turn) * np.tan(angle), 1.0]])
    at = lens.intrinsics
    matrix = np.array([[at.fx, 0, at.cx], [0, at.fy, at.cy], [0, 0, 1]])
    found, _ = cv2.projectPoints(place, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    np.testing.assert_allclose(found.reshape(1, 2), fisheye_pixels(place, focal, k1, k2)[0], atol=0.002 * focal)


def room_from_all_sides(half_view: float) -> tuple[SfmProblem, Floats]:
    """Key points that a lens with so many degrees to each side has of an object in a room, and the cameras' places."""
    rng = np.random.default_rng(0)
    focal = WIDTH / 2 / np.radians(half_view)
    walls = rng.uniform(-3, 3, (500, 3)) * [1, 1, 0.5] + np.array([0, 0, 1.5])
    walls[np.arange(500), rng.integers(0, 2, 500)] = rng.choice([-3, 3], 500)
    floor = rng.uniform(-1.5, 1.5, (500, 3)) * [1, 1, 0]
    thing = rng.uniform(-0.25, 0.25, (400, 3)) + np.array([0, 0, 0.25])
    xyz = np.concatenate([thing, floor, walls])
    marks = rng.integers(0, 90, (len(xyz), 128))
    features, eyes = [], []
    for turn in np.linspace(0, 5, VIEWS):
        pose = look_at((np.cos(turn), np.sin(turn), 0.7 + 0.2 * np.sin(3 * turn)), (0, 0, 0.25))
        inverse = np.linalg.inv(pose)
        xy, angle = fisheye_pixels(xyz @ inverse[:3, :3].T + inverse[:3, 3], focal, 0.0, 0.0)
        xy += rng.normal(0, 0.3, xy.shape)
        seen = (angle < 1.3) & ((xy > 0) & (xy < (WIDTH - 1, HEIGHT - 1))).all(axis=1) & (rng.random(len(xyz)) < 0.7)
        noisy = np.clip(marks[seen] + rng.integers(-2, 3, (int(seen.sum()), 128)), 0, 255)
        features.append(Features(xy[seen].astype(np.float32), noisy.astype(np.uint8)))
        eyes.append(pose[:3, 3])
    guess = Lens(Intrinsics(1.2 * WIDTH, 1.2 * WIDTH, *CENTRE, WIDTH, HEIGHT))
    return SfmProblem((guess,), np.zeros(VIEWS, np.int64), tuple(features), exhaustive(VIEWS), 1.0), np.array(eyes)


@pytest.mark.slow
def test_photos_that_span_110_degrees_are_placed_exactly() -> None:
    problem, eyes = room_from_all_sides(55)
    answer = solve(problem)
    assert len(answer.placed) == VIEWS
    assert centre_errors(answer.poses[:, :3, 3], eyes).max() < 3e-4  # 1.4e-3 by one coefficient
    assert answer.lenses[0].intrinsics.fx == pytest.approx(WIDTH / 2 / np.radians(55), rel=2e-3)
