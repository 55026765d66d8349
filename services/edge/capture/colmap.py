"""COLMAP's sparse models: photos with their cameras, as text or binary.

Poses are world-to-camera in OpenCV axes, quaternions in the order w, x, y, z. Its first pixel has its centre at 0.5,
ours at 0: cx and cy lose half a pixel. The scale is the model's own.
"""

from __future__ import annotations

import math
import posixpath
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.files import Folder, number_order, numbers, read_text, unreadable
from services.edge.capture.images import read_bytes
from services.edge.capture.nouns import Capture, Intrinsics, Photo
from services.edge.capture.photos import read_photo
from services.edge.capture.posed import GivenCamera, posed, posed_capture
from services.edge.capture.poses import pose_from_quaternion
from services.edge.capture.shots import checked_intrinsics, missing_warning
from services.edge.capture.tables import truncated
from services.edge.errors import CaptureError

MAX_BYTES = 2**30  # of a file of the model; a thousand photos with ten thousand observations each are 240 MB
_NAME_BYTES = 1024  # in which a photo's name must end
# Of the smallest entries in binary files: a camera of three parameters, an image of no name, an observation.
_CAMERA_BYTES, _IMAGE_BYTES, _OBSERVATION_BYTES = 48, 73, 24
# By number, as the binary files have them; all but the first five bend rays in ways that are not read.
_MODELS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip
# Where fx, fy, cx, cy and then k1, k2, p1, p2 stand among the parameters; -1 for a coefficient that is 0.
_PLACES = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, -1, -1, -1, -1),
    "PINHOLE": (0, 1, 2, 3, -1, -1, -1, -1),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3, -1, -1, -1),
    "RADIAL": (0, 0, 1, 2, 3, 4, -1, -1),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
}


@dataclass(frozen=True, slots=True)
class _Camera:
    intrinsics: Intrinsics
    distortion: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Image:
    """name: below the folder of the photos; pose (7,) quaternion w, x, y, z and translation, world to camera."""

    name: str
    camera: int
    pose: Floats


def matches(folder: Folder) -> bool:
    return _model(folder) is not None


def read(folder: Folder) -> Capture:
    """The photos of the model that are there, posed. Raises CaptureError, naming the file."""
    model = _model(folder)
    assert model is not None, "asked for without a match"
    cameras_file, images_file = model
    cameras = _cameras(folder, cameras_file)
    images = sorted(_images(folder, images_file), key=lambda image: number_order(image.name))
    if not images:
        raise CaptureError("CAPTURE_EMPTY", "lists no photos", file=images_file)
    places = _places(folder, images, images_file)
    missing = [image.name for image in images if image.name not in places]
    if not places:
        reason = f"none of its {len(missing)} photos is there; the first is {missing[0]}"
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=images_file, hints=("send the photos too",))
    there = [image for image in images if image.name in places]
    tries = [partial(_photo, folder, places[image.name], image, cameras, images_file) for image in there]
    return posed_capture("colmap", tries, warnings=missing_warning(missing, "photos"))


def _model(folder: Folder) -> tuple[str, str] | None:
    """The names of the files of cameras and of images; of several models, those of the one with the most in it."""
    found = []
    for name in folder.names:
        path, end = posixpath.splitext(name)
        images = posixpath.join(posixpath.dirname(path), "images" + end)
        if posixpath.basename(path) == "cameras" and end in (".bin", ".txt") and folder.has(images):
            found.append((end == ".bin", folder.path(images).stat().st_size, name, images))
    return max(found)[2:] if found else None


def _places(folder: Folder, images: Sequence[_Image], file: str) -> dict[str, str]:
    """Photo's name in the model -> its file: below whichever folder has most of them, the shortest of equals, since
    smaller copies lie in folders like `images_4`."""
    names = [folder.inside(image.name, by=file) for image in images]
    known = set(names)
    counts: dict[str, int] = {}
    for name in folder.names:
        parts = name.split("/")
        for depth in range(len(parts)):
            if "/".join(parts[depth:]) in known:
                below = "/".join(parts[:depth])
                counts[below] = counts.get(below, 0) + 1
    if not counts:
        return {}
    below = min(counts, key=lambda top: (-counts[top], len(top)))
    places = {image.name: posixpath.join(below, name) for image, name in zip(images, names, strict=True)}
    return {name: place for name, place in places.items() if folder.has(place)}


def _photo(folder: Folder, place: str, image: _Image, cameras: dict[int, _Camera], file: str) -> Photo:
    camera = cameras.get(image.camera)
    if camera is None:
        raise unreadable(file, f"gives {place} camera {image.camera}, which is not there")
    world_to_camera = pose_from_quaternion(image.pose[4:], image.pose[[1, 2, 3, 0]])
    pose = np.eye(4)
    pose[:3, :3] = world_to_camera[:3, :3].T
    pose[:3, 3] = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    given = GivenCamera(f"{file} {image.camera}", camera.intrinsics, camera.distortion, pose, "opencv")
    return posed(read_photo(folder, place), given)


