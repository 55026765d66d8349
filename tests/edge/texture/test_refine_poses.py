"""Refining photos' poses on the mesh: jittered poses come back together, good ones and poor evidence stay."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.texture.refine_poses import SeenPlaces, refine_poses

SIDE = 320  # pixels of a picture


def print_at(xyz: Floats) -> Floats:
    """Smooth random grey (N,) of places on the bumpy ground."""
    rng = np.random.default_rng(1)
    waves = rng.normal(0, 14, (40, 2))
    return 128 + 18 * np.cos(xyz[:, :2] @ waves.T + rng.uniform(0, 7, 40)).sum(axis=1) / np.sqrt(8)


def ground(x: Floats, y: Floats) -> Floats:
    """Height of the ground: bumps tell a turn of the camera from a shift."""
    return 0.08 * np.sin(5 * x) * np.cos(4 * y)


def places(count: int = 6_000) -> Floats:
    x, y = np.random.default_rng(2).uniform(-0.5, 0.5, (2, count))
    return np.column_stack([x, y, ground(x, y)])


def camera(turn: float) -> PosedPicture:
    """A camera about 2 units over the ground, looking down at it."""
    eye = np.array([0.5 * np.cos(turn), 0.5 * np.sin(turn), 2.0])
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross([0, 1.0, 0], ahead)
    right /= np.linalg.norm(right)
    to_camera = np.eye(4)
    to_camera[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    to_camera[:3, 3] = -to_camera[:3, :3] @ eye
    return PosedPicture(
        to_camera, np.full(2, 1.4), np.full(2, 0.5), lambda: np.zeros((SIDE, SIDE, 3), np.uint8), tracked=True
    )


def grey_of(picture: PosedPicture) -> Floats:
    """What the camera sees: rays meet the ground by a few rounds of a fixed-point search."""
    at = (np.arange(SIDE) + 0.5) / SIDE
    x, y = np.meshgrid(at, at)
    rays = (
        np.stack([(x - 0.5) / 1.4, (y - 0.5) / 1.4, np.ones_like(x)], axis=-1).reshape(-1, 3)
        @ picture.to_camera[:3, :3]
    )
    eye = picture.eye
    along = -eye[2] / rays[:, 2]
    for _ in range(30):
        hit = eye + along[:, None] * rays
        along += (ground(hit[:, 0], hit[:, 1]) - hit[:, 2]) / rays[:, 2]
    return print_at(eye + along[:, None] * rays).reshape(SIDE, SIDE).astype(np.float32)


def jittered(picture: PosedPicture, rng: np.random.Generator, px: float) -> PosedPicture:
    """The picture with a pose that is wrong by about so many pixels."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(rng.normal(0, px / SIDE / 1.4 / 2, 3)).as_matrix()
    motion[:3, 3] = rng.normal(0, px / SIDE / 1.4, 3) * [1, 1, 0.3]
    return replace(picture, to_camera=motion @ picture.to_camera)


def errors_px(true: list[PosedPicture], found: list[PosedPicture], xyz: Floats) -> Floats:
    """Mean error of each picture, less what all have in common: together they may lie a little beside the truth."""
    off = np.stack([SIDE * (b.project(xyz)[0] - a.project(xyz)[0]) for a, b in zip(true, found, strict=True)])
    return np.linalg.norm(off - off.mean(axis=0), axis=2).mean(axis=1)


@pytest.fixture(scope="module")
def scene() -> tuple[list[PosedPicture], list[Floats], Floats, list[SeenPlaces]]:
    true = [camera(turn) for turn in np.linspace(0, 2 * np.pi, 9)[:-1]]
    xyz = places()
    everything = SeenPlaces(np.arange(len(xyz)), np.ones(len(xyz), np.float32))
    return true, [grey_of(picture) for picture in true], xyz, [everything] * len(true)


Scene = tuple[list[PosedPicture], list[Floats], Floats, list[SeenPlaces]]


@pytest.mark.slow
def test_wrong_poses_come_back_together(scene: Scene) -> None:
    true, greys, xyz, seen = scene
    rng = np.random.default_rng(3)
    wrong = [jittered(picture, rng, 2.0) for picture in true]
    fractions: list[float] = []
    found = refine_poses(wrong, greys, xyz, seen, fractions.append)
    before, after = errors_px(true, wrong, xyz).mean(), errors_px(true, found, xyz).mean()
    assert before > 1.0
    assert after < 0.3 * before
    assert fractions == sorted(fractions)


@pytest.mark.slow
def test_exposures_may_differ(scene: Scene) -> None:
    true, greys, xyz, seen = scene
    rng = np.random.default_rng(4)
    exposed = [grey * rng.uniform(0.8, 1.2) + rng.uniform(-15, 15) for grey in greys]
    wrong = [jittered(picture, rng, 2.0) for picture in true]
    found = refine_poses(wrong, [np.float32(grey) for grey in exposed], xyz, seen)
    assert errors_px(true, found, xyz).mean() < 0.4 * errors_px(true, wrong, xyz).mean()


@pytest.mark.slow
def test_right_poses_stay_nearly_where_they_are(scene: Scene) -> None:
    true, greys, xyz, seen = scene
    assert errors_px(true, refine_poses(true, greys, xyz, seen), xyz).max() < 0.2


@pytest.mark.slow
def test_poses_from_structure_from_motion_are_kept(scene: Scene) -> None:
    true, greys, xyz, seen = scene
    exact = [replace(picture, tracked=False) for picture in true]
    assert refine_poses(exact, greys, xyz, seen) == exact


@pytest.mark.slow
def test_a_photo_of_something_else_and_one_that_sees_too_little_keep_their_poses(scene: Scene) -> None:
    true, greys, xyz, seen = scene
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(128, 60, (SIDE, SIDE)).astype(np.float32), (0, 0), 2)
    little = SeenPlaces(np.arange(50), np.ones(50, np.float32))
    found = refine_poses(true, [noise, *greys[1:]], xyz, [seen[0], little, *seen[2:]])
    shift = [
        SIDE * np.median(np.linalg.norm(b.project(xyz)[0] - a.project(xyz)[0], axis=1))
        for a, b in zip(true, found, strict=True)
    ]
    assert shift[0] <= 0.03 * SIDE
    assert np.array_equal(found[1].to_camera, true[1].to_camera)


@pytest.mark.slow
def test_plain_pictures_move_nothing_far(scene: Scene) -> None:
    true, _, xyz, seen = scene
    plain: list[Bytes] = [np.full((SIDE, SIDE), 90, np.float32)] * len(true)
    found = refine_poses(true, plain, xyz, seen)
    assert all(np.isfinite(picture.to_camera).all() for picture in found)
    assert errors_px(true, found, xyz).max() < 0.5


def test_nothing_to_align_is_no_error() -> None:
    assert refine_poses([], [], np.zeros((0, 3)), []) == []
