"""Which photos are worth aligning: a rendered walk-around that is smeared, darkened and copied on purpose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.cameras.screening import screen
from capture2vr.edge.capture import photos
from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.capture.nouns import Photo, PhotoVerdict
from capture2vr.edge.errors import Cancelled, CaptureError
from tests.support.photos.walkaround import Walkaround, render_walkaround

VIEWS = 10
Spoil = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walkaround:
    return render_walkaround(tmp_path_factory.mktemp("walk"), views=VIEWS, size=(480, 360), arc=150)


@pytest.fixture(scope="module")
def taken(walk: Walkaround) -> tuple[Photo, ...]:
    return photos.read(open_folder(walk.photos[0].parent)).photos


def spoiled(photo: Photo, spoil: Spoil, name: str = "") -> Photo:
    """The photo with other pixels, as its file would give them."""
    rgb = np.clip(spoil(photo.load(480).astype(np.float32)), 0, 255).astype(np.uint8)
    return replace(photo, name=name or photo.name, load=lambda longest=None: rgb)


def smear(pixels: int, degrees: float) -> Spoil:
    """The camera moved while it looked; its sensor adds noise afterwards."""
    kernel = np.zeros((2 * pixels + 1, 2 * pixels + 1), np.float32)
    half = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]) * pixels / 2
    start, end = (tuple(int(v) for v in np.rint(pixels + sign * half)) for sign in (-1, 1))
    cv2.line(kernel, start, end, 1.0, 1, cv2.LINE_AA)
    kernel /= kernel.sum()
    return lambda rgb: cv2.filter2D(rgb, -1, kernel) + np.random.default_rng(0).normal(0, 2, rgb.shape)


def dim(rgb: np.ndarray) -> np.ndarray:
    return 0.08 * rgb


def packed(rgb: np.ndarray) -> np.ndarray:
    """Sent by a messenger: half the size, a low quality."""
    small = cv2.resize(rgb, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return cv2.imdecode(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 40])[1], cv2.IMREAD_COLOR)


def fates(given: Sequence[Photo]) -> dict[str, str]:
    """Photo's name -> verdict; each has exactly one, and those kept are in their order."""
    kept, verdicts = screen(given, tick=no_tick)
    found = {photo.name: "ok" for photo in kept} | {verdict.name: verdict.verdict for verdict in verdicts}
    assert len(kept) + len(verdicts) == len(found) == len(given)
    assert list(kept) == [photo for photo in given if found[photo.name] == "ok"]
    assert all(verdict.advice.endswith(".") for verdict in verdicts)
    return found


@pytest.mark.slow
def test_the_walk_is_what_it_says(walk: Walkaround, taken: tuple[Photo, ...]) -> None:
    """One camera of the focal length in its tags; points that two pictures share lie on each other's epipolar lines."""
    assert len({photo.camera for photo in taken}) == 1
    assert taken[0].focal_px == pytest.approx(walk.intrinsics.fx)
    camera = walk.intrinsics
    k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    sift = cv2.SIFT_create(1500)
    (a, a_features), (b, b_features) = (sift.detectAndCompute(photo.load()[..., 1], None) for photo in taken[:2])
    pairs = [
        one for one, two in cv2.BFMatcher().knnMatch(a_features, b_features, 2) if one.distance < 0.7 * two.distance
    ]
    first = np.array([[*a[pair.queryIdx].pt, 1] for pair in pairs])
    second = np.array([[*b[pair.trainIdx].pt, 1] for pair in pairs])
    between = np.linalg.inv(walk.camera_to_world[1]) @ walk.camera_to_world[0]
    cross = np.cross(np.eye(3), between[:3, 3])
    lines = first @ (np.linalg.inv(k).T @ -cross @ between[:3, :3] @ np.linalg.inv(k)).T
    off_px = np.abs((lines * second).sum(1)) / np.linalg.norm(lines[:, :2], axis=1)
    assert len(pairs) > 150
    assert np.median(off_px) < 0.3


@pytest.mark.slow
def test_the_thing_stands_on_the_table(walk: Walkaround) -> None:
    low, high = walk.thing.vertices.min(0), walk.thing.vertices.max(0)
    assert low[2] == pytest.approx(walk.floor_z)
    assert 0.3 < (high - low).max() < 0.5


@pytest.mark.slow
def test_good_photos_are_all_kept(taken: tuple[Photo, ...]) -> None:
    assert set(fates(taken).values()) == {"ok"}


@pytest.mark.data
def test_real_photos_are_all_kept(data_dir: Path) -> None:
    """20 of a bowl of fruit, hand-held, at ISO 6400 and with little in focus."""
    real = photos.read(open_folder(data_dir / "photos_fruit/images")).photos
    assert len(real) == 20
    assert set(fates(real).values()) == {"ok"}


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0, 45, 90])
def test_smeared_photos_are_left_out(taken: tuple[Photo, ...], degrees: float) -> None:
    mixed = [spoiled(photo, smear(10, degrees)) if at in (2, 7) else photo for at, photo in enumerate(taken)]
    found = fates(mixed)
    assert {name for name, verdict in found.items() if verdict == "blur"} == {mixed[2].name, mixed[7].name}
    assert sum(verdict == "ok" for verdict in found.values()) == VIEWS - 2


@pytest.mark.slow
def test_a_slight_smear_is_kept(taken: tuple[Photo, ...]) -> None:
    assert set(fates([spoiled(taken[0], smear(3, 20)), *taken[1:]]).values()) == {"ok"}


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, VIEWS])
def test_no_more_than_three_in_ten_go_for_blur(taken: tuple[Photo, ...], count: int) -> None:
    """Where all are alike, none is worse than the rest."""
    mixed = [spoiled(photo, smear(12, 0)) if at < count else photo for at, photo in enumerate(taken)]
    blurred = list(fates(mixed).values()).count("blur")
    assert blurred == (3 if count == 4 else 0)


