"""What is said of photos that were placed: also where their places are unsure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.cameras.features import FAST, Features
from capture2vr.edge.cameras.placement_attempts import Attempt
from capture2vr.edge.cameras.placement_report import placement_warnings
from capture2vr.edge.cameras.sfm_process import SfmResult
from capture2vr.edge.capture.nouns import Photo

COUNT = 12


def photos() -> list[Photo]:
    black = np.zeros((4, 4, 3), np.uint8)
    return [Photo(f"{number}.jpg", (4, 4), "one", lambda longest=None: black) for number in range(COUNT)]


def placed(seen_by: list[int], *, of: int = COUNT) -> Attempt:
    """An attempt that placed so many of the photos, with points that are seen by so many of them each."""
    views = np.concatenate([np.arange(count) % of for count in seen_by])
    answer = SfmResult(
        (),
        np.where(np.arange(COUNT) < of, 0, -1),
        np.arange(of),
        np.tile(np.eye(4), (of, 1, 1)),
        np.zeros((len(seen_by), 3)),
        np.repeat(np.arange(len(seen_by)), seen_by),
        views,
        np.zeros(len(views), np.int64),
    )
    features = [Features(np.zeros((500, 2), np.float32), np.zeros((500, 128), np.uint8))] * COUNT
    return Attempt(FAST, features, np.zeros((0, 2), np.int64), answer)


@pytest.mark.parametrize(("seen_by", "unsure"), [([2] * 90 + [4] * 10, True), ([2] * 40 + [5] * 60, False)])
def test_cameras_whose_points_only_two_photos_see_are_unsure(seen_by: list[int], unsure: bool) -> None:
    said = " ".join(placement_warnings(photos(), placed(seen_by)))
    assert ("a photo every ten degrees" in said) == unsure
    assert ("only 2.2 photos" in said) == unsure


def test_photos_that_came_with_their_poses_are_sure() -> None:
    posed = [replace(photo, camera_to_world=np.eye(4)) for photo in photos()]
    assert placement_warnings(posed, placed([2] * 50)) == ()


def test_what_a_network_matched_by_pairs_says_nothing() -> None:
    attempt = placed([2] * 50)
    more = Features(np.zeros((600, 2), np.float32), np.zeros((500, 128), np.uint8))
    assert placement_warnings(photos(), replace(attempt, features=[more] * COUNT)) == ()


def test_photos_that_were_left_out_are_named_first() -> None:
    first, *_, last = placement_warnings(photos(), placed([2] * 50, of=10))
    assert "10.jpg, 11.jpg" in first
    assert "ten degrees" in last
