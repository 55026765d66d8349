"""Two to eight photos: what can be placed is used, of what cannot one becomes a relief, and all are told about."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.cameras.features import FAST, Features
from capture2vr.edge.cameras.placement_attempts import Attempt
from capture2vr.edge.cameras.sfm_process import SfmResult
from capture2vr.edge.capture.nouns import Capture, Photo, PhotoVerdict
from capture2vr.edge.capture_to_points import PreparedPoints, prepare
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.progress import Bar
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo import few_photos
from capture2vr.edge.single_photo.few_photos import depth_or_guess, guess_instead
from capture2vr.order.job_options import JobOptions
from capture2vr.order.photo_box import PhotoBox
from capture2vr.storage.bundle import Bundle
from tests.support.photos.single_photos import photo
from tests.support.photos.walkaround import render_walkaround

LOST = CaptureError("CAPTURE_LOW_OVERLAP", "only 0 of 3 photos overlap enough", hints=("walk around it",))
SIZE = (120, 160)


def wall(seed: int = 0) -> Bytes:
    noise = np.random.default_rng(seed).normal(0, 6, (*SIZE, 3))
    return np.clip(150 + noise, 0, 255).astype(np.uint8)


def disc(colour: tuple[int, int, int], seed: int = 0) -> Bytes:
    """A disc in the middle of a wall, as noisy as this."""
    rgb, away = wall(seed), np.hypot(*(np.indices(SIZE) - np.array(SIZE)[:, None, None] / 2))
    rgb[away < 35] = np.clip(rgb[away < 35].astype(int) - 150 + np.array(colour), 0, 255)
    return rgb


DIM, VIVID = photo(disc((150, 138, 128), 1), name="dim.jpg"), photo(disc((190, 40, 30), 2), name="vivid.jpg")
BARE = photo(wall(3), name="bare.jpg")


def capture_of(*photos: Photo) -> Capture:
    return Capture("photos", "photos", photos=photos, warnings=("one was sent twice",))


@pytest.fixture
def lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Structure from motion places nothing."""

    def nothing(*_: Any, **__: Any) -> Capture:
        raise LOST

    monkeypatch.setattr(few_photos, "to_depth", nothing)


@pytest.mark.usefixtures("lost")
def test_of_photos_that_nothing_places_the_clearest_becomes_a_guess_and_all_are_told() -> None:
    found = depth_or_guess(capture_of(BARE, DIM, VIVID))
    assert (found.kind, [each.name for each in found.photos]) == ("image", ["vivid.jpg"])
    assert [(each.name, each.verdict) for each in found.verdicts] == [
        ("bare.jpg", "no_overlap"),
        ("dim.jpg", "no_overlap"),
        ("vivid.jpg", "ok"),
    ]
    assert "six more" in found.verdicts[0].advice
    first, told = found.warnings
    assert first == "one was sent twice"
    for part in ("guess", "relief of vivid.jpg", LOST.message, "not used: bare.jpg, dim.jpg", "six more"):
        assert part in told


@pytest.mark.usefixtures("lost")
def test_the_photo_with_the_rectangle_becomes_the_relief_however_clear_others_are() -> None:
    box = PhotoBox(0.2, 0.1, 0.8, 0.9, "dim.jpg")
    found = depth_or_guess(capture_of(VIVID, DIM), box=box)
    assert [each.name for each in found.photos] == ["dim.jpg"]
    assert "marked" in found.warnings[-1]


@pytest.mark.slow
@pytest.mark.usefixtures("lost")
def test_where_no_photo_shows_an_object_the_error_stays_and_says_so() -> None:
    with pytest.raises(CaptureError) as caught:
        depth_or_guess(capture_of(BARE, photo(wall(4), name="other.jpg")))
    assert (caught.value.code, caught.value.message) == (LOST.code, LOST.message)
    assert caught.value.hints[0] == "walk around it"
    assert "rectangle" in caught.value.hints[-1]


@pytest.mark.parametrize(
    ("capture", "error"),
    [
        (capture_of(*[VIVID] * 9), LOST),
        (capture_of(VIVID), LOST),
        (replace(capture_of(VIVID, DIM), format="video"), LOST),
        (capture_of(replace(VIVID, part=(0.0, 0.0, 0.5, 1.0)), DIM), LOST),
        (capture_of(VIVID, DIM), EdgeError("DISK_FULL", "no space left")),
    ],
    ids=["nine", "one", "a video", "a panorama", "a full disk"],
)
def test_all_else_ends_as_before(capture: Capture, error: EdgeError) -> None:
    with pytest.raises(EdgeError) as caught:
        guess_instead(capture, error)
    assert caught.value is error


