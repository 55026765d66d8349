"""Lassos: inside is by the even-odd rule; what a photo shows there goes, what it hides stays, without colours of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.cameras.structure_from_motion import project
from capture2vr.edge.capture.facts import CaptureFacts
from capture2vr.edge.capture.nouns import (
    Capture,
    Cloud,
    CloudParts,
    Frame,
    Intrinsics,
    Photo,
    PhotoVerdict,
    ShownPicture,
)
from capture2vr.edge.capture.upright_places import turn_places
from capture2vr.edge.capture_to_points import PreparedPoints, to_points
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.jobs.points_archive import read_prepared, write_prepared
from capture2vr.edge.photos.crop import CropRectangle, crop_photo
from capture2vr.edge.photos.upright_photo import UprightPhoto
from capture2vr.edge.points.edit import cut_away, kept_parts
from capture2vr.edge.points.lasso import DrawnView, drawn_views, inside, left_out, require_photos
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.edits import Edits
from capture2vr.order.photo_lasso import PhotoLasso
from tests.support.two_balls import (
    BLUE_AT,
    RADIUS_M,
    RED_AT,
    film_two_balls,
    line_around,
    picture_name,
    write_two_balls,
)

SHARES = st.floats(0, 1)
CORNERS = st.lists(st.tuples(SHARES, SHARES), min_size=3, max_size=12)
BOW_TIE = ((0.1, 0.1), (0.9, 0.9), (0.9, 0.1), (0.1, 0.9))
TWICE_ROUND = 2 * ((0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8))


def places(count: int = 2_000) -> Floats:
    return np.random.default_rng(0).uniform(0, 1, (count, 2))


@given(st.tuples(*6 * [SHARES]))
def test_inside_a_triangle_is_on_one_side_of_its_three_edges(numbers: Any) -> None:
    a, b, c = np.reshape(numbers, (3, 2))
    at = places()

    def side(start: Floats, end: Floats) -> Floats:
        (x, y), way = (at - start).T, end - start
        return way[0] * y - way[1] * x

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    sure = np.abs(sides).min(axis=0) > 1e-9
    expected = (sides > 0).all(axis=0) | (sides < 0).all(axis=0)
    assert (inside(at, [tuple(a), tuple(b), tuple(c)]) == expected)[sure].all()


@given(CORNERS, st.integers(0, 11))
def test_where_a_line_begins_and_its_direction_are_no_matter(line: Any, start: int) -> None:
    start %= len(line)
    other = [*line[start:], *line[:start]][::-1]
    assert (inside(places(), line) != inside(places(), other)).sum() <= 1, "one on the line, by rounding"


def test_a_line_that_crosses_itself_has_an_even_odd_inside() -> None:
    at = np.array([(0.15, 0.5), (0.85, 0.5), (0.5, 0.2), (0.5, 0.8)])
    assert inside(at, BOW_TIE).tolist() == [True, True, False, False]
    assert not inside(places(), TWICE_ROUND).any(), "twice round is outside again"


def test_what_a_line_keeps_and_another_leaves_out_goes() -> None:
    keeps = PhotoLasso("a.jpg", ((0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8)), keeps=True)
    hole = PhotoLasso("a.jpg", ((0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)), through=True)
    at = np.array([(0.3, 0.3), (0.5, 0.5), (0.1, 0.5), (-0.1, 0.5), (0.5, 1.1)])
    assert left_out(at, [keeps, hole]).tolist() == [0, 2, 1, 0, 0]


# Photos


@pytest.mark.parametrize("turns", range(4))
def test_a_place_in_the_upright_photo_is_found_through_turn_lens_and_crop(turns: int) -> None:
    """A point that the lens projects into the stored photo lies where the frame's pinhole and the map put it."""
    whole = Photo("a.jpg", (640, 480), "c", lambda longest=None: np.zeros((480, 640, 3), np.uint8), turns=turns)
    photo = crop_photo(crop_photo(whole, CropRectangle(0.1, 0.1, 0.9, 0.9)), CropRectangle(0.05, 0.0, 0.95, 1.0))
    camera = Intrinsics(500.0, 505.0, photo.size[0] / 2 + 3, photo.size[1] / 2 - 4, *photo.size)
    view = PhotoView(photo, camera, (-0.12, 0.05, 0.001, -0.002, 0.01), np.eye(4))
    xyz = np.random.default_rng(0).uniform((-0.3, -0.2, 0.9), (0.3, 0.2, 1.2), (50, 3))
    x, y = (
        (camera.fx * xyz[:, 0] / xyz[:, 2] + camera.cx + 0.5) / photo.size[0],
        (camera.fy * xyz[:, 1] / xyz[:, 2] + camera.cy + 0.5) / photo.size[1],
    )
    left, top = round(0.1 * 640) + round(0.05 * 512), round(0.1 * 480)
    in_file = (project(view, xyz) + 0.5 + (left, top)) / (640, 480)

    def upright(at: Floats) -> Floats:
        """Pixel (column, row) of h rows moves to (h - 1 - row, column), as OpenCV turns pictures."""
        for _ in range(turns):
            at = np.stack([1 - at[:, 1], at[:, 0]], axis=1)
        return at

    assert np.allclose(UprightPhoto(view)(upright(np.stack([x, y], axis=1))), upright(in_file), atol=1e-6)


