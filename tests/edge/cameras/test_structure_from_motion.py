"""Cameras from photos: rendered scenes whose cameras are known, captures that cannot be placed, and real photos."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bytes, Floats, Tick
from capture2vr.edge.cameras.features import FAST, FINE, Features, SiftSettings, features_of, pixel_ratio, root_sift
from capture2vr.edge.cameras.learned_matches import LearnedMatches
from capture2vr.edge.cameras.match_pairs import FEW, MANY, epipolar_errors, exhaustive, sequential, with_all
from capture2vr.edge.cameras.nouns import Alignment
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem, SfmResult, solve
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.errors import Cancelled, CaptureError, EdgeError
from capture2vr.edge.procrustes import procrustes
from tests.support.command_lines import children_running
from tests.support.patience import CANCEL_S

SIZE = (480, 360)
LENS = Intrinsics(430.0, 430.0, 239.5, 179.5, *SIZE)
K = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1]])
BOX_HEIGHT = 0.5
MAPPER = "capture2vr.edge.cameras.sfm_child"  # other tests of this process leave helpers of Python's own


def photo_of(pixels: Bytes, name: str, camera: str = "phone") -> Photo:
    def load(longest: int | None = None) -> Bytes:
        scale = min(1.0, (longest or 10**9) / max(pixels.shape))
        if scale == 1.0:
            return pixels
        return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))

    return Photo(name, (pixels.shape[1], pixels.shape[0]), camera, load)


def texture(seed: int, side: int = 700) -> Bytes:
    """Noise at every scale, (side,side,3)."""
    random, total = np.random.default_rng(seed), np.zeros((side, side, 3))
    for cells in (8, 24, 70, 200):
        noise = random.normal(size=(cells, cells, 3)).astype(np.float32)
        total += cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)


def looking(angle: float) -> Floats:
    """camera_to_world of a camera 2.2 m from the floor's middle, `angle` degrees around it; the world's z is up."""
    turn = np.radians(angle)
    centre = np.array([1.4 * np.sin(turn), -1.4 * np.cos(turn), 1.8])
    forward = np.array([0, 0, 0.2]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, centre], axis=1)
    return pose


def rendered(pose: Floats, seed: int) -> Bytes:
    """A textured floor z = 0 of 3 x 3 m, and over it a textured board z = BOX_HEIGHT of 0.7 x 0.7 m."""
    picture = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    for number, (side, height) in enumerate([(3.0, 0.0), (0.7, BOX_HEIGHT)]):
        pattern = texture(2 * seed + number)
        texel = side / len(pattern)
        corner = 0.5 * (texel - side)  # of the first texel's centre
        plane = np.array([[texel, 0, corner], [0, texel, corner], [0, 0, height], [0, 0, 1]])
        homography = K @ np.linalg.inv(pose)[:3] @ plane
        shown = cv2.warpPerspective(pattern, homography, SIZE, flags=cv2.INTER_LINEAR)
        covers = cv2.warpPerspective(np.ones(pattern.shape[:2], np.uint8), homography, SIZE) > 0
        picture[covers] = shown[covers]
    return picture


def scene(seed: int, angles: Floats, name: str = "view") -> list[Photo]:
    """Photos with the true lens and pose; `unposed` takes them away."""
    poses = [looking(angle) for angle in angles]
    return [
        replace(photo_of(rendered(pose, seed), f"{name}_{index}.jpg"), intrinsics=LENS, camera_to_world=pose)
        for index, pose in enumerate(poses)
    ]


def unposed(photos: list[Photo]) -> list[Photo]:
    return [replace(photo, intrinsics=None, camera_to_world=None) for photo in photos]


def centre_errors(found: Floats, true: Floats) -> Floats:
    """Distances of camera centres (V,3) after the best similarity, as a share of the true ones' extent."""
    to_true = procrustes(found, true, scale=True)
    assert to_true is not None
    distances = np.linalg.norm(found @ to_true[:3, :3].T + to_true[:3, 3] - true, axis=1)
    return np.asarray(distances / np.linalg.norm(np.ptp(true, axis=0)))


