"""COLMAP's models, as text and binary: written by hand after their description, and by COLMAP itself."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings import colmap
from tests.support import captures
from tests.support.patience import HANG_S

FX, FY, CX, CY = captures.colour_camera()
WIDTH, HEIGHT = captures.WIDTH * captures.COLOUR_SCALE, captures.HEIGHT * captures.COLOUR_SCALE
POSES = captures.poses(12)
MODELS = {
    "SIMPLE_PINHOLE": (0, [FX, CX + 0.5, CY + 0.5], (0, 0, 0, 0, 0)),
    "PINHOLE": (1, [FX, FY, CX + 0.5, CY + 0.5], (0, 0, 0, 0, 0)),
    "SIMPLE_RADIAL": (2, [FX, CX + 0.5, CY + 0.5, 0.1], (0.1, 0, 0, 0, 0)),
    "RADIAL": (3, [FX, CX + 0.5, CY + 0.5, 0.1, 0.02], (0.1, 0.02, 0, 0, 0)),
    "OPENCV": (4, [FX, FY, CX + 0.5, CY + 0.5, 0.1, 0.02, 0.003, 0.004], (0.1, 0.02, 0.003, 0.004, 0)),
    "FULL_OPENCV": (
        6,
        [FX, FY, CX + 0.5, CY + 0.5, 0.1, 0.02, 0.003, 0.004, 0.05, 0, 0, 0],
        (0.1, 0.02, 0.003, 0.004, 0.05),
    ),
}
NAMES = [f"frame {index}.jpg" for index in range(len(POSES))]
FORMS = ("text", "binary")


def world_to_camera(pose: np.ndarray) -> np.ndarray:
    """(7,) quaternion w, x, y, z and translation."""
    inverse = np.linalg.inv(pose)
    return np.concatenate([captures.quaternion(inverse[:3, :3])[[3, 0, 1, 2]], inverse[:3, 3]])


def cameras(form: str, kind: int, model: str, parameters: list[float]) -> bytes:
    if form == "binary":
        head = struct.pack("<QIiQQ", 1, 7, kind, WIDTH, HEIGHT)
        return head + np.array(parameters, "<f8").tobytes()
    words = " ".join(map(str, parameters))
    return f"# Camera list\n# one a line\n7 {model} {WIDTH} {HEIGHT} {words}\n".encode()


def images(form: str, names: list[str], poses: list[np.ndarray], seen: int = 2) -> bytes:
    """`seen` observations in each."""
    if form == "binary":
        data = struct.pack("<Q", len(names))
        for number, (name, pose) in enumerate(zip(names, poses, strict=True)):
            data += struct.pack("<I7dI", number, *world_to_camera(pose), 7) + name.encode() + b"\0"
            data += struct.pack("<Q", seen) + struct.pack("<ddq", 1.0, 2.0, -1) * seen
        return data
    lines = ["# Image list"]
    for number, (name, pose) in enumerate(zip(names, poses, strict=True)):
        lines += [f"{number} {' '.join(map(repr, world_to_camera(pose).tolist()))} 7 {name}", "1.0 2.0 -1 " * seen]
    return "\n".join(lines).encode() + b"\n"


def write(root: Path, form: str = "binary", model: str = "PINHOLE", *, photos: str = "images", seen: int = 2) -> Path:
    """A whole project; returns the model's folder."""
    kind, parameters, _ = MODELS[model]
    place, end = root / "sparse/0", {"text": "txt", "binary": "bin"}[form]
    place.mkdir(parents=True)
    (place / f"cameras.{end}").write_bytes(cameras(form, kind, model, parameters))
    (place / f"images.{end}").write_bytes(images(form, NAMES, POSES, seen))
    (place / "points3D.txt").write_text("1 0 0 0 9 9 9 0.1\n")
    for index, name in enumerate(NAMES):
        captures.save_jpg(root / photos / name, captures.picture(index))
    return place


def read(root: Path) -> Capture:
    folder = open_folder(root)
    assert colmap.matches(folder)
    with np.errstate(all="ignore"):  # as the entry to all formats has it
        return colmap.read(folder)


