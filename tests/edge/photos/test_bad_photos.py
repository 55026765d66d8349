"""Photos that cannot give a thing, or of which only some can: what is used is used, and a sentence names the rest."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras import placement_attempts, sfm_child, sfm_process
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.capture_to_points import prepare, to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.progress import Bar, ignore_progress
from capture2vr.edge.read_capture import read_capture
from tests.cli.local.test_run import capture2vr
from tests.support.captures import FLIP, save_png, steps, write_open3d
from tests.support.photos import bad_photos
from tests.support.photos.walkaround import Walkaround, render_walkaround


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walkaround:
    return render_walkaround(tmp_path_factory.mktemp("walk"), views=10, size=(400, 300), arc=100)


@pytest.fixture
def photos(walk: Walkaround, tmp_path: Path) -> list[Path]:
    """The walk's photos, in a folder of their own that may be spoilt."""
    folder = tmp_path / "photos"
    folder.mkdir()
    return [Path(shutil.copy(photo, folder)) for photo in walk.photos]


def points_of(capture: Capture) -> Points:
    steps = prepare(capture, Bar(ignore_progress), refines=False)
    try:
        while True:
            next(steps)
    except StopIteration as end:
        points: Points = end.value.points
        return points


@pytest.mark.slow
def test_black_photos_are_named_and_the_others_are_used(photos: list[Path]) -> None:
    for photo in photos[1::2]:
        bad_photos.blacken(photo)
    points = points_of(read_capture(photos[0].parent))
    assert len(points) > 2_000
    (warning,) = [each for each in points.warnings if "dark" in each]
    assert warning.startswith("5 of 10 photos were not used: 5 dark (IMG_0001.jpg, IMG_0003.jpg,")


@pytest.mark.slow
def test_of_two_things_the_one_with_more_photos_is_made(
    photos: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The two shells differ in their textures alone: a network takes them for one, since shapes are what it matches.
    monkeypatch.setattr(placement_attempts, "is_installed", lambda: False)
    other = render_walkaround(tmp_path / "other", views=4, size=(400, 300), arc=40, seed=5)
    for photo in other.photos:
        photo.rename(photos[0].parent / f"other_{photo.name}")
    capture = to_depth(read_capture(photos[0].parent))
    assert {frame.name for frame in capture.frames} == {photo.name for photo in photos}
    (warning,) = [each for each in capture.warnings if "groups of 10 and 4" in each]
    assert "other_IMG_0000.jpg" in warning


@pytest.mark.slow
def test_a_damaged_photo_is_named_and_the_others_are_used(photos: list[Path]) -> None:
    photos[4].write_bytes(photos[4].read_bytes()[:3000])
    capture = to_depth(read_capture(photos[0].parent))
    assert len(capture.frames) == 9
    assert capture.warnings[0] == "1 of 10 photos were not used: 1 unreadable (IMG_0004.jpg)."


def all_the_same(poses: Floats) -> Floats:
    return np.repeat(poses[:1], len(poses), axis=0)


def shuffled(poses: Floats) -> Floats:
    return poses[np.random.default_rng(0).permutation(len(poses))]


def in_opengl_axes(poses: Floats) -> Floats:
    return poses @ FLIP


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [all_the_same, shuffled, in_opengl_axes])
def test_poses_that_contradict_the_photos_are_not_used(
    spoil: Callable[[Floats], Floats], walk: Walkaround, tmp_path: Path
) -> None:
    folder = bad_photos.write_posed(tmp_path / "posed", walk.photos, spoil(walk.camera_to_world), walk.intrinsics)
    capture = to_depth(read_capture(folder))
    assert len(capture.frames) == len(walk.photos)
    assert any("contradict what the photos show" in warning for warning in capture.warnings)
    assert capture.scale_confidence == "unknown"
    assert capture.up is None
    placed = _steps([np.asarray(frame.camera_to_world) for frame in capture.frames])
    assert placed == pytest.approx(_steps(walk.camera_to_world), rel=0.2)


@pytest.mark.slow
def test_photos_without_a_pose_among_posed_ones_are_named(walk: Walkaround, tmp_path: Path) -> None:
    folder = bad_photos.write_posed(tmp_path / "posed", walk.photos, walk.camera_to_world, walk.intrinsics)
    tree = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps(tree | {"frames": tree["frames"][:8]}))
    capture = read_capture(folder)
    assert len(capture.photos) == 8
    (warning,) = capture.warnings
    assert warning.startswith("2 photos were not used, because transforms.json does not tell their cameras: images/IMG")


def _steps(poses: Sequence[Floats]) -> Floats:
    """Distances from camera to camera, in shares of the whole way: neither axes nor scale of the poses change them."""
    eyes = np.stack([pose[:3, 3] for pose in poses])
    lengths = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    return lengths / lengths.sum()


@pytest.mark.slow
def test_a_picture_on_a_screen_is_called_flat(tmp_path: Path) -> None:
    points = points_of(read_capture(bad_photos.write_of_a_screen(tmp_path)))
    assert any("screen" in warning for warning in points.warnings)