def centres(alignment: Alignment) -> Floats:
    return np.array([view.camera_to_world[:3, 3] for view in alignment.views])


@pytest.fixture(scope="module")
def posed() -> list[Photo]:
    return scene(1, np.linspace(-50, 50, 8))


@pytest.fixture(scope="module")
def solved(posed: list[Photo]) -> Alignment:
    return align(unposed(posed))


@pytest.mark.slow
def test_the_cameras_of_a_scene_are_found_up_to_a_similarity(posed: list[Photo], solved: Alignment) -> None:
    assert [view.photo.name for view in solved.views] == [photo.name for photo in posed]
    assert {verdict.verdict for verdict in solved.verdicts} == {"ok"}
    assert solved.warnings == ()
    truth = np.array([looking(angle)[:3, 3] for angle in np.linspace(-50, 50, 8)])
    assert centre_errors(centres(solved), truth).max() < 0.01
    assert solved.views[0].intrinsics.fx == pytest.approx(LENS.fx, rel=0.02)
    assert solved.views[0].intrinsics.cx == pytest.approx(LENS.cx, abs=1e-6)
    assert abs(solved.views[0].distortion[0]) < 0.02


@pytest.mark.slow
def test_every_observation_names_a_point_and_a_view(solved: Alignment) -> None:
    assert len(solved.xyz) > 200
    assert solved.seen_point.shape == solved.seen_view.shape
    assert np.bincount(solved.seen_point, minlength=len(solved.xyz)).min() >= 2
    assert set(solved.seen_view.tolist()) == set(range(len(solved.views)))
    assert 0 < solved.error_px < 1


@pytest.mark.slow
def test_the_same_photos_give_the_same_cameras(posed: list[Photo], solved: Alignment) -> None:
    """Nearly always bit by bit; the matcher's two threads share a generator, and on a busy machine may swap numbers."""
    again = align(unposed(posed))
    walked = np.ptp(centres(solved), axis=0).max()
    assert np.abs(centres(again) - centres(solved)).max() < 1e-3 * walked
    assert len(again.xyz) == pytest.approx(len(solved.xyz), rel=0.02)


@pytest.mark.slow
def test_given_poses_are_kept_and_the_points_lie_on_the_surfaces(posed: list[Photo]) -> None:
    alignment = align(posed)
    for view, photo in zip(alignment.views, posed, strict=True):
        assert photo.camera_to_world is not None
        assert np.array_equal(view.camera_to_world, photo.camera_to_world)
        assert view.intrinsics == LENS
    height = alignment.xyz[:, 2]
    off = np.minimum(np.abs(height), np.abs(height - BOX_HEIGHT))
    assert len(alignment.xyz) > 200
    assert np.median(off) < 0.003  # a shift of half a pixel would be 3 mm in every view
    assert alignment.error_px < 0.5


@pytest.mark.slow
def test_poses_of_other_photos_are_not_used(posed: list[Photo]) -> None:
    mirrored = zip(posed, reversed(posed), strict=True)
    photos = [replace(photo, camera_to_world=other.camera_to_world) for photo, other in mirrored][:4]
    alignment = align(photos)
    assert alignment.contradicted
    assert [view.photo.name for view in alignment.views] == [photo.name for photo in photos]
    truth = np.array([looking(angle)[:3, 3] for angle in np.linspace(-50, 50, 8)[:4]])
    assert centre_errors(centres(alignment), truth).max() < 0.02


@pytest.mark.slow
def test_posed_photos_of_different_things_are_refused_and_their_poses_doubted() -> None:
    photos = [scene(seed, np.zeros(1), f"thing{seed}")[0] for seed in range(3)]
    with pytest.raises(CaptureError) as caught:
        align(photos)
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"
    assert any("poses" in hint for hint in caught.value.hints)