def test_a_photo_that_shows_none_of_the_points_takes_none_of_them() -> None:
    photo = Photo("a.jpg", (64, 48), "c", lambda longest=None: np.zeros((48, 64, 3), np.uint8))
    camera = Intrinsics(50.0, 50.0, 31.5, 23.5, 64, 48)
    upright = UprightPhoto(PhotoView(photo, camera, (0.0,) * 5, np.eye(4)))
    everywhere = PhotoLasso("a.jpg", ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), through=True)
    reach = np.full((48, 64), np.inf)
    view = DrawnView(camera, np.eye(4), reach, ShownPicture("a.jpg", upright), (everywhere,))
    assert view.leaves_out(np.array([(0.0, 0.0, -1.0), (9.0, 0.0, 1.0), (0.0, 0.0, 1.0)])).tolist() == [0, 0, 1]
    assert view.leaves_out(np.array([(0.0, 0.0, -1.0), (9.0, 0.0, 1.0)])).tolist() == [0, 0]


def test_turned_places_are_those_that_opencv_turns() -> None:
    picture = np.zeros((3, 4), np.uint8)
    picture[0, 3] = 1
    row, column = np.argwhere(cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE))[0]
    assert np.allclose(turn_places(np.array([(3.5 / 4, 0.5 / 3)]), 1), [((column + 0.5) / 3, (row + 0.5) / 4)])


# Points


@pytest.fixture(scope="module")
def shown() -> Capture:
    frames = tuple(
        replace(frame, shown=ShownPicture(picture_name(number), lambda at: at))
        for number, frame in enumerate(film_two_balls())
    )
    return Capture("rgbd", "synthetic", frames=frames, scale_confidence="metric")


@pytest.fixture(scope="module")
def points(shown: Capture) -> Points:
    return to_points(shown, cut="scene", drawn=frozenset(map(picture_name, range(12))))


def on_ball(xyz: Floats, centre: Floats) -> Floats:
    return (np.abs(np.linalg.norm(xyz - centre, axis=1) - RADIUS_M) < 0.01) & (xyz[:, 2] > 0.02)


def cut(points: Points, *lassos: PhotoLasso) -> Points:
    names = {lasso.photo for lasso in lassos}
    drawn = tuple(frame for frame in points.drawn_in if frame.shown and frame.shown.name in names)
    return cut_away(replace(points, drawn_in=drawn), Edits(lassos=lassos))


def lasso(number: int, centre: Floats = RED_AT, **more: Any) -> PhotoLasso:
    return PhotoLasso(picture_name(number), tuple(line_around(centre, number)), **more)


@pytest.mark.slow
def test_one_lasso_takes_what_its_photo_shows_and_leaves_the_other_thing(points: Points) -> None:
    before, after = on_ball(points.xyz, RED_AT), cut(points, lasso(3))
    pose = np.asarray(points.drawn_in[3].camera_to_world)
    facing = np.einsum("nx,nx->n", points.xyz - RED_AT, pose[:3, 3] - points.xyz) > 0.02
    kept = {tuple(place) for place in after.xyz.tolist()}
    left = np.array([tuple(place) in kept for place in points.xyz.tolist()])
    assert not left[before & facing].any(), "all that the photo sees of it is gone"
    assert left[before & ~facing].mean() > 0.5, "its back stays"
    assert left[on_ball(points.xyz, BLUE_AT)].all()
    assert left[(np.abs(points.xyz[:, 2]) < 0.01) & (points.xyz[:, 0] > 0.05)].all()


@pytest.mark.parametrize("lassos", [[lasso(3), lasso(9)], [lasso(3, through=True)]], ids=["two sides", "through"])
def test_two_sides_or_through_take_the_whole_thing(points: Points, lassos: list[PhotoLasso]) -> None:
    after = cut(points, *lassos)
    assert on_ball(after.xyz, RED_AT).sum() <= 0.02 * on_ball(points.xyz, RED_AT).sum()
    assert on_ball(after.xyz, BLUE_AT).sum() == on_ball(points.xyz, BLUE_AT).sum()


def test_what_is_kept_is_what_is_inside(points: Points) -> None:
    after = cut(points, lasso(3, BLUE_AT, keeps=True, through=True))
    assert on_ball(after.xyz, BLUE_AT).sum() == on_ball(points.xyz, BLUE_AT).sum()
    assert not on_ball(after.xyz, RED_AT).any()


