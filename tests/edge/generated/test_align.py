"""A generated object is turned to where it looks like its photo, whatever its turn, its size and its place were."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.generated.align import Pose, align
from capture2vr.edge.points.unit import unit_frame
from tests.support.photos.generators import boxes, photo_of, points_on

SIDE = 186


def unit(xyz: Floats) -> Floats:
    return unit_frame(xyz).to_unit(xyz)


def found(turn: float, height: float = 0.0, *, coloured: bool = True) -> tuple[Pose, Bools]:
    """The pose of the boxes, turned by so much, beside a photo of them as they are."""
    photo, mask = photo_of(boxes(), SIDE, height)
    xyz, rgb = points_on(boxes(turn))
    return align(unit(xyz), rgb if coloured else None, mask, photo), mask


def apart(one: float, other: float) -> float:
    return abs((one - other + 180) % 360 - 180)


@pytest.mark.slow
@pytest.mark.parametrize(("turn", "height"), [(0, 0), (37, 0), (133, 20), (180, 0), (251, 40), (355, 10)])
def test_whatever_its_turn_it_lies_on_the_photo(turn: float, height: float) -> None:
    pose, _ = found(turn, height)
    assert pose.iou > 0.93
    assert apart(pose.turn, -turn) < 5


@pytest.mark.slow
def test_without_colours_the_silhouette_decides() -> None:
    pose, _ = found(90, coloured=False)
    assert pose.iou > 0.93


@pytest.mark.slow
def test_another_object_does_not_lie_on_it() -> None:
    photo, _ = photo_of(boxes(), SIDE)
    bar = np.zeros((SIDE, SIDE), bool)
    bar[18:-18, 85:100] = True
    bar[18:30, 30:-30] = True
    xyz, rgb = points_on(boxes())
    assert align(unit(xyz), rgb, bar, photo).iou < 0.7


def test_y_stays_up_and_the_size_is_the_poses() -> None:
    xyz = np.array([[0.5, 0.2, 0.0], [-0.5, -0.2, 0.1]])
    placed = Pose(90, 30, 0.5).placed(xyz)
    np.testing.assert_allclose(placed, [[0, 0.1, -0.25], [0.05, -0.1, 0.25]], atol=1e-12)