def test_epipolar_errors_are_distances_from_what_the_poses_allow() -> None:
    random = np.random.default_rng(0)
    first_pose, second_pose = looking(0), looking(30)
    points = np.append(random.uniform(-0.5, 0.5, (50, 3)), np.ones((50, 1)), axis=1)
    first, second = ((points @ np.linalg.inv(pose).T)[:, :3] for pose in (first_pose, second_pose))
    first, second = first[:, :2] / first[:, 2:], second[:, :2] / second[:, 2:]
    assert epipolar_errors(first, second, first_pose, second_pose).max() < 1e-9
    moved = epipolar_errors(first, second + np.array([0, 0.01]), first_pose, second_pose)
    assert 0.002 < np.median(moved) < 0.01
    assert epipolar_errors(first, first, first_pose, first_pose).max() < 1e-9


@pytest.mark.slow
def test_of_two_groups_that_do_not_meet_the_larger_is_used() -> None:
    near, far = scene(1, np.linspace(-30, 30, 4), "near"), scene(2, np.linspace(-15, 15, 3), "far")
    blank = photo_of(np.full((SIZE[1], SIZE[0], 3), 200, np.uint8), "blank.jpg")
    alignment = align([*unposed(near), *unposed(far), blank])
    assert [view.photo.name for view in alignment.views] == [photo.name for photo in near]
    by_name = {verdict.name: verdict for verdict in alignment.verdicts}
    assert {by_name[photo.name].verdict for photo in far} == {"no_overlap"}
    assert "between near_3.jpg and this one" in by_name["far_0.jpg"].advice
    assert "texture" in by_name["blank.jpg"].advice
    assert "groups of 4 and 3" in alignment.warnings[0]


@pytest.mark.slow
def test_photos_of_different_things_are_refused_with_what_to_shoot() -> None:
    photos = [unposed(scene(seed, np.zeros(1), f"thing{seed}"))[0] for seed in range(3)]
    with pytest.raises(CaptureError) as caught:
        align(photos)
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"
    assert "thing0_0.jpg" in caught.value.hints[0]
    assert any("15 to 30 photos" in hint for hint in caught.value.hints)


@pytest.mark.slow
def test_two_photos_are_too_few(posed: list[Photo]) -> None:
    with pytest.raises(CaptureError, match="2 photos") as caught:
        align(posed[:2])
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"


@pytest.mark.slow
def test_a_cancel_ends_the_child_and_leaves_nothing(
    posed: list[Photo], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    raised = []

    def cancel_in_the_child(_: float) -> None:
        if children_running(MAPPER):
            raised.append(time.monotonic())
            raise Cancelled

    with pytest.raises(Cancelled):
        align(unposed(posed), tick=cancel_in_the_child)
    assert time.monotonic() - raised[0] < CANCEL_S
    assert children_running(MAPPER) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_child_that_is_killed_is_an_error_with_a_name(posed: list[Photo]) -> None:
    def kill(_: float) -> None:
        for child in children_running(MAPPER):
            child.kill()

    with pytest.raises(EdgeError, match="status -9") as caught:
        align(unposed(posed), tick=kill)
    assert caught.value.code == "ALIGN_FAILED"


@pytest.mark.slow
def test_the_childs_last_words_are_in_the_error(posed: list[Photo]) -> None:
    features = tuple(features_of(photo, FAST) for photo in posed[:3])
    unknown_lens = np.array([0, 0, 7])
    with pytest.raises(EdgeError, match="Error") as caught:
        solve(SfmProblem((Lens(LENS),), unknown_lens, features, exhaustive(3), 1.0))
    assert caught.value.code == "ALIGN_FAILED"


@pytest.mark.slow
def test_the_progress_rises_to_one(posed: list[Photo]) -> None:
    told: list[float] = []
    align(unposed(posed[:4]), tick=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(set(told)) > 4


def test_the_child_does_without_torch() -> None:
    code = "import capture2vr.edge.cameras.sfm_child, sys; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


@pytest.mark.slow
@pytest.mark.parametrize("longest", [1200, 400])
def test_key_points_lie_where_their_blobs_do_whatever_the_pictures_size(longest: int) -> None:
    x, y = np.meshgrid(np.arange(1200.0), np.arange(900.0))
    blobs = np.random.default_rng(0).uniform(100, 800, (30, 2))
    light = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 9.0**2)) for u, v in blobs)
    photo = photo_of(np.repeat(np.uint8(40 + 200 * np.minimum(light, 1))[..., None], 3, axis=2), "blobs.png")
    setting = SiftSettings(longest, 200, 0.015)
    offset = features_of(photo, setting).xy[:, None] - blobs
    found = offset[np.linalg.norm(offset, axis=2) < 2 * pixel_ratio(photo, setting.longest)]
    assert len(found) > 10
    assert np.abs(np.median(found, axis=0)).max() < 0.05 * pixel_ratio(photo, setting.longest)