def error_of(root: Path) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        read(root)
    return caught.value


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seen", [0, 2])
def test_cameras_and_poses_are_the_writers(tmp_path: Path, form: str, model: str, seen: int) -> None:
    write(tmp_path, form, model, seen=seen)
    capture = read(tmp_path)
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "colmap", "unknown")
    assert [photo.name for photo in capture.photos] == [f"images/{name}" for name in NAMES]
    for photo, pose in zip(capture.photos, POSES, strict=True):
        assert photo.camera_to_world == pytest.approx(pose, abs=1e-9)
        assert photo.intrinsics is not None
        fields = ("fx", "fy", "cx", "cy", "width", "height")
        assert [getattr(photo.intrinsics, field) for field in fields] == pytest.approx([FX, FY, CX, CY, WIDTH, HEIGHT])
        assert photo.distortion == MODELS[model][2]
        assert photo.load().shape == (HEIGHT, WIDTH, 3)
    assert len({photo.camera for photo in capture.photos}) == 1


OBSERVATIONS = ("", "1.0 2.0 -1", "10 20 -1 30 40 5 60 70 8 90 100 -1", None)


@pytest.fixture(scope="module")
def text_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("model"), "text")


@pytest.mark.slow
@given(
    seen=st.lists(st.sampled_from(OBSERVATIONS), min_size=len(NAMES), max_size=len(NAMES)),
    blank=st.lists(st.integers(0, 2), min_size=len(NAMES), max_size=len(NAMES)),
)
@example(seen=[None] * len(NAMES), blank=[0] * len(NAMES))
@example(seen=[""] * len(NAMES), blank=[1] + [0] * (len(NAMES) - 1))
def test_lines_of_observations_may_be_left_out(text_model: Path, seen: list[str | None], blank: list[int]) -> None:
    """Of any of the photos, and blank lines may stand before any."""
    poses = images("text", NAMES, POSES).decode().splitlines()[1::2]
    lines = ["# Image list"]
    for pose, observations, before in zip(poses, seen, blank, strict=True):
        lines += [*[""] * before, pose, *([] if observations is None else [observations])]
    (text_model / "images.txt").write_text("\n".join(lines) + "\n")
    photos = read(text_model.parents[1]).photos
    assert [photo.name for photo in photos] == [f"images/{name}" for name in NAMES]
    assert np.stack([photo.camera_to_world for photo in photos]) == pytest.approx(np.stack(POSES), abs=1e-9)


# In a process of its own: pycolmap takes over signals of the one that imports it.
_WRITER = """
import sys
import numpy as np
import pycolmap

place, form, size, parameters, names, poses = sys.argv[1], sys.argv[2], *map(eval, sys.argv[3:])
model = pycolmap.Reconstruction()
camera = pycolmap.Camera(model="OPENCV", width=size[0], height=size[1], params=parameters, camera_id=3)
model.add_camera_with_trivial_rig(camera)
for number, (name, pose) in enumerate(zip(names, poses), 1):
    image = pycolmap.Image(name=name, camera_id=3, image_id=number)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.array(pose)))
(model.write_text if form == "text" else model.write_binary)(place)
"""


@pytest.mark.parametrize("form", FORMS)
def test_models_that_colmap_wrote(tmp_path: Path, form: str) -> None:
    place = write(tmp_path)
    for file in place.iterdir():
        file.unlink()
    poses = [np.linalg.inv(pose)[:3].tolist() for pose in POSES]
    values = map(repr, ((WIDTH, HEIGHT), MODELS["OPENCV"][1], NAMES, poses))
    subprocess.run([sys.executable, "-c", _WRITER, str(place), form, *values], check=True, timeout=HANG_S)
    capture = read(tmp_path)
    assert np.stack([photo.camera_to_world for photo in capture.photos]) == pytest.approx(np.stack(POSES), abs=1e-9)
    assert capture.photos[0].distortion == MODELS["OPENCV"][2]


@pytest.mark.parametrize("photos", ["images", "input/day 1", "."])
def test_photos_are_found_in_any_folder(tmp_path: Path, photos: str) -> None:
    write(tmp_path, photos=photos)
    assert len(read(tmp_path).photos) == len(NAMES)


def test_smaller_copies_are_second_choice(tmp_path: Path) -> None:
    write(tmp_path)
    write(tmp_path / "copies", photos="images_4")
    (tmp_path / "copies/images_4").rename(tmp_path / "images_4")
    assert read(tmp_path).photos[0].name == f"images/{NAMES[0]}"