@pytest.mark.slow
def test_photos_from_one_spot_show_no_depth(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        points_of(read_capture(bad_photos.write_from_one_spot(tmp_path)))
    assert caught.value.code == "CAPTURE_DEGENERATE"
    assert "IMG_00.jpg to IMG_09.jpg the camera turned, but it did not move" in caught.value.message


@pytest.mark.slow
def test_photos_that_were_left_out_before_none_could_be_placed_are_counted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for number in range(8):
        Image.fromarray(rng.integers(0, 255, (120, 160, 3), np.uint8)).save(tmp_path / f"IMG_{number}.png")
    for number in (2, 5):
        shutil.copy(tmp_path / f"IMG_{number}.png", tmp_path / f"IMG_{number} (1).png")
    with pytest.raises(CaptureError, match="of 8 photos overlap") as caught:
        to_depth(read_capture(tmp_path))
    assert caught.value.hints[0] == "2 of the 10 photos were left out before: 2 duplicate"
    assert any(each.startswith("not placed: IMG_0.png") for each in caught.value.hints)
    assert not any("(1)" in each for each in caught.value.hints)


@pytest.mark.slow
def test_the_sky_has_no_texture(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        to_depth(read_capture(bad_photos.write_of_the_sky(tmp_path)))
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"
    assert "8 photos show hardly any texture" in caught.value.hints[0]
    assert "IMG_00.jpg" in caught.value.hints[1]


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1, 1), (1, 1800), (2, 900), (800, 1)])
def test_photos_that_are_lines_or_dots_show_nothing(size: tuple[int, int], tmp_path: Path) -> None:
    for number in range(3):
        save_png(
            tmp_path / f"{number}.png", np.random.default_rng(number).integers(90, 255, (*size, 3)).astype(np.uint8)
        )
    with pytest.raises(CaptureError) as caught:
        to_depth(read_capture(tmp_path))
    assert caught.value.code == "CAPTURE_LOW_OVERLAP"


def test_the_mapper_ends_by_itself_before_its_parents_patience_does() -> None:
    """Then what it has placed is used; a child that is killed leaves nothing."""
    seconds = sfm_child._options(1.0, given=False).max_runtime_seconds
    assert 0 < seconds < sfm_process._SILENT_SECONDS


def test_depth_of_one_value_is_a_placeholder(tmp_path: Path) -> None:
    folder = write_open3d(tmp_path)
    for index in range(4):
        save_png(folder / f"depth/{index:05}.png", steps(np.ones((48, 64))))
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_DEGENERATE", "depth")
    assert "1 m at every pixel" in caught.value.message


def test_one_whole_depth_image_among_empty_ones_is_found_wherever_it_is(tmp_path: Path) -> None:
    folder = write_open3d(tmp_path)
    for index in (0, 2, 3):
        save_png(folder / f"depth/{index:05}.png", steps(np.zeros((48, 64))))
    points = to_points(read_capture(folder), cut="scene")
    assert len(points) >= 100
    assert "3 of 4 depth images are empty" in points.warnings[0]


@pytest.mark.parametrize("number", [0, 5, 11])
def test_one_damaged_depth_image_of_many_is_passed_over_wherever_it_is(number: int, tmp_path: Path) -> None:
    folder = write_open3d(tmp_path, 12)
    _damage(folder / f"depth/{number:05}.png")
    points = to_points(read_capture(folder), cut="scene")
    assert len(points) >= 100
    assert points.warnings[0].startswith(f"frame skipped: depth/{number:05}.png: cannot be decoded")


def test_when_the_depth_images_that_are_looked_at_are_damaged_the_error_says_so(tmp_path: Path) -> None:
    folder = write_open3d(tmp_path, 12)
    for number in (0, 11):
        _damage(folder / f"depth/{number:05}.png")
    with pytest.raises(CaptureError, match="damaged") as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("IMAGE_UNREADABLE", "depth/00000.png")


def _damage(image: Path) -> None:
    """Overwrite pixels behind a whole header."""
    data = bytearray(image.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    image.write_bytes(bytes(data))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("write", "says", "advises"),
    [
        (bad_photos.write_from_one_spot, "did not move", "walk while you take them"),
        (bad_photos.write_of_the_sky, "only 0 of 8 photos overlap", "hardly any texture"),
        (
            lambda folder: bad_photos.write_copies(folder, render_walkaround(folder / "one", views=1).photos[0], 9),
            "cannot be used: 9 duplicate",
            "take a step to the side",
        ),
    ],
    ids=["one spot", "sky", "copies"],
)
def test_the_command_line_says_what_is_wrong_and_what_to_do(
    write: Callable[[Path], Path], says: str, advises: str, tmp_path: Path
) -> None:
    result = capture2vr("run", write(tmp_path / "bad"), "-o", tmp_path / "out", "--preset", "draft")
    sentence = " ".join(result.stderr.split())
    assert result.returncode == 2
    assert "Traceback" not in sentence
    assert says in sentence
    assert advises in sentence
    assert not (tmp_path / "out").exists()