def test_root_sift_has_unit_length_and_bears_an_empty_histogram() -> None:
    histograms = np.random.default_rng(0).uniform(size=(5, 128)).astype(np.float32)
    histograms[0] = 0
    length = np.linalg.norm(root_sift(histograms).astype(float), axis=1)
    assert length[0] == 0
    assert length[1:] == pytest.approx(512, rel=0.01)


def test_pairs_are_neighbours_and_a_skeleton() -> None:
    pairs = {(first, second) for first, second in sequential(50).tolist()}
    assert all((index, index + step) in pairs for index in range(46) for step in range(1, 5))
    assert (0, 48) in pairs
    assert (1, 48) not in pairs
    assert len(pairs) < 300
    assert len(sequential(FEW)) == FEW * (FEW - 1) / 2
    assert len(exhaustive(MANY)) == MANY * (MANY - 1) / 2


@given(st.integers(4, 150), st.data())
def test_photos_that_were_left_out_are_matched_with_all_others(count: int, data: st.DataObject) -> None:
    chosen = np.array(data.draw(st.lists(st.integers(0, count - 1), max_size=5, unique=True)), np.int64)
    pairs = {*map(tuple, with_all(sequential(count), chosen, count).tolist())}
    assert {*map(tuple, sequential(count).tolist())} <= pairs
    assert all(first < second for first, second in pairs)
    added = {(min(one, other), max(one, other)) for one in chosen.tolist() for other in range(count) if one != other}
    assert pairs == added | {*map(tuple, sequential(count).tolist())}


def test_a_few_photos_that_were_left_out_are_tried_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first try leaves out 2 of 40 photos; the second, with more key points, places them."""
    asked: list[tuple[SiftSettings, int]] = []

    def found(photos: list[Photo], setting: SiftSettings, tick: object = None) -> tuple[Features, ...]:
        none = Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
        return (none,) * len(photos)

    def solved(problem: SfmProblem, tick: object = None) -> SfmResult:
        fine = len(asked) > 0
        asked.append((FINE if fine else FAST, len(problem.pairs)))
        placed = np.arange(40 if fine else 38)
        none = np.zeros(0, np.int64)
        model_of = np.where(np.arange(40) < len(placed), 0, -1)
        return SfmResult((), model_of, placed, np.zeros((len(placed), 4, 4)), np.zeros((0, 3)), none, none, none)

    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.find_features", found)
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.solve", solved)
    monkeypatch.setattr("capture2vr.edge.cameras.structure_from_motion._alignment", lambda photos, attempt: attempt)
    attempt = align([photo_of(np.zeros((30, 40, 3), np.uint8), f"{number}.jpg") for number in range(40)])
    assert len(attempt.answer.placed) == 40
    assert [setting for setting, _ in asked] == [FAST, FINE]
    assert asked[1][1] == len(with_all(sequential(40), np.array([38, 39]), 40))


@pytest.mark.slow
@pytest.mark.parametrize("network", [False, True])
def test_what_was_placed_is_not_lost_with_a_further_try(
    posed: list[Photo], network: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first try places 8 photos of 9, or of 10; the mapper of the next one is killed, as where memory runs out."""
    asked: list[SfmProblem] = []

    def solved(problem: SfmProblem, tick: Tick) -> SfmResult:
        asked.append(problem)
        if len(asked) > 1:
            raise EdgeError("ALIGN_FAILED", "the solver ended with status -9: no output")
        return solve(problem, tick)

    found = LearnedMatches(tuple(np.zeros((0, 2), np.float32) for _ in range(10)), np.zeros((1, 4), np.int32))
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.solve", solved)
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.find_matches", lambda *_: found)
    monkeypatch.setattr("capture2vr.edge.cameras.placement_attempts.with_learned", lambda features, _: (features, None))
    for module in ("placement_attempts", "placement_report"):
        monkeypatch.setattr(f"capture2vr.edge.cameras.{module}.is_installed", lambda: network)
    blank = photo_of(np.full((SIZE[1], SIZE[0], 3), 200, np.uint8), "blank.jpg")
    alignment = align([*unposed(posed), blank, *[replace(blank, name="other.jpg")] * network])
    assert len(asked) == 3 if network else 2
    assert [view.photo.name for view in alignment.views] == [photo.name for photo in posed]
    assert alignment.warnings[1] == "a further try to place photos failed: the solver ended with status -9: no output"
    assert (
        any("network that looks for more matches failed: the solver" in each for each in alignment.warnings) == network
    )