def test_shrunk_photos_shrink_the_camera(tmp_path: Path) -> None:
    write(tmp_path)
    for index, name in enumerate(NAMES):
        captures.save_jpg(tmp_path / "images" / name, captures.picture(index)[::2, ::2])
    camera = read(tmp_path).photos[0].intrinsics
    assert camera is not None
    assert (camera.fx, camera.cx, camera.width) == pytest.approx((FX / 2, (CX + 0.5) / 2 - 0.5, WIDTH / 2))


def test_missing_photos_are_dropped_with_a_warning(tmp_path: Path) -> None:
    write(tmp_path)
    for name in NAMES[:2]:
        (tmp_path / "images" / name).unlink()
    capture = read(tmp_path)
    assert len(capture.photos) == len(NAMES) - 2
    assert f"2 photos missing: {NAMES[0]}, {NAMES[1]}" in capture.warnings


def test_the_larger_of_two_models_is_read(tmp_path: Path) -> None:
    place = write(tmp_path)
    (tmp_path / "sparse/1").mkdir()
    (tmp_path / "sparse/1/cameras.bin").write_bytes((place / "cameras.bin").read_bytes())
    (tmp_path / "sparse/1/images.bin").write_bytes(images("binary", NAMES[:3], POSES[:3]))
    assert len(read(tmp_path).photos) == len(NAMES)


def test_a_broken_photo_and_a_lost_pose_cost_themselves(tmp_path: Path) -> None:
    place = write(tmp_path)
    (tmp_path / "images" / NAMES[1]).write_bytes(b"\xff\xd8\xff")
    capture = read(tmp_path)
    assert [(verdict.name, verdict.verdict) for verdict in capture.verdicts] == [(f"images/{NAMES[1]}", "unreadable")]
    captures.save_jpg(tmp_path / "images" / NAMES[1], captures.picture(1))
    where = np.asarray(world_to_camera(POSES[-1])[4:], "<f8").tobytes()
    (place / "images.bin").write_bytes(images("binary", NAMES, POSES).replace(where, struct.pack("<3d", *[np.nan] * 3)))
    capture = read(tmp_path)
    assert len(capture.photos) == len(NAMES) - 1
    assert "not finite" in capture.warnings[0]


def _replaced(path: str, content: bytes) -> Callable[[Path], None]:
    def spoil(root: Path) -> None:
        (root / path).write_bytes(content)

    return spoil


def _no_photos(root: Path) -> None:
    for name in NAMES:
        (root / "images" / name).unlink()


def _turned_photos(root: Path) -> None:
    for index, name in enumerate(NAMES):
        captures.save_jpg(root / "images" / name, captures.picture(index).transpose(1, 0, 2))


CAMERAS, IMAGES = "sparse/0/cameras.bin", "sparse/0/images.bin"
PINHOLE = [FX, FY, CX, CY]
BAD_CAMERA = ("CAPTURE_BAD_INTRINSICS", CAMERAS)


def _camera(kind: int, parameters: list[float]) -> Callable[[Path], None]:
    return _replaced(CAMERAS, cameras("binary", kind, "", parameters))


def _other_camera(root: Path) -> None:
    (root / CAMERAS).write_bytes(cameras("binary", 1, "", PINHOLE).replace(struct.pack("<I", 7), struct.pack("<I", 6)))