def _camera(model: str, width: int, height: int, parameters: Floats, file: str) -> _Camera:
    if model not in _PLACES:
        what = f"has the camera model {model[:40]!r}; {', '.join(_PLACES)} are read"
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=file, hints=("undistort the images with COLMAP first",))
    places = _PLACES[model]
    if len(parameters) != max(places) + 1:
        raise unreadable(file, f"has a {model} camera of {len(parameters)} parameters")
    fx, fy, cx, cy, *lens = (float(parameters[at]) if at >= 0 else 0.0 for at in places)
    if not all(math.isfinite(value) for value in lens):
        raise CaptureError("CAPTURE_BAD_INTRINSICS", "has a lens distortion that is not finite", file=file)
    return _Camera(checked_intrinsics(Intrinsics(fx, fy, cx - 0.5, cy - 0.5, width, height), file), (*lens, 0.0))


def _cameras(folder: Folder, file: str) -> dict[int, _Camera]:
    if file.endswith(".txt"):
        return dict(_camera_line(line, file) for line in _lines(folder, file) if line)
    reader = _Reader(_bytes(folder, file), file)
    return dict(_camera_record(reader, file) for _ in range(reader.count(_CAMERA_BYTES)))


def _camera_line(line: str, file: str) -> tuple[int, _Camera]:
    """CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"""
    number, model, width, height, *parameters = _words(line, 4, None, file)
    sizes = (_whole(width, file), _whole(height, file))
    return _whole(number, file), _camera(
        model, *sizes, numbers(parameters, len(parameters), file=file, what=line), file
    )


def _camera_record(reader: _Reader, file: str) -> tuple[int, _Camera]:
    number, kind, width, height = reader.take("<IiQQ")
    model = _MODELS[kind] if 0 <= kind < len(_MODELS) else f"number {kind}"
    count = max(_PLACES.get(model, (-1,))) + 1
    return number, _camera(model, width, height, np.array(reader.take(f"<{count}d")), file)


def _images(folder: Folder, file: str) -> Iterator[_Image]:
    if file.endswith(".txt"):
        # Every second line lists the observations, and is empty where there are none.
        yield from (_image_line(line, file) for line in _lines(folder, file)[::2] if line)
        return
    reader = _Reader(_bytes(folder, file), file)
    for _ in range(reader.count(_IMAGE_BYTES)):
        _, *pose, camera = reader.take("<I7dI")
        name = reader.name()
        reader.skip(reader.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
        yield _Image(name, camera, np.array(pose))


def _image_line(line: str, file: str) -> _Image:
    """IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"""
    words = _words(line, 10, 9, file)
    return _Image(words[9], _whole(words[8], file), numbers(words[1:8], 7, file=file, what="a pose"))


def _words(line: str, least: int, splits: int | None, file: str) -> list[str]:
    words = line.split(None, -1 if splits is None else splits)
    if len(words) < least:
        raise unreadable(file, f"has a line of {len(words)} words where at least {least} belong: {line[:60]!r}")
    return words


def _whole(word: str, file: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) < 10):
        raise unreadable(file, f"has {word[:40]!r} where a whole number belongs")
    return int(word)


def _lines(folder: Folder, file: str) -> list[str]:
    lines = (line.strip() for line in read_text(folder.path(file), file).splitlines())
    return [line for line in lines if not line.startswith("#")]


def _bytes(folder: Folder, file: str) -> bytes:
    if folder.path(file).stat().st_size > MAX_BYTES:
        raise CaptureError("CAPTURE_TOO_LARGE", f"is over {MAX_BYTES // 2**20} MiB", file=file)
    return read_bytes(folder.path(file), file)


@dataclass(slots=True)
class _Reader:
    """Little-endian values one after the other. Raises CAPTURE_TRUNCATED where the file ends before what it says."""

    data: bytes
    file: str
    at: int = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        start = self.at
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def skip(self, count: int) -> None:
        if count > len(self.data) - self.at:
            raise truncated(self.file, "ends in the middle of an entry")
        self.at += count

    def count(self, smallest: int) -> int:
        """How many entries of at least `smallest` bytes follow; more than the file can hold are not believed."""
        (count,) = self.take("<Q")
        if count * smallest > len(self.data) - self.at:
            raise truncated(self.file, f"says that {count:,} entries follow, which it is too short for")
        return int(count)

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _NAME_BYTES)
        if end < 0:
            raise unreadable(self.file, "has a photo's name without an end")
        start, self.at = self.at, end + 1
        return self.data[start:end].decode("utf-8", errors="replace")