def test_the_pairs_of_many_photos_grow_no_faster_than_the_photos() -> None:
    assert len(exhaustive(1000)) < 20_000
    assert len(exhaustive(2000)) < 30_000


def fruit(data_dir: Path) -> tuple[list[Photo], dict[str, Floats], ElementTree.Element]:
    """The photos, a reference program's camera_to_world by their names, and its calibration."""
    folder = data_dir / "photos_fruit"
    read = partial(cv2.imread, flags=cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    photos = [photo_of(read(str(file)), file.stem) for file in sorted((folder / "images").glob("*.JPG"))]
    document = ElementTree.parse(folder / "camera.xml").getroot()
    poses = {
        camera.attrib["label"]: np.array(camera.findtext("transform", "").split(), np.float64).reshape(4, 4)
        for camera in document.iter("camera")
    }
    calibration = document.find(".//calibration")
    assert calibration is not None
    return photos, poses, calibration


@pytest.mark.slow
@pytest.mark.data
def test_twenty_photos_of_fruit_are_placed_as_a_reference_program_placed_them(data_dir: Path) -> None:
    photos, poses, _ = fruit(data_dir)
    alignment = align(photos)
    truth = np.array([poses[view.photo.name][:3, 3] for view in alignment.views])
    errors = centre_errors(centres(alignment), truth)
    assert len(alignment.views) >= 18
    assert np.median(errors) < 0.005
    assert errors.max() < 0.03


@pytest.mark.slow
@pytest.mark.data
def test_photos_of_fruit_with_their_poses_and_their_lens_are_believed(data_dir: Path) -> None:
    photos, poses, calibration = fruit(data_dir)
    value = {child.tag: float(child.text or "nan") for child in calibration if child.tag != "resolution"}
    scale = 600 / 3456  # of the photos to the sensor that was calibrated
    centre = (299.5 + scale * value["cx"], 199.5 + scale * value["cy"])
    lens = Intrinsics(scale * value["f"], scale * value["f"], *centre, 600, 400)
    distortion = tuple(value[name] for name in ("k1", "k2", "p2", "p1", "k3"))  # that program's p1 is OpenCV's p2
    given = [
        replace(photo, intrinsics=lens, distortion=distortion, camera_to_world=poses[photo.name])
        for photo in photos[10:]
    ]
    alignment = align(given)
    assert len(alignment.views) == 10
    assert alignment.views[0].distortion == distortion  # its k3 of -6.3 included
    assert len(alignment.xyz) > 100
    assert alignment.error_px < 0.6
