"""From where to shoot again: depth frames around things whose unseen sides are known, and where the advice ends up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.cli.local.report import report_page
from capture2vr.edge.arrays import Floats
from capture2vr.edge.asset.manifest import _unseen_sides, asset_frame
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.fusion.coverage import unseen_sides
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.points.nouns import Points, UnseenSide
from capture2vr.edge.preset import load_preset
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from tests.support.scenes import PHONE, Sensor, film, look_at, orbit, plane, scene

MIDDLE = (0.0, 0.0, 0.15)


def ball() -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(4, 0.15)
    made.apply_translation(MIDDLE)
    return made


def cup() -> trimesh.Trimesh:
    """0.3 m high, 0.12 m wide, open above."""
    made = trimesh.creation.annulus(r_min=0.055, r_max=0.06, height=0.3)
    made.apply_translation(MIDDLE)
    return made


def scanned(thing: trimesh.Trimesh, poses: Floats) -> Capture:
    """Depth frames of the thing on a table, with a phone's noise."""
    world = scene((plane(1.2, 1.2), (150, 120, 90)), (thing, (200, 40, 40)))
    return Capture("rgbd", "synthetic", frames=film(world, poses, sensor=Sensor(noise_m=0.002)))


def ring(count: int, *, height: float, radius: float = 0.8, turn: float = 1.0) -> Floats:
    return orbit(count, radius=radius, height=height, turn=turn, target=MIDDLE)


def degrees_between(one: Floats | tuple[float, ...], other: Floats | list[float]) -> float:
    a, b = np.asarray(one), np.asarray(other)
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


@pytest.fixture(scope="module")
def half() -> Capture:
    """Half of the way round the cup, from one side of it by its front to the other: nobody stood at -y."""
    poses = ring(11, height=0.45, turn=11 / 20)
    return scanned(cup(), np.concatenate([poses[5:6], poses[:5], poses[6:]]))


def test_half_a_circle_asks_for_what_is_behind(half: Capture) -> None:
    points = to_points(half, cut="object")
    assert len(points.unseen) <= 2
    first = points.unseen[0]
    assert degrees_between(first.toward, [0, -1, 0]) < 45
    assert np.linalg.norm(first.toward) == pytest.approx(1)
    assert first.advice.startswith("Shoot from behind")
    assert "first picture" in first.advice
    assert 0.1 < first.share < 0.6


@pytest.mark.slow
def test_all_round_at_two_heights_asks_for_nothing() -> None:
    poses = np.concatenate([ring(12, height=0.35), ring(8, height=0.75, radius=0.5)])
    assert to_points(scanned(ball(), poses), cut="object").unseen == ()
    assert to_points(scanned(cup(), poses), cut="object").unseen == ()


@pytest.mark.slow
def test_a_tall_cup_filmed_from_its_own_height_is_to_be_seen_from_above() -> None:
    (side,) = to_points(scanned(cup(), ring(14, height=0.25, radius=0.9)), cut="object").unseen
    assert side.advice == f"Shoot from above: {side.share:.0%} of the object is seen too little."
    assert degrees_between(side.toward, [0, 0, 1]) < 20


@pytest.mark.slow
def test_what_was_only_seen_from_high_up_is_to_be_seen_from_lower_down() -> None:
    sides = to_points(scanned(cup(), ring(14, height=0.9, radius=0.4)), cut="object").unseen
    assert 1 <= len(sides) <= 3
    assert all("lower down" in side.advice for side in sides)
    assert [side.share for side in sides] == sorted((side.share for side in sides), reverse=True)


def test_with_its_surroundings_nothing_is_asked(half: Capture) -> None:
    assert to_points(half, cut="scene").unseen == ()


def around(gap_deg: float, turn: Floats) -> tuple[Points, Capture]:
    """Points of a whole ball and cameras at two heights, but for a quarter about `gap_deg`; all of it turned."""
    xyz = trimesh.creation.icosphere(3, 0.15).vertices
    angles = gap_deg + np.linspace(65, 295, 20)
    poses = []
    for number, angle in enumerate(np.radians(angles)):
        high = 0.9 if number % 2 else 0.3
        pose = look_at([np.cos(angle), np.sin(angle), high], [0, 0, 0])
        moved = np.eye(4)
        moved[:3] = turn @ pose[:3]
        poses.append(moved)
    points = Points(xyz @ turn.T, None, np.ones(len(xyz), np.float32), 1.0, "unknown", turn[:, 2])
    frame = film(scene((plane(0.1, 0.1), (0, 0, 0))), np.eye(4)[None], PHONE)[0]
    return points, Capture("rgbd", "a", frames=tuple(replace(frame, camera_to_world=pose) for pose in poses))