def test_photos_that_were_not_placed_are_named_with_their_best_use(monkeypatch: pytest.MonkeyPatch) -> None:
    verdicts = (
        PhotoVerdict("bare.jpg", "no_overlap", "take more"),
        PhotoVerdict("dim.jpg", "ok"),
        PhotoVerdict("vivid.jpg", "no_overlap", "take more"),
    )
    placed = Capture("rgbd", "photos", verdicts=verdicts, warnings=("only 1 of 3",))
    monkeypatch.setattr(few_photos, "to_depth", lambda *_, **__: placed)
    found = depth_or_guess(capture_of(BARE, DIM, VIVID))
    assert [each.advice for each in found.verdicts[:2]] == ["take more", ""]
    assert found.verdicts[2].advice.startswith("take more; ")
    assert "relief" in found.verdicts[2].advice
    assert len(found.warnings) == 2
    assert found.warnings[1].endswith("vivid.jpg")
    many = capture_of(BARE, DIM, VIVID, *[photo(wall(), name=f"{number}.jpg") for number in range(6)])
    assert depth_or_guess(many) is placed, "of many, the walk is what is missing"


@pytest.mark.slow
def test_where_depth_of_few_photos_gives_no_object_one_becomes_a_relief(monkeypatch: pytest.MonkeyPatch) -> None:
    given = capture_of(DIM, VIVID)
    monkeypatch.setattr(few_photos, "to_depth", lambda *_, **__: replace(given, kind="rgbd", photos=()))

    def nothing_left(*_: Any, **__: Any) -> None:
        raise CaptureError("CAPTURE_NOTHING_LEFT", "nothing stands in the middle")

    monkeypatch.setattr("capture2vr.edge.capture_to_points.to_points", nothing_left)
    steps, made = prepare(given, Bar(lambda _: None), refines=False), None
    while made is None:
        try:
            next(steps)
        except StopIteration as stop:
            made = stop.value
    assert isinstance(made, PreparedPoints)
    assert (made.source.kind, made.source.frames) == ("image", 2)
    assert made.points.origin is not None
    assert (made.points.origin == PROPOSED).all()
    assert [each.verdict for each in made.source.verdicts] == ["no_overlap", "ok"]


@pytest.mark.parametrize(("placed", "count", "enough"), [(3, 8, True), (3, 9, False), (2, 8, False), (6, 9, True)])
def test_of_a_few_photos_whatever_is_placed_is_enough(placed: int, count: int, enough: bool) -> None:
    model_of = np.where(np.arange(count) < placed, 0, -1)
    nothing = np.zeros(0, np.int64)
    poses, xyz = np.zeros((placed, 4, 4)), np.zeros((0, 3))
    answer = SfmResult((), model_of, np.arange(placed), poses, xyz, nothing, nothing, nothing)
    none = Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
    assert Attempt(FAST, [none] * count, np.zeros((0, 2), np.int64), answer).enough == enough


@pytest.mark.slow
@pytest.mark.essential
@pytest.mark.usefixtures("small_pictures")
def test_three_photos_from_all_around_become_an_asset_that_is_called_a_guess(tmp_path: Path) -> None:
    """Nothing in one is in the next: a relief of the clearest, and a report of all three."""
    (tmp_path / "walk").mkdir()
    folder = render_walkaround(tmp_path / "walk", views=3, size=(400, 300), arc=360).photos[0].parent
    steps = reconstruct(read_capture(folder), replace(load_preset("draft"), resolution=48), JobOptions())
    *_, bundle = (step for step in steps if isinstance(step, Bundle))
    manifest = bundle.manifest
    assert manifest["origin"] == "guess"
    assert (manifest["capture"]["kind"], manifest["capture"]["frames"]) == ("image", 3)
    assert sorted(each["verdict"] for each in manifest["capture"]["photos"]) == ["no_overlap", "no_overlap", "ok"]
    assert manifest["quality"]["origins"]["proposed"] == 1
    assert any("the 3 photos gave no measured shape" in warning for warning in manifest["warnings"])


def test_two_photos_are_a_capture(tmp_path: Path) -> None:
    for each in (DIM, VIVID):
        cv2.imwrite(str(tmp_path / each.name), each.load()[..., ::-1])
    capture = read_capture(tmp_path)
    assert (capture.kind, len(capture.photos)) == ("photos", 2)
