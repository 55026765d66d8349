"""Cameras that only turn are told from those that move, whatever the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.parallax import require_parallax
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.errors import CaptureError
from tests.support.scenes import look_at


def aligned(poses: Floats, xyz: Floats, focal: float, noise_px: float = 0.0) -> Alignment:
    """Cameras (N,4,4) that all see all points (K,3); `noise_px` moves the points as seen, by moving the points."""
    camera = Intrinsics(focal, focal, 319.5, 239.5, 640, 480)
    photo = Photo("", (640, 480), "phone", lambda longest=None: np.zeros((480, 640, 3), np.uint8))
    views = tuple(
        PhotoView(replace(photo, name=f"{number}.jpg"), camera, (0.0,) * 5, pose)  # type: ignore[arg-type]
        for number, pose in enumerate(poses)
    )
    seen = np.arange(len(poses)).repeat(len(xyz))
    return Alignment(views, xyz, np.tile(np.arange(len(xyz)), len(poses)), seen, noise_px, ())


def cloud(seed: int, flat: bool = False) -> Floats:
    xyz = np.random.default_rng(seed).uniform(-1, 1, (200, 3))
    return xyz * [1, 0, 1] if flat else xyz


@pytest.mark.slow
@given(st.integers(0, 10**6), st.floats(300, 2000), st.floats(3, 8))  # smaller turns move too little to tell
def test_a_camera_that_only_turns_shows_no_parallax(seed: int, focal: float, turn: float) -> None:
    poses = np.tile(np.eye(4), (7, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("yx", np.outer(np.arange(7), [turn, 0.3 * turn]), degrees=True).as_matrix()
    poses[:, :3, 3] = [0, -4, 0.5]
    with pytest.raises(CaptureError) as caught:
        require_parallax(aligned(poses @ look_at([0, 0, 0], [0, 1, 0]), cloud(seed), focal))
    assert caught.value.code == "CAPTURE_DEGENERATE"
    assert "0.jpg to 6.jpg" in caught.value.message


@pytest.mark.slow
@given(st.integers(0, 10**6), st.floats(300, 2000), st.floats(3, 15), st.booleans())
def test_a_camera_that_walks_does_past_a_thing_or_a_wall(seed: int, focal: float, step: float, flat: bool) -> None:
    turns = np.radians(step * (np.arange(7) - 3))
    poses = np.stack([look_at([4 * np.sin(turn), -4 * np.cos(turn), 0.5], [0, 0, 0]) for turn in turns])
    require_parallax(aligned(poses, cloud(seed, flat), focal))
