"""Edits of points: exactly those inside are kept, in any frame and in any parts; up and scale are what was said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.points.edit import cut_away, kept_mask, kept_parts, set_frame
from capture2vr.edge.points.nouns import Points
from capture2vr.order.edits import CropBox, CutPlane, Edits, MeasuredLength

TURNS = st.tuples(*4 * [st.floats(-1, 1)]).filter(lambda turn: np.linalg.norm(turn) > 0.1)
PLACES = st.tuples(*3 * [st.floats(-50, 50)])
SIZES = st.tuples(*3 * [st.floats(0.3, 2)])


def vector(values: Floats) -> Any:
    return tuple(float(each) for each in values)


def cloud(count: int = 4_000) -> Points:
    rng = np.random.default_rng(0)
    return Points(
        xyz=rng.uniform(-1, 1, (count, 3)),
        rgb=rng.integers(0, 256, (count, 3), np.uint8),
        confidence=rng.random(count).astype(np.float32),
        metres_per_unit=1.0,
        scale_confidence="unknown",
        up=None,
    )


def multiply(p: Any, q: Any) -> Any:
    """The product of two quaternions x, y, z, w: first q, then p."""
    (a, b, c, d), (e, f, g, h) = p, q
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


@pytest.mark.slow
@given(PLACES, SIZES)
def test_a_level_box_keeps_exactly_what_is_inside(centre: Any, size: Any) -> None:
    xyz = np.array(centre) + cloud().xyz
    low, high = np.array(centre) - np.array(size) / 2, np.array(centre) + np.array(size) / 2
    inside = ((xyz >= low) & (xyz <= high)).all(axis=1)
    assert (kept_mask(xyz, Edits(crop=CropBox(centre, size))) == inside).all()


@given(PLACES, SIZES, TURNS, TURNS, PLACES)
def test_a_cut_commutes_with_a_motion_of_the_capture(centre: Any, size: Any, own: Any, turn: Any, way: Any) -> None:
    motion = np.array(CropBox((0, 0, 0), (1, 1, 1), turn).axes).T
    xyz = np.array(centre) + cloud().xyz

    def moved(place: Any) -> Any:
        return vector(motion @ np.array(place) + np.array(way))

    before = Edits(crop=CropBox(centre, size, own), planes=(CutPlane(centre, (0.2, 1.0, -0.3)),))
    after = Edits(
        crop=CropBox(moved(centre), size, multiply(turn, own)),
        planes=(CutPlane(moved(centre), vector(motion @ np.array([0.2, 1.0, -0.3]))),),
    )
    differ = kept_mask(xyz, before) != kept_mask(xyz @ motion.T + np.array(way), after)
    assert differ.sum() <= 1, "one on the border, by rounding"


def test_a_plane_keeps_the_side_of_its_normal() -> None:
    kept = cut_away(cloud(), Edits(planes=(CutPlane((0, -0.5, 0), (0, 2, 0)),)))
    assert kept.xyz[:, 1].min() >= -0.5
    assert len(kept) == (cloud().xyz[:, 1] >= -0.5).sum()


def test_what_a_person_cuts_off_leaves_a_true_opening() -> None:
    whole = replace(cloud(), closed=True)
    assert cut_away(whole, Edits(planes=(CutPlane((0.0, 0, -1e6), (0.0, 0, 1)),))).closed
    assert not cut_away(whole, Edits(planes=(CutPlane((0.0, 0, 0), (0.0, 0, 1)),))).closed


def test_colours_and_confidences_go_with_their_points() -> None:
    points = cloud()
    kept = cut_away(points, Edits(crop=CropBox((0, 0, 0), (1, 1, 1))))
    where = {place.tobytes(): number for number, place in enumerate(points.xyz)}
    numbers = [where[place.tobytes()] for place in kept.xyz]
    assert points.rgb is not None
    assert kept.rgb is not None
    assert (kept.rgb == points.rgb[numbers]).all()
    assert (kept.confidence == points.confidence[numbers]).all()


def test_edits_that_leave_nothing_have_a_name() -> None:
    with pytest.raises(EdgeError, match="the edits leave 0 of 4,000 points") as refused:
        cut_away(cloud(), Edits(crop=CropBox((9, 9, 9), (1, 1, 1))))
    assert refused.value.code == "EDITS_NOTHING_LEFT"
    assert refused.value.hints


def parts_of(xyz: Floats, sizes: list[int]) -> Callable[[], Any]:
    return lambda: iter([Cloud(part) for part in np.split(xyz, np.cumsum(sizes)) if len(part)])


@given(st.lists(st.integers(1, 900), max_size=8), TURNS)
def test_the_parts_of_a_scene_are_cut_as_the_whole(sizes: list[int], turn: Any) -> None:
    xyz = cloud().xyz
    edits = Edits(crop=CropBox((0.4, 0, 0), (1, 1.5, 1), turn), planes=(CutPlane((0, 0, 0.2), (0, 0, 1)),))
    parts = kept_parts(CloudParts(len(xyz), parts_of(xyz, sizes)), edits)
    for _ in range(2):
        read = list(parts.read())
        assert np.array_equal(np.concatenate([part.xyz for part in read]), xyz[kept_mask(xyz, edits)])
        assert sum(len(part.xyz) for part in read) == parts.count


def test_what_is_cut_out_of_a_scene_gets_all_its_points() -> None:
    """A scene shows few of its points; a thing in it that fits is made of all."""
    rng = np.random.default_rng(1)
    many = rng.uniform(-1, 1, (40_000, 3))
    scene = replace(cloud(), whole=CloudParts(len(many), lambda: iter([Cloud(many, np.zeros((40_000, 3), np.uint8))])))
    edits = Edits(crop=CropBox((0, 0, 0), (1, 1, 1)))
    kept = cut_away(scene, edits)
    assert kept.whole is None
    assert len(kept) > 0.9 * kept_mask(many, edits).sum() > 5 * kept_mask(scene.xyz, edits).sum()
    assert kept_mask(kept.xyz, edits).all()
    assert kept.rgb is not None


@given(PLACES, TURNS, st.floats(0.01, 100))
def test_a_length_is_what_was_measured(start: Any, turn: Any, metres: float) -> None:
    end = vector(np.array(start) + np.array(turn[:3]) + [0, 0, 2])
    points = set_frame(cloud(), Edits(length=MeasuredLength(start, end, metres)))
    assert np.linalg.norm(np.subtract(end, start)) * points.metres_per_unit == pytest.approx(metres, rel=1e-9)
    assert points.scale_confidence == "estimated"


def test_up_is_what_was_said() -> None:
    points = set_frame(cloud(), Edits(up=(0, 0, 5)))
    assert points.up is not None
    assert points.up.tolist() == [0, 0, 1]
    assert points.up_source is not None
    assert (points.up_source.teller, points.up_source.confidence) == ("person", 1.0)


def test_no_edits_change_nothing() -> None:
    points = cloud()
    assert cut_away(points, Edits()) is points
    assert set_frame(points, Edits()) == points
