"""A thing that turns before a still camera: told from its pictures, cut out of them, and brought to points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.features import FAST, features_of, resize_mask
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, Photo
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.photos.crop import CropRectangle, crop_photo
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.photos.turntable import axis_up, mask_background
from capture2vr.edge.points.isolate import isolate_object
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.read_capture import read_capture
from tests.support.photos.turntable import PLATE_RADIUS, Turntable, render_turntable

SIZE_M = 0.4  # of the thing


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Turntable:
    """Ten degrees a step, a third of the way round; the camera trembles by a pixel."""
    return render_turntable(tmp_path_factory.mktemp("table"), views=12, size=(480, 360), turn=120, shake_px=0.7)


@pytest.fixture(scope="module")
def taken(table: Turntable) -> Capture:
    return read_capture(table.photos[0].parent)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """The same scene, in which the camera moves and nothing else."""
    folder = tmp_path_factory.mktemp("walk")
    return read_capture(render_turntable(folder, views=8, size=(320, 240), turn=80, walk=True).photos[0].parent)


@pytest.fixture(scope="module")
def depth(taken: Capture) -> Capture:
    return to_depth(taken)


def changed(capture: Capture, spoil: Callable[[np.ndarray, int], np.ndarray]) -> tuple[Photo, ...]:
    """The photos with other pixels, made of each and of its number."""

    def spoiled(number: int, photo: Photo) -> Photo:
        rgb = np.clip(spoil(photo.load().astype(np.float32), number), 0, 255).astype(np.uint8)

        def load(longest: int | None = None) -> np.ndarray:
            by = min(1.0, (longest or 10**9) / max(rgb.shape))
            return cv2.resize(rgb, None, fx=by, fy=by, interpolation=cv2.INTER_AREA)

        return replace(photo, load=load)

    return tuple(spoiled(number, photo) for number, photo in enumerate(capture.photos))


# What is one and what is none


@pytest.mark.slow
def test_the_masks_show_what_turns(table: Turntable, taken: Capture) -> None:
    masked = mask_background(taken.photos)
    assert [photo.name for photo in masked] == [photo.name for photo in taken.photos]
    for photo, moving in zip(masked, table.moving, strict=True):
        # Photos and masks are cut to the thing, about the middle.
        width, height = photo.size
        top, left = (moving.shape[0] - height) // 2, (moving.shape[1] - width) // 2
        truth, found = moving[top : top + height, left : left + width], resize_mask(photo.mask, (height, width))
        assert truth.sum() == moving.sum()
        assert (found & ~truth).sum() < 0.25 * truth.sum()  # two pixels of the outline are 12 %
        assert (truth & ~found).sum() < 0.03 * truth.sum()


def drifting(rgb: np.ndarray, number: int) -> np.ndarray:
    """It grows lighter by a fifth from the first to the last."""
    return rgb * (0.85 + 0.02 * number)


def grainy(rgb: np.ndarray, number: int) -> np.ndarray:
    return rgb + np.random.default_rng(number).normal(0, 8, rgb.shape)


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [drifting, grainy])
def test_a_drifting_exposure_and_a_grainy_sensor_change_nothing(
    taken: Capture, spoil: Callable[[np.ndarray, int], np.ndarray]
) -> None:
    assert len(mask_background(changed(taken, spoil))) == len(taken.photos)


@pytest.mark.slow
def test_a_walk_around_is_none(walk: Capture) -> None:
    assert mask_background(walk.photos) == ()


@pytest.mark.slow
def test_a_film_of_nothing_moving_is_none(taken: Capture) -> None:
    still = changed(replace(taken, photos=(taken.photos[0],) * 10), grainy)
    assert mask_background(still) == ()


@pytest.mark.slow
def test_a_thing_on_plain_white_is_none(tmp_path: Path, taken: Capture) -> None:
    """Whether it turns or somebody walks around it: there is no still texture to lead the matching astray."""
    plain = render_turntable(tmp_path, views=8, size=(320, 240), turn=90, plain=True)
    assert mask_background(read_capture(plain.photos[0].parent).photos) == ()


@pytest.mark.slow
def test_a_makers_mark_in_every_photo_of_a_walk_is_no_background(walk: Capture) -> None:
    mark = np.random.default_rng(0).uniform(0, 255, (40, 90, 3))

    def marked(rgb: np.ndarray, number: int) -> np.ndarray:
        rgb[-50:-10, -100:-10] = mark
        return rgb

    assert mask_background(changed(walk, marked)) == ()


@pytest.mark.slow
def test_photos_of_several_cameras_or_of_known_pose_are_none(taken: Capture) -> None:
    first, *others = taken.photos
    two_cameras = [replace(photo, camera=f"{number % 2}") for number, photo in enumerate(taken.photos)]
    assert mask_background(two_cameras) == ()
    assert mask_background((replace(first, camera_to_world=np.eye(4)), *others)) == ()


@pytest.mark.slow
def test_one_edited_photo_among_them_only_has_no_mask(taken: Capture) -> None:
    """Smaller and without metadata, as when it was sent by a messenger: a turntable without masks cannot be placed."""
    edited = replace(taken.photos[3], camera="none", size=tuple(side // 2 for side in taken.photos[3].size))
    masked = mask_background((*taken.photos[:3], edited, *taken.photos[4:]))
    assert [photo.name for photo in masked if photo.mask is None] == [edited.name]
    assert len(masked) == len(taken.photos)


@pytest.mark.slow
def test_a_photo_that_cannot_be_read_is_left_to_the_screen(taken: Capture) -> None:
    def broken(longest: int | None = None) -> np.ndarray:
        raise CaptureError("IMAGE_UNREADABLE", "is cut off", file="a.jpg")

    masked = mask_background((*taken.photos[:5], replace(taken.photos[5], load=broken), *taken.photos[6:]))
    assert [photo.mask is None for photo in masked].count(True) == 1


# What is made of it


def placed(depth: Capture, table: Turntable) -> tuple[Floats, Floats]:
    """The similarity (4,4) to the table's world, and the cameras' distances from where they are."""
    true = {photo.name: pose[:3, 3] for photo, pose in zip(table.photos, table.camera_to_world, strict=True)}
    eyes = np.stack([frame.camera_to_world[:3, 3] for frame in depth.frames])
    theirs = np.stack([true[frame.name] for frame in depth.frames])
    to_world, moved, _ = trimesh.registration.procrustes(eyes, theirs, reflection=False)
    return to_world, np.linalg.norm(moved - theirs, axis=1)


@pytest.mark.slow
def test_the_cameras_go_round_the_thing_and_its_axis_is_up(depth: Capture, table: Turntable) -> None:
    to_world, off = placed(depth, table)
    assert len(depth.frames) == 12
    assert off.max() < 0.01 * 2 * 0.79  # of the circle's diameter
    assert depth.turntable
    assert depth.up is not None
    up = to_world[:3, :3] @ depth.up
    assert up[2] / np.linalg.norm(up) > np.cos(np.radians(1))
    assert any("turntable" in warning for warning in depth.warnings)
    assert {verdict.verdict for verdict in depth.verdicts} == {"ok"}


@pytest.mark.slow
def test_points_are_on_the_thing_and_neither_background_nor_plate(depth: Capture, table: Turntable) -> None:
    points = to_points(depth)
    to_world, _ = placed(depth, table)
    xyz = points.xyz @ to_world[:3, :3].T + to_world[:3, 3]
    truth, _ = trimesh.sample.sample_surface(trimesh.Trimesh(table.thing.vertices, table.thing.faces), 60_000, seed=0)
    gaps, _ = cKDTree(truth).query(xyz)
    assert len(points) > 5_000
    assert np.median(gaps) < 0.005 * SIZE_M
    assert np.percentile(gaps, 97) < 0.03 * SIZE_M
    assert np.linalg.norm(xyz[:, :2], axis=1).max() < PLATE_RADIUS + 0.01


@pytest.mark.slow
def test_a_film_of_a_turntable_gives_key_frames(tmp_path: Path) -> None:
    """Most of the picture stands still, and the thing is a fifth of it."""
    table = render_turntable(tmp_path / "frames", views=45, size=(320, 240), turn=180, distance=1.2)
    (tmp_path / "film").mkdir()
    with av.open(str(tmp_path / "film/a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"preset": "veryfast", "crf": "16"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for photo in table.photos:
            with Image.open(photo) as picture:
                container.mux(stream.encode(av.VideoFrame.from_image(picture)))
        container.mux(stream.encode())
    capture = read_capture(tmp_path / "film")
    assert 14 <= len(capture.photos) <= 40
    seconds = [float(photo.name.split(" at ")[1].removesuffix(" s")) for photo in capture.photos]
    assert np.diff(seconds).max() < 0.8  # 32 degrees
    assert len(mask_background(capture.photos)) == len(capture.photos)


# The parts


@settings(max_examples=30)
@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1),
    st.floats(-60, 60),
    st.floats(3, 30),
    st.floats(-0.3, 0.3),
)
def test_the_axis_is_that_of_the_turn_wherever_the_camera_looks(
    axis: list[float], down_deg: float, step_deg: float, aside: float
) -> None:
    """Its sign is that of the pictures' up; the axis is in the camera's vertical plane, or aside of it."""
    unit = np.array(axis) / np.linalg.norm(axis)
    level = np.linalg.svd(unit[None])[2][1]  # across
    ahead = np.cos(np.radians(down_deg)) * level - np.sin(np.radians(down_deg)) * unit
    right = np.cross(ahead, unit) / np.linalg.norm(np.cross(ahead, unit))
    first = np.eye(4)
    first[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    first[:3, 3] = -ahead + aside * right
    frames = []
    for number in range(5):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(np.radians(step_deg) * number * unit).as_matrix()
        frames.append(Frame("", Intrinsics(1, 1, 0, 0, 2, 2), turn @ first, lambda: np.zeros((2, 2))))
    found = axis_up(frames)
    assert found is not None
    assert found @ unit > 0.999


def test_cameras_that_do_not_turn_tell_no_axis() -> None:
    frames = [Frame("", Intrinsics(1, 1, 0, 0, 2, 2), np.eye(4), lambda: np.zeros((2, 2))) for _ in range(4)]
    assert axis_up(frames) is None


@settings(max_examples=20)
@example(60, 150, 0.24999999999999997, None)  # 37.499 pixels on one side, 37.5 on the other
@given(st.integers(60, 200), st.integers(60, 200), st.floats(0.0, 0.25), st.one_of(st.none(), st.integers(30, 200)))
def test_a_part_of_a_photo_shows_what_the_whole_does_there(
    width: int, height: int, margin: float, longest: int | None
) -> None:
    """A ramp along each axis tells every pixel's place; the middle stays the middle."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    ramp = np.rint(255 * np.stack([x, y, 0 * x], axis=-1)).astype(np.uint8)

    def load(longest: int | None = None) -> np.ndarray:
        by = min(1.0, (longest or 10**9) / max(width, height))
        size = (max(1, round(by * width)), max(1, round(by * height)))
        return cv2.resize(ramp, size, interpolation=cv2.INTER_AREA)

    part = crop_photo(Photo("a", (width, height), "one", load), CropRectangle(margin, margin, 1 - margin, 1 - margin))
    assert (part.size[0] - width) % 2 == (part.size[1] - height) % 2 == 0
    shown = part.load(longest)
    assert max(shown.shape) <= (longest or 10**9)
    by_x, by_y = shown.shape[1] / part.size[0], shown.shape[0] / part.size[1]
    left, top = (width - part.size[0]) / 2, (height - part.size[1]) / 2
    row, column = shown.shape[0] // 2, shown.shape[1] // 2
    assert shown[row, column, 0] == pytest.approx(255 * (left + (column + 0.5) / by_x) / width, abs=3)
    assert shown[row, column, 1] == pytest.approx(255 * (top + (row + 0.5) / by_y) / height, abs=3)