BAD: dict[str, tuple[str, str, Callable[[Path], None]]] = {
    "no photos": ("CAPTURE_COUNT_MISMATCH", IMAGES, _no_photos),
    "turned photos": ("CAPTURE_BAD_INTRINSICS", f"images/{NAMES[0]}", _turned_photos),
    "an empty list": ("CAPTURE_EMPTY", IMAGES, _replaced(IMAGES, struct.pack("<Q", 0))),
    "an empty file": ("CAPTURE_TRUNCATED", IMAGES, _replaced(IMAGES, b"")),
    "2^63 images": ("CAPTURE_TRUNCATED", IMAGES, _replaced(IMAGES, struct.pack("<Q", 2**63) + bytes(500))),
    "2^63 observations": (
        "CAPTURE_TRUNCATED",
        IMAGES,
        _replaced(IMAGES, images("binary", NAMES[:1], POSES[:1], 0)[:-8] + struct.pack("<Q", 2**63)),
    ),
    "2^63 cameras": ("CAPTURE_TRUNCATED", CAMERAS, _replaced(CAMERAS, struct.pack("<Q", 2**63) + bytes(500))),
    "a name without an end": (
        "CAPTURE_UNREADABLE",
        IMAGES,
        _replaced(IMAGES, struct.pack("<Q", 1) + bytes(64) + b"a" * 5000),
    ),
    "a name outside": (
        "CAPTURE_UNREADABLE",
        IMAGES,
        _replaced(IMAGES, images("binary", ["../../secret.jpg"], POSES[:1])),
    ),
    "another camera": ("CAPTURE_UNREADABLE", IMAGES, _other_camera),
    "fisheye": (*BAD_CAMERA, _camera(5, [*PINHOLE, 0, 0, 0, 0])),
    "a rational lens": (*BAD_CAMERA, _camera(6, [*PINHOLE, 0, 0, 0, 0, 0, 0, 0.1, 0])),
    "a model of the future": (*BAD_CAMERA, _camera(99, PINHOLE)),
    "a negative model": (*BAD_CAMERA, _camera(-1, PINHOLE)),
    "focal length 0": (*BAD_CAMERA, _camera(1, [0, 0, CX, CY])),
    "focal length NaN": (*BAD_CAMERA, _camera(1, [np.nan, FY, CX, CY])),
    "infinite distortion": (*BAD_CAMERA, _camera(2, [FX, CX, CY, np.inf])),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_models_are_refused_by_name(tmp_path: Path, what: str) -> None:
    code, file, spoil = BAD[what]
    write(tmp_path)
    spoil(tmp_path)
    error = error_of(tmp_path)
    assert (error.code, error.file) == (code, file)
    assert error.hints


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("7 OPENCV_FISHEYE 640 480 1 2 3 4 5 6 7 8", "CAPTURE_BAD_INTRINSICS"),
        ("7 FULL_OPENCV 640 480 500 500 320 240 0 0 0 0 0 0.1 0 0", "CAPTURE_BAD_INTRINSICS"),
        ("7 FULL_OPENCV 640 480 500 500 320 240 0 0 0 0 0", "CAPTURE_UNREADABLE"),
        ("7 PINHOLE 640 480 500", "CAPTURE_UNREADABLE"),
        ("7 PINHOLE 640 480 500 five 320 240", "CAPTURE_UNREADABLE"),
        ("7 PINHOLE -640 480 500 500 320 240", "CAPTURE_UNREADABLE"),
        ("7 PINHOLE 0 480 500 500 320 240", "CAPTURE_BAD_INTRINSICS"),
        ("7 PINHOLE", "CAPTURE_UNREADABLE"),
    ],
)
def test_bad_lines_are_refused(tmp_path: Path, line: str, code: str) -> None:
    place = write(tmp_path, "text")
    (place / "cameras.txt").write_text(line)
    error = error_of(tmp_path)
    assert (error.code, error.file) == (code, "sparse/0/cameras.txt")


def test_a_fisheye_is_refused_by_its_name(tmp_path: Path) -> None:
    write(tmp_path)
    BAD["fisheye"][2](tmp_path)
    assert "OPENCV_FISHEYE" in error_of(tmp_path).message


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {form: write(tmp_path_factory.mktemp(form), form) for form in FORMS}


@settings(max_examples=80)
@given(form=st.sampled_from(FORMS), file=st.sampled_from(["cameras", "images"]), data=st.data())
def test_broken_bytes_are_an_answer(project: dict[str, Path], form: str, file: str, data: st.DataObject) -> None:
    path = next(project[form].glob(f"{file}.*"))
    sound = path.read_bytes()
    whole = bytearray(sound)
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    result: Any = None
    try:
        result = read(project[form].parents[1]).photos
    except CaptureError as error:
        result = error.code
    finally:
        path.write_bytes(sound)
    assert result


def test_photos_that_the_model_could_not_place_are_named(tmp_path: Path) -> None:
    """Those of its own folder alone: downscaled copies beside it are no photos that somebody misses."""
    write(tmp_path)
    for place in ("images", "images_4"):
        for index in range(5):
            captures.save_jpg(tmp_path / place / f"left {index}.jpg", captures.picture(index))
    capture = read(tmp_path)
    assert len(capture.photos) == len(NAMES)
    names = ", ".join(f"images/left {index}.jpg" for index in range(3))
    said = "because sparse/0/images.bin does not tell their cameras"
    assert capture.warnings == (f"5 photos were not used, {said}: {names}, ...",)
