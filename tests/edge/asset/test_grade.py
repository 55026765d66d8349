"""The grade: the worst photo counts, and the cause comes with what to do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.asset.grade import Grade, grade_asset
from capture2vr.edge.asset.photo_check import PhotoCheck, degrees_of_one_side
from capture2vr.edge.certificate import Certificate
from capture2vr.edge.render.photo_comparison import PhotoFigures, SurfaceCheck
from capture2vr.edge.render.posed_picture import PosedPicture

FAULTLESS = PhotoFigures(photos=1, cover=0.98, lace=0.0, inside_out=0.0, leak=0.0, depth=0.95)


def photo(name: str = "a.jpg", **figures: float | None) -> SurfaceCheck:
    nothing: Any = None
    picture = PosedPicture(np.eye(4), np.ones(2), np.full(2, 0.5), nothing, name=name)
    return SurfaceCheck(picture, *[nothing] * 6, replace(FAULTLESS, **figures))  # type: ignore[arg-type]


def graded(
    *photos: SurfaceCheck, border: float = 0.0, filled: float = 0.0, own: bool = False, scene: bool = False
) -> Grade:
    distances = np.zeros(1)
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 2 * border, 1, 0, 1.0, 0.3, distances)
    check = PhotoCheck(own=photos, scene=scene) if own else PhotoCheck(photos, scene=scene)
    grade = grade_asset(certificate, check, filled)
    assert grade is not None
    return grade


def test_a_faultless_surface_is_good_and_says_no_more() -> None:
    assert graded(photo()) == Grade("good")
    assert graded(photo()).warnings() == ()


@pytest.mark.parametrize(
    ("worse", "told"),
    [
        ({"lace": (0.03, 0.1, 0.4)}, "holes"),
        ({"depth": (0.8, 0.62, 0.55)}, "depth"),
        ({"cover": (0.85, 0.7, 0.4)}, "is there"),
    ],
)
def test_each_figure_alone_lowers_the_grade_with_its_cause(worse: dict[str, tuple[float, ...]], told: str) -> None:
    ((name, values),) = worse.items()
    grades = [graded(photo(**{name: value})) for value in values]
    assert [each.level for each in grades] == ["usable", "incomplete", "shoot again"]
    assert all(told in each.because for each in grades)
    assert all(each.advice for each in grades)


def test_shreds_and_what_was_made_up_count_too() -> None:
    assert graded(photo(), border=39.0).level == "shoot again"
    assert graded(photo(), border=6.5).level == "good", "a dress"
    assert graded(photo(), border=39.0, scene=True).level == "good", "a room ends where its photos do"
    assert graded(photo(), filled=0.44).level == "good", "fruit whose undersides nobody saw"
    assert graded(photo(), filled=0.8).level == "shoot again"


def test_two_weak_figures_of_different_kinds_are_worse_than_either() -> None:
    made_up, vague, torn = {"filled": 0.58}, photo(depth=0.71), photo(lace=0.03)
    assert [graded(photo(), **made_up).level, graded(vague).level, graded(torn).level] == ["usable"] * 3
    both = graded(vague, **made_up)
    assert both.level == "incomplete"
    assert "71% of the depth" in both.because
    assert "58% of the surface" in both.because, "both are named: neither alone is so bad"
    assert graded(torn, border=9.0).level == "usable", "holes have borders: that is one fault"
    assert graded(photo(depth=0.62), **made_up).level == "incomplete"


def test_a_sensors_own_noise_is_no_fault_of_the_surface() -> None:
    stereo = photo(depth=0.4)
    sensor = replace(stereo, picture=replace(stereo.picture, tracked=True))
    assert [graded(each).level for each in (stereo, sensor)] == ["shoot again", "good"]


def test_depth_that_disagrees_between_photos_far_apart_is_not_blamed_on_shine() -> None:
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 0.0, 1, 0, 1.0, 0.0, np.zeros(1))
    near, far = (grade_asset(certificate, PhotoCheck((photo(depth=0.4),), apart=apart), 0.0) for apart in (10.0, 30.0))
    assert near is not None
    assert far is not None
    assert (near.level, far.level) == ("shoot again",) * 2
    assert "shiny" in near.because
    assert "30° apart" in far.because
    assert "every ten degrees" in far.advice


def ring(elevation: float, azimuths: np.ndarray) -> np.ndarray:
    up, turn = np.radians(elevation), np.radians(azimuths)
    return np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.full(len(turn), np.sin(up))], axis=1)


AROUND = np.arange(0, 360, 15)


@pytest.mark.parametrize(
    ("towards", "degrees"),
    [
        (ring(10, AROUND), 0),
        (ring(45, AROUND), 0),  # from above, all around
        (np.concatenate([ring(5, AROUND), ring(50, AROUND)]), 0),
        (ring(20, np.arange(0, 81, 5)), 74),
        (np.concatenate([ring(5, np.arange(0, 76, 5)), ring(40, np.arange(0, 76, 5))]), 75),
        (ring(0, np.arange(-20, 21, 5)), 40),
        (ring(20, np.arange(0, 200, 10)), 0),  # half of a turn shows more than one side
        (ring(20, np.zeros(1)), 0),
    ],
)
def test_photos_of_one_side_are_told_from_rings(towards: np.ndarray, degrees: float) -> None:
    for turn in np.linalg.qr(np.random.default_rng(0).normal(size=(5, 3, 3)))[0]:
        assert degrees_of_one_side(towards @ turn.T) == pytest.approx(degrees, abs=1)


def test_photos_of_one_side_are_the_cause_of_what_is_missing_and_not_of_shine() -> None:
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 0.0, 1, 0, 1.0, 0.0, np.zeros(1))

    def graded_from_one_side(**figures: float) -> Grade:
        grade = grade_asset(certificate, PhotoCheck((photo(**figures),), one_side=75.0), 0.0)
        assert grade is not None
        return grade

    torn = graded_from_one_side(lace=0.4)
    assert (torn.level, "span 75°" in torn.because) == ("shoot again", True)
    assert "all the way around" in torn.advice
    assert "shiny" in graded_from_one_side(depth=0.4).because
    assert graded_from_one_side() == Grade("good")


@pytest.mark.parametrize(
    ("one_side", "flat", "hole", "level"),
    [
        (53.0, False, 0.99, "incomplete"),  # half a toy animal
        (85.0, True, 0.98, "good"),  # a relief, which has no other side
        (104.0, False, 0.002, "good"),  # fruit from above, which was closed
        (0.0, False, 0.94, "good"),  # a dress, seen all around
    ],
)
def test_half_an_object_is_incomplete_however_well_its_photos_show_that_half(
    one_side: float, flat: bool, hole: float, level: str
) -> None:
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 0.0, 1, 0, 1.0, hole, np.zeros(1))
    grade = grade_asset(certificate, PhotoCheck((photo(),), one_side=one_side, flat=flat), 0.0)
    assert grade is not None
    assert grade.level == level
    assert ("all the way around" in grade.advice) == (level == "incomplete")


@pytest.mark.parametrize(
    ("border", "hole", "level"),
    [
        (2.9, 0.03, "usable"),  # a plush dog with dozens of scraps
        (0.5, 0.002, "good"),  # bananas, whose surface has a slit
        (0.6, 0.09, "good"),  # one opening
        (2.9, 0.9, "good"),  # a bowl
    ],
)
def test_borders_of_a_shut_surface_are_scraps(border: float, hole: float, level: str) -> None:
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 2 * border, 1, 0, 1.0, hole, np.zeros(1))
    grade = grade_asset(certificate, PhotoCheck((photo(),)), 0.0)
    assert grade is not None
    assert grade.level == level
    assert ("scraps" in grade.because) == ("another colour" in grade.advice) == (level == "usable")


def test_a_relief_ends_where_its_photos_do_and_is_told_its_own_fault() -> None:
    torn = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 2 * 23.0, 1, 0, 1.0, 0.98, np.zeros(1))
    relief = PhotoCheck((photo(lace=0.03),), one_side=85.0, flat=True)
    levels = [grade_asset(torn, each, 0.0) for each in (relief, replace(relief, one_side=0.0, flat=False))]
    assert [each and each.level for each in levels] == ["usable", "incomplete"]
    assert levels[0] is not None
    assert "holes" in levels[0].because


def test_the_worst_photo_counts_and_is_named() -> None:
    grade = graded(photo("a.jpg"), photo("dark side.jpg", lace=0.06), photo("c.jpg"))
    assert grade.level == "incomplete"
    assert "dark side.jpg" in grade.because
    (warning,) = grade.warnings()
    assert warning.startswith("Incomplete: ")
    assert graded(photo(depth=0.2)).warnings()[0].startswith("Shoot it again: ")


def test_photos_that_it_was_made_from_tell_where_none_could_be_spared() -> None:
    assert graded(photo(lace=0.3), own=True).level == "shoot again"
    certificate = Certificate(1, *[0.0] * 8, 4.0, 1, 1, 0.0, 1, 0, 1.0, 0.0, np.zeros(1))
    assert grade_asset(certificate, PhotoCheck(), 0.0) is None