def test_without_depth_the_points_hide_each_other(points: Points) -> None:
    def no_depth(frame: Frame) -> Frame:
        return replace(frame, load_depth_m=lambda: np.zeros((192, 256), np.float32))

    def broken(frame: Frame) -> Frame:
        def load() -> Floats:
            raise CaptureError("IMAGE_UNREADABLE", "is damaged", file=frame.name)

        return replace(frame, load_depth_m=load)

    gone = [len(points) - len(cut(points, lasso(3)))]
    for change in (no_depth, broken):
        blind = replace(points, drawn_in=tuple(map(change, points.drawn_in)))
        gone.append(len(points) - len(cut(blind, lasso(3))))
    assert gone[1] == gone[2]
    assert gone[0] <= gone[1] < 1.25 * gone[0], "and some beside outlines, where a cell shows both"


def test_no_colours_come_of_what_is_left_out(points: Points) -> None:
    after = cut(points, lasso(3))
    own, other = (next(view for view in after.texture_views if view.name == name) for name in ("0003", "0004"))
    before = next(view for view in points.texture_views if view.name == "0003").load_depth_m()
    depth = own.load_depth_m()
    row, column = np.argwhere(depth != before).T
    assert (depth[row, column] < 0.01).all()
    at = np.stack([(column + 0.5) / 256, (row + 0.5) / 192], axis=1)
    assert inside(at, line_around(RED_AT, 3)).all()
    assert len(row) > 500
    assert (other.load_depth_m() == points.drawn_in[4].load_depth_m()).all()
    assert not after.drawn_in


def test_a_large_scene_is_cut_part_by_part_as_at_once(points: Points) -> None:
    def read() -> Iterator[Cloud]:
        for part in np.array_split(points.xyz, 5):
            yield Cloud(part)

    (view,) = drawn_views([points.drawn_in[3]], [lasso(3)], points.xyz)
    parts = kept_parts(CloudParts(len(points), read), Edits(lassos=(lasso(3),)), [view])
    assert np.concatenate([part.xyz for part in parts.read()]).tolist() == cut(points, lasso(3)).xyz.tolist()


def test_another_worker_gets_no_colours_of_it_either(points: Points, tmp_path: Path) -> None:
    """What is before the lens survives the archive's steps of depth."""
    after = cut(points, lasso(3))
    write_prepared(PreparedPoints(after, CaptureFacts("rgbd", "synthetic", 12)), tmp_path / "points.zip")
    read = read_prepared(tmp_path / "points.zip", tmp_path / "read").points
    assert read.edits == after.edits
    sent, received = (
        next(view for view in each.texture_views if view.name == "0003").load_depth_m() for each in (after, read)
    )
    covered = (sent > 0) & (sent < 0.01)
    assert covered.any()
    assert ((received > 0) & (received < 0.01))[covered].all()


def test_a_lasso_that_leaves_nothing_is_refused(points: Points) -> None:
    corner = ((0.0, 0.0), (0.01, 0.0), (0.0, 0.01))
    tiny = [PhotoLasso(picture_name(number), corner, keeps=True, through=True) for number in (0, 3, 6, 9)]
    with pytest.raises(EdgeError, match="the edits leave") as refused:
        cut(points, *tiny)
    assert refused.value.code == "EDITS_NOTHING_LEFT"


# Names


def test_pictures_of_depth_frames_are_known_by_their_file(tmp_path: Path) -> None:
    capture = read_capture(write_two_balls(tmp_path))
    require_photos(capture, [lasso(3)])
    frame = capture.frames[3]
    assert frame.shown is not None
    assert frame.shown.name == picture_name(3)
    assert np.allclose(frame.shown.to_upright(places()), places())
    with pytest.raises(EdgeError, match=r"lassos.1.photo: there is no photo 'x.jpg' in this capture \(open3d\)") as bad:
        require_photos(capture, [lasso(3), replace(lasso(3), photo="x.jpg")])
    assert bad.value.code == "EDITS_UNKNOWN_PHOTO"
    assert picture_name(0) in bad.value.message


def test_captures_without_photos_or_with_one_say_what_to_do() -> None:
    cloud = Capture("points", "ply", cloud=Cloud(np.zeros((1, 3))))
    with pytest.raises(EdgeError, match="which has no photos"):
        require_photos(cloud, [lasso(0)])
    one = Photo(picture_name(0), (4, 3), "c", lambda longest=None: np.zeros((3, 4, 3), np.uint8))
    with pytest.raises(EdgeError, match="a single photo") as refused:
        require_photos(Capture("image", "photo", photos=(one,)), [lasso(0)])
    assert "--box" in refused.value.hints[0]
    require_photos(cloud, [])


def test_a_photo_that_was_not_used_is_warned_of(points: Points, shown: Capture) -> None:
    unread = replace(shown, verdicts=(PhotoVerdict("blurred.jpg", "blur"),))
    drawn = replace(lasso(0), photo="blurred.jpg")
    require_photos(unread, [drawn])
    after = cut(points, drawn)
    assert len(after) == len(points)
    assert "lasso in blurred.jpg had no effect" in after.warnings[-1]