WALLS: dict[str, Spoil] = {
    "noise on white": lambda rgb: np.random.default_rng(0).normal(235, 2, rgb.shape),
    "pure white": lambda rgb: np.full_like(rgb, 255),
    "a sky": lambda rgb: np.broadcast_to(np.linspace(150, 220, len(rgb))[:, None, None], rgb.shape),
    "a thing before white": lambda rgb: np.where(rgb.mean(axis=2, keepdims=True) < 60, rgb, 235),
}


@pytest.mark.slow
@pytest.mark.parametrize("wall", WALLS)
def test_a_smooth_wall_is_no_blur(taken: tuple[Photo, ...], wall: str) -> None:
    assert set(fates([*taken, spoiled(taken[0], WALLS[wall], "wall.jpg")]).values()) == {"ok"}


@pytest.mark.slow
def test_dark_photos_are_left_out_and_black_velvet_is_not(taken: tuple[Photo, ...]) -> None:
    def velvet(rgb: np.ndarray) -> np.ndarray:
        lit = np.zeros(rgb.shape[:2], bool)
        lit[120:240, 160:320] = True
        return np.where(lit[..., None], rgb, 3)

    found = fates([spoiled(taken[0], dim), spoiled(taken[1], velvet), *taken[2:]])
    assert [name for name, verdict in found.items() if verdict != "ok"] == [taken[0].name]
    assert found[taken[0].name] == "dark"


@pytest.mark.slow
def test_of_forty_copies_one_is_kept(taken: tuple[Photo, ...]) -> None:
    found = fates([replace(taken[0], name=f"{copy}.jpg") for copy in range(40)])
    assert [name for name, verdict in found.items() if verdict == "ok"] == ["0.jpg"]
    assert list(found.values()).count("duplicate") == 39


def test_of_the_same_picture_the_original_is_kept_although_its_copies_sort_first(taken: tuple[Photo, ...]) -> None:
    names = ("far/a (1).jpg", "far/a (2).jpg", "far/a.jpg", "far/b - Copy.jpg", "far/b.jpg", "far/c.jpg")
    given = [replace(taken[at], name=name) for at, name in zip((0, 0, 0, 3, 3, 3), names, strict=True)]
    kept, verdicts = screen(given, tick=no_tick)
    assert [photo.name for photo in kept] == ["far/a.jpg", "far/b.jpg"]
    originals = {"far/a (1).jpg": "a.jpg", "far/a (2).jpg": "a.jpg", "far/b - Copy.jpg": "b.jpg", "far/c.jpg": "b.jpg"}
    assert {each.name for each in verdicts} == set(originals)
    assert all(each.verdict == "duplicate" for each in verdicts)
    assert all(f"the same as far/{originals[each.name]};" in each.advice for each in verdicts)


@pytest.mark.slow
def test_a_messengers_copy_is_told_apart_from_a_step_aside(taken: tuple[Photo, ...]) -> None:
    copies = [spoiled(photo, packed, f"copy of {photo.name}") for photo in taken]
    found = fates([*taken, *copies])
    assert all(verdict == ("duplicate" if name.startswith("copy") else "ok") for name, verdict in found.items())


@pytest.mark.slow
def test_a_pale_thing_has_no_copies(taken: tuple[Photo, ...]) -> None:
    """A twentieth of the contrast is as little difference between views, not the same view."""
    assert set(fates([spoiled(photo, lambda rgb: 215 + 0.05 * rgb) for photo in taken]).values()) == {"ok"}


@pytest.mark.slow
def test_what_cannot_be_decoded_is_told(taken: tuple[Photo, ...]) -> None:
    def broken(longest: int | None = None) -> np.ndarray:
        raise CaptureError("IMAGE_UNREADABLE", "is cut off: the end of the JPEG is missing", file="a.jpg")

    _, verdicts = screen([replace(taken[0], load=broken), *taken[1:]], tick=no_tick)
    advice = "It is cut off: the end of the JPEG is missing; send it again as a JPEG or HEIC."
    assert verdicts == (PhotoVerdict(taken[0].name, "unreadable", advice),)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1, 1), (2, 2), (1, 400), (9, 8)])
def test_tiny_pictures_are_no_trouble(taken: tuple[Photo, ...], size: tuple[int, int]) -> None:
    assert len(fates([*taken, spoiled(taken[0], lambda rgb: np.full((*size, 3), 90.0), "tiny.png")])) == VIEWS + 1


def test_nothing_in_nothing_out() -> None:
    assert screen((), tick=no_tick) == ((), ())


@pytest.mark.slow
def test_it_can_be_stopped(taken: tuple[Photo, ...]) -> None:
    def stop(fraction: float) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        screen(taken, tick=stop)


KINDS: dict[str, Spoil] = {"ok": lambda rgb: rgb, "blur": smear(10, 30), "dark": dim}


@pytest.mark.slow
@settings(max_examples=10)
@given(kinds=st.lists(st.sampled_from(list(KINDS)), min_size=VIEWS, max_size=VIEWS))
def test_any_mixture_keeps_what_is_good(taken: tuple[Photo, ...], kinds: list[str]) -> None:
    mixed = [spoiled(photo, KINDS[kind]) for photo, kind in zip(taken, kinds, strict=True)]
    found = fates(mixed)
    for photo, kind in zip(mixed, kinds, strict=True):
        assert found[photo.name] in (("ok", "blur") if kind == "blur" else (kind,))
    lit = VIEWS - kinds.count("dark")
    assert list(found.values()).count("blur") <= 0.3 * lit
