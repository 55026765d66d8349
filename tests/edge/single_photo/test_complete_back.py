"""The back of what few photos show: proposed behind the measured front, and nowhere that a photo contradicts it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.origin import MEASURED, PROPOSED
from capture2vr.edge.points.nouns import Points, TextureView
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.single_photo.complete_back import complete_back
from tests.support.scenes import look_at

CAMERA = Intrinsics(300.0, 300.0, 119.5, 119.5, 240, 240)
AWAY, WALL = 3.0, 9.0
EYES = [AWAY * np.array([np.sin(turn), -np.cos(turn), 0.2]) for turn in np.radians([-15, 0, 15])]


def depth_of_ball(pose: Floats) -> Floats:
    """(240,240) depth of the unit ball at the origin before a wall."""
    v, u = np.indices((240, 240))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    turned = rays @ pose[:3, :3].T
    a, b, c = (turned**2).sum(-1), turned @ pose[:3, 3], float(pose[:3, 3] @ pose[:3, 3]) - 1
    inside = b * b - a * c
    near = (-b - np.sqrt(np.maximum(inside, 0))) / a
    return np.where(inside > 0, near, WALL).astype(np.float32)


def view(eye: Floats, depth: Floats | None = None) -> TextureView:
    pose = look_at(eye, [0.0, 0, 0])
    shown = depth_of_ball(pose) if depth is None else depth
    return TextureView(CAMERA, pose, partial(np.zeros, (240, 240, 3), np.uint8), partial(np.copy, shown))


def seen_half() -> Floats:
    """(N,3) points of the ball that the cameras see, evenly spread."""
    number = np.arange(8_000) + 0.5
    polar, turn = np.arccos(1 - 2 * number / 8_000), np.pi * (1 + 5**0.5) * number
    xyz = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)
    towards = np.stack([xyz @ eye for eye in EYES], axis=1)
    return xyz[(towards > 1.0).any(axis=1)]


FRONT = seen_half()


def ball(*more: TextureView) -> Points:
    """The ball as its cameras see it, red."""
    rgb = np.tile(np.array([200, 40, 30], np.uint8), (len(FRONT), 1))
    sure = np.ones(len(FRONT), np.float32)
    views = (*map(view, EYES), *more)
    return Points(FRONT, rgb, sure, 1.0, "unknown", None, texture_views=views)


def test_a_ball_that_is_seen_from_one_side_gets_a_back_which_is_marked_as_a_guess() -> None:
    made = complete_back(ball(), None)
    assert made.origin is not None
    assert made.rgb is not None
    back = made.xyz[len(FRONT) :]
    np.testing.assert_array_equal(made.xyz[: len(FRONT)], FRONT, "what was measured stays")
    assert (made.origin[: len(FRONT)] == MEASURED).all()
    assert (made.origin[len(FRONT) :] == PROPOSED).all()
    assert (made.confidence[len(FRONT) :] <= 0.2).all()
    assert len(back) > 0.5 * len(FRONT)
    off = np.abs(np.linalg.norm(back, axis=1) - 1)
    assert off.max() < 0.4, "nobody saw it, but balls have round backs: a flat lid would lie 0.9 off"
    hidden = trueback()
    assert np.quantile(cKDTree(made.xyz).query(hidden)[0], 0.95) < 0.4, "and it is there all over"
    red, green, blue = made.rgb[len(FRONT) :].T.astype(int)
    assert (red > green + 50).all()
    assert (red > blue + 50).all(), "coloured as the front is"


def trueback() -> Floats:
    """(M,3) points of the side that no camera sees."""
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(2_000, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    return xyz[(np.stack([xyz @ eye for eye in EYES], axis=1) < 0).all(axis=1)]


def test_it_keeps_apart_from_what_is_known() -> None:
    made = complete_back(ball(), None)
    spacing = np.median(cKDTree(FRONT).query(FRONT, k=2)[0][:, 1])
    assert cKDTree(FRONT).query(made.xyz[len(FRONT) :])[0].min() > spacing


def test_a_shell_into_which_a_photo_looks_from_behind_stays_open() -> None:
    behind = view(np.array([0.0, AWAY, 0]), np.full((240, 240), AWAY + 0.9, np.float32))
    points = ball(behind)
    assert complete_back(points, None) is points


def test_it_stands_on_its_plane_and_never_goes_below() -> None:
    low = FRONT[:, 2].min() + 0.3
    plane = Plane(np.array([0.0, 0, 1]), low, 0.0, 1.0)
    made = complete_back(ball(), plane)
    back = made.xyz[len(FRONT) :]
    assert plane.height(back).min() >= -1e-9
    assert (plane.height(back) < 1e-9).any(), "it has a base there"


NO_DEPTH = view(EYES[0], np.zeros((240, 240), np.float32))


@pytest.mark.parametrize("views", [(), (NO_DEPTH,)], ids=["no photo", "no depth"])
def test_without_a_photo_that_shows_it_nothing_is_proposed(views: tuple[TextureView, ...]) -> None:
    points = Points(FRONT, None, np.ones(len(FRONT), np.float32), 1.0, "unknown", None, texture_views=views)
    assert complete_back(points, None) is points