@settings(max_examples=20)
@given(st.floats(-180, 180), st.integers(0, 2**32 - 1), st.floats(0.01, 100))
def test_the_gap_is_found_whatever_way_the_capture_lies(gap_deg: float, seed: int, scale: float) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.linalg.det(turn))
    points, capture = around(gap_deg, turn)
    (side,) = unseen_sides(points, capture.frames)
    gap = turn @ [np.cos(np.radians(gap_deg)), np.sin(np.radians(gap_deg)), 0]
    assert degrees_between(side.toward, gap) < 45
    # The first camera stands 65 degrees to the right of the gap, as seen by somebody who faces it.
    assert "left" in side.advice or "right" in side.advice
    larger = replace(points, xyz=points.xyz * scale)
    frames = []
    for frame in capture.frames:
        pose = np.array(frame.camera_to_world)
        pose[:3, 3] *= scale
        frames.append(replace(frame, camera_to_world=pose))
    assert unseen_sides(larger, frames)[0].share == pytest.approx(side.share, abs=0.02)


def test_left_and_right_are_those_of_the_first_picture() -> None:
    """The first camera is at 65 degrees and looks at the middle; the gap at 0 lies clockwise of it: to its left."""
    points, capture = around(0.0, np.eye(3))
    (side,) = unseen_sides(points, capture.frames)
    assert "left" in side.advice
    (mirrored,) = unseen_sides(points, capture.frames[::-1])
    assert "right" in mirrored.advice


def test_without_an_up_nothing_is_told() -> None:
    points, capture = around(0.0, np.eye(3))
    assert unseen_sides(replace(points, up=None), capture.frames) == ()


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_the_manifest_tells_it_in_the_assets_frame(half: Capture) -> None:
    """Z is up in the capture and y in the asset: nobody stood at the capture's -y, the asset's +z."""
    steps = reconstruct(half, replace(load_preset("draft"), resolution=40), JobOptions(cut="object"))
    *_, bundle = [step for step in steps if isinstance(step, Bundle)]
    (side, *_) = bundle.manifest["capture"]["unseen"]
    assert set(side) == {"advice", "toward", "share"}
    assert np.linalg.norm(side["toward"]) == pytest.approx(1, abs=2e-3)
    to_asset = np.array(bundle.manifest["capture_to_asset"]).reshape(4, 4)
    assert degrees_between(side["toward"], (to_asset[:3, :3] @ [0, -1, 0]).tolist()) < 45
    assert side["toward"][1] < 0.75  # y, against gravity
    report = {
        **bundle.manifest,
        "key": "cup", "verdict": "", "reference": None, "certificates": {},
    }  # fmt: skip
    assert f"<li>{side['advice']}</li>" in report_page(report, {})


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_a_direction_keeps_its_length_and_its_height_in_the_asset(seed: int, metres_per_unit: float) -> None:

    rng = np.random.default_rng(seed)
    up, toward = (each / np.linalg.norm(each) for each in rng.normal(size=(2, 3)))
    xyz = rng.random((30, 3))
    sides = (UnseenSide("Shoot from behind.", tuple(toward.tolist()), 0.25),)
    points = Points(xyz, None, np.ones(30, np.float32), metres_per_unit, "unknown", up, unseen=sides)
    (told,) = _unseen_sides(points, asset_frame(xyz, points))
    assert np.linalg.norm(told["toward"]) == pytest.approx(1, abs=2e-3)
    assert told["toward"][1] == pytest.approx(toward @ up, abs=2e-3)
    assert (told["advice"], told["share"]) == ("Shoot from behind.", 0.25)


def test_a_thing_in_one_plane_is_unseen_from_behind() -> None:
    """A poster that all cameras see at exactly one depth: its hull has no volume."""
    x, z = np.meshgrid(np.linspace(-0.3, 0.3, 40), np.linspace(0, 0.4, 40))
    xyz = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    points = Points(xyz, None, np.ones(len(xyz), np.float32), 1.0, "metric", np.array([0.0, 0.0, 1.0]))
    poses = np.stack([look_at((x, -1.0, 0.2), (x, 0, 0.2)) for x in (-0.1, 0.0, 0.1)])
    (behind,) = unseen_sides(points, film(scene((plane(1, 1), (0, 0, 0))), poses))
    assert degrees_between(behind.toward, [0, 1, 0]) < 10
