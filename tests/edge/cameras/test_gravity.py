"""Up from what the photos' metadata say of gravity: whatever the frame of the poses, and only where they agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.photos.gravity import gravity_up
from tests.support.scenes import look_at, orbit

LENS = Intrinsics(500, 500, 320, 240, 640, 480)


def unread(longest: int | None = None) -> Bytes:
    raise AssertionError("no pixels are needed")


def views(poses: Floats, turn: Floats, *, noise_deg: float = 0.0, seed: int = 0) -> list[PhotoView]:
    """Photos from poses in a world with z up, which is then turned by `turn` (3,3); each knows up and its elevation."""
    rng = np.random.default_rng(seed)
    made = []
    for pose in poses:
        shaken = Rotation.from_rotvec(np.radians(rng.normal(0, noise_deg / np.sqrt(3), 3))).as_matrix()
        x, y, z = shaken @ pose[:3, :3].T @ [0, 0, 1]
        rise = float(np.degrees(np.arcsin(np.clip(pose[2, 2], -1, 1)))) + rng.normal(0, noise_deg)
        photo = Photo("IMG", (640, 480), "one", unread, up_in_camera=(x, y, z), elevation_deg=rise)
        turned = np.eye(4)
        turned[:3, :3], turned[:3, 3] = turn @ pose[:3, :3], turn @ pose[:3, 3]
        made.append(PhotoView(photo, LENS, (0.0,) * 5, turned))
    return made


def without(made: list[PhotoView], **fields: None) -> list[PhotoView]:
    return [replace(view, photo=replace(view.photo, **fields)) for view in made]


def off_deg(up: Floats, turn: Floats) -> float:
    return float(np.degrees(np.arccos(np.clip(up @ turn @ [0, 0, 1], -1, 1))))


@pytest.mark.parametrize("told", ["accelerations", "elevations"])
@given(seed=st.integers(0, 99), noise_deg=st.floats(0, 3))
def test_up_in_any_frame_with_a_shaking_hand(told: str, seed: int, noise_deg: float) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    made = views(orbit(20, radius=1, height=0.6), turn, noise_deg=noise_deg, seed=seed)
    found = gravity_up(made if told == "accelerations" else without(made, up_in_camera=None))
    assert found is not None
    up, source = found
    assert np.linalg.norm(up) == pytest.approx(1)
    assert off_deg(up, turn) < 0.05 + noise_deg
    assert source.teller == "gravity"
    assert source.confidence > 0.7


def test_a_few_wrong_ones_change_nothing() -> None:
    made = views(orbit(20, radius=1, height=0.6), np.eye(3))
    wrong = [replace(view, photo=replace(view.photo, up_in_camera=(1.0, 0.0, 0.0))) for view in made[:4]]
    found = gravity_up([*wrong, *made[4:]])
    assert found is not None
    assert off_deg(found[0], np.eye(3)) < 0.1


def test_photos_that_contradict_each_other_tell_nothing() -> None:
    rng = np.random.default_rng(0)
    made = [
        replace(view, photo=replace(view.photo, up_in_camera=tuple(each), elevation_deg=None))
        for view, each in zip(views(orbit(20, radius=1, height=0.6), np.eye(3)), rng.normal(size=(20, 3)), strict=True)
    ]
    assert gravity_up(made) is None


def test_two_photos_are_too_few_and_none_is_nothing() -> None:
    made = views(orbit(20, radius=1, height=0.6), np.eye(3))
    nothing = without(made, up_in_camera=None, elevation_deg=None)
    assert gravity_up(nothing) is None
    assert gravity_up([*made[:2], *nothing]) is None


def test_elevations_of_cameras_that_look_one_way_are_not_sure() -> None:
    poses = np.stack([look_at((x, -1, 0.5), (x, 0, 0.1)) for x in np.linspace(-0.2, 0.2, 8)])
    found = gravity_up(without(views(poses, np.eye(3), noise_deg=1), up_in_camera=None))
    assert found is None or found[1].confidence < 0.7