@pytest.mark.slow
def test_key_points_lie_inside_the_mask_and_none_is_lost_to_those_outside(taken: Capture) -> None:
    photo = taken.photos[0]
    mask = np.zeros((30, 40), bool)
    mask[10:20, 10:30] = True
    few = replace(FAST, count=60)
    found = features_of(replace(photo, mask=mask), few)
    assert len(found.xy) == 60 == len(found.descriptors)
    column, row = (found.xy + 0.5).T * np.array([[40 / photo.size[0]], [30 / photo.size[1]]])
    assert mask[row.astype(int), column.astype(int)].mean() > 0.95


@pytest.mark.parametrize(("plate_m", "kept"), [(0.3, False), (0.14, True)])
def test_a_plate_goes_where_it_is_wider_than_the_thing_and_lids_stay(plate_m: float, kept: bool) -> None:
    """A box of 0.3 x 0.3 x 0.2 m, whose lid holds a fifth of the points; a foot is narrower than it."""
    rng = np.random.default_rng(0)
    box = trimesh.sample.sample_surface(trimesh.creation.box((0.3, 0.3, 0.2)), 12_000, seed=0)[0] + [0, 0, 0.1]
    box = box[box[:, 2] > 0.001]
    disk = rng.uniform(-plate_m, plate_m, (6_000, 2))
    disk = disk[np.linalg.norm(disk, axis=1) < plate_m]
    xyz = np.concatenate([box, np.column_stack([disk, np.zeros(len(disk))])]) + rng.normal(0, 5e-4, (1, 3))
    points = Points(xyz, None, np.ones(len(xyz), np.float32), 1.0, "unknown", np.array([0, 0, 1.0]))
    cameras = np.array([[0.8 * np.cos(a), 0.8 * np.sin(a), 0.6] for a in np.linspace(0, 6, 12)])
    left = isolate_object(points, aim=np.array([0, 0, 0.1]), cameras=cameras, turntable=True).points
    assert (left.xyz[:, 2] > 0.195).sum() > 2_500  # the lid
    assert ((left.xyz[:, 2] < 0.01).sum() > 1_000) == kept
    assert left.warnings == ()
