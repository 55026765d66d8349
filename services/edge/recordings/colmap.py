"""Read COLMAP sparse models, text or binary: photos with their intrinsics and poses.

Poses are world-to-camera in OpenCV axes, quaternions in the order w, x, y, z. COLMAP's first pixel has its centre at
0.5, ours at 0, so half a pixel is subtracted from cx and cy. The scale of the model is arbitrary.
"""

from __future__ import annotations

import math
import posixpath
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, number_order, numbers, read_text, truncated, unreadable
from capture2vr.edge.capture.frame_records import checked_intrinsics, first_names, missing_warning
from capture2vr.edge.capture.images import read_bytes
from capture2vr.edge.capture.listed_pictures import find_pictures
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.photos import read_photo
from capture2vr.edge.capture.posed_photos import GivenCamera, posed_capture, unlisted_warning, with_camera
from capture2vr.edge.capture.poses import pose_from_quaternion
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_BYTES = 2**30  # of one file of the model; a thousand photos with ten thousand observations each are 240 MB
_NAME_BYTES = 1024  # most bytes of a photo's name in binary files
# Least sizes of entries in binary files: a camera with three parameters, an image with an empty name, an observation.
_CAMERA_BYTES, _IMAGE_BYTES, _OBSERVATION_BYTES = 48, 73, 24
# Camera models by their number in binary files; only those of _PARAMETER_INDICES are supported.
_MODELS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip
# Indices of fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 among a model's parameters; those at the end that it lacks
# are 0. Only models whose k4, k5 and k6 are 0 are read.
_PARAMETER_INDICES: dict[str, tuple[int, ...]] = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4),
    "OPENCV": tuple(range(8)),
    "FULL_OPENCV": tuple(range(12)),
}


@dataclass(frozen=True, slots=True)
class _ColmapCamera:
    intrinsics: Intrinsics
    distortion: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Image:
    """A photo of the model. name: relative to the folder of photos; camera: its number; pose (7,): quaternion in the
    order w, x, y, z, and translation, world to camera."""

    name: str
    camera: int
    pose: Floats


def matches(folder: Folder) -> bool:
    """Return whether the folder has a COLMAP model."""
    return _find_model(folder) is not None


def read(folder: Folder) -> Capture:
    """Read the model's photos that exist, with their cameras. Raises CaptureError, naming the file."""
    model = _find_model(folder)
    assert model is not None, "read() was called although matches() is False"
    cameras_file, images_file = model
    cameras = _cameras(folder, cameras_file)
    images = sorted(_images(folder, images_file), key=lambda image: number_order(image.name))
    if not images:
        raise CaptureError("CAPTURE_EMPTY", say("colmap_model_lists_no_photos"), file=images_file)
    places = find_pictures(folder, [image.name for image in images], by=images_file)
    missing = [image.name for image in images if image.name not in places]
    if not places:
        reason = say("lists_photos_but_capture", count=len(missing), name=first_names(missing[:1]))
        hint = say("send_photos_together_with_model")
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=images_file, hints=(hint,))
    present = [image for image in images if image.name in places]
    tries = [partial(_photo, folder, places[image.name], image, cameras, images_file) for image in present]
    unlisted = unlisted_warning(folder, set(places.values()), images_file)
    return posed_capture("colmap", tries, warnings=(*missing_warning(missing, say("word_photos")), *unlisted))


def _find_model(folder: Folder) -> tuple[str, str] | None:
    """Find the model's files of cameras and of images; of several models the binary one, then the largest."""
    found = []
    for name in folder.names:
        path, end = posixpath.splitext(name)
        images = posixpath.join(posixpath.dirname(path), "images" + end)
        if posixpath.basename(path) == "cameras" and end in (".bin", ".txt") and folder.has(images):
            found.append((end == ".bin", folder.path(images).stat().st_size, name, images))
    return max(found)[2:] if found else None


def _photo(folder: Folder, place: str, image: _Image, cameras: dict[int, _ColmapCamera], file: str) -> Photo:
    """Read the photo at `place` and attach its intrinsics and camera-to-world pose."""
    camera = cameras.get(image.camera)
    if camera is None:
        raise unreadable(file, say("refers_to_camera_but_model", camera=image.camera, place=place))
    world_to_camera = pose_from_quaternion(image.pose[4:], image.pose[[1, 2, 3, 0]])
    pose = np.eye(4)
    pose[:3, :3] = world_to_camera[:3, :3].T
    pose[:3, 3] = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    given = GivenCamera(f"{file} {image.camera}", camera.intrinsics, camera.distortion, pose, "opencv")
    return with_camera(read_photo(folder, place), given)


def _camera(model: str, width: int, height: int, parameters: Floats, file: str) -> _ColmapCamera:
    """Make a camera from COLMAP's model and parameters. Raises CAPTURE_BAD_INTRINSICS and CAPTURE_UNREADABLE."""
    if model not in _PARAMETER_INDICES:
        what = say(
            "has_unsupported_camera_model_supported", model=repr(model[:40]), names=", ".join(_PARAMETER_INDICES)
        )
        raise CaptureError(
            "CAPTURE_BAD_INTRINSICS", what, file=file, hints=(say("undistort_images_with_colmap_first"),)
        )
    places = _PARAMETER_INDICES[model]
    if len(parameters) != max(places) + 1:
        raise unreadable(
            file, say("has_camera_with_parameters_instead", model=model, count=len(parameters), wanted=max(places) + 1)
        )
    fx, fy, cx, cy, *lens = (float(parameters[at]) for at in places)
    if not all(math.isfinite(value) for value in lens):
        raise CaptureError("CAPTURE_BAD_INTRINSICS", say("has_lens_distortion_coefficients"), file=file)
    if any(lens[5:]):
        what = say("has_camera_whose_k4_k5", model=model)
        raise CaptureError(
            "CAPTURE_BAD_INTRINSICS", what, file=file, hints=(say("undistort_images_with_colmap_first"),)
        )
    distortion = (*lens, *[0.0] * 5)[:5]
    return _ColmapCamera(checked_intrinsics(Intrinsics(fx, fy, cx - 0.5, cy - 0.5, width, height), file), distortion)


def _cameras(folder: Folder, file: str) -> dict[int, _ColmapCamera]:
    """Read all cameras of the model: number -> camera."""
    if file.endswith(".txt"):
        return dict(_camera_line(line, file) for line in _lines(folder, file) if line)
    reader = _BinaryReader(_read_model_file(folder, file), file)
    return dict(_camera_record(reader, file) for _ in range(reader.count(_CAMERA_BYTES)))


def _camera_line(line: str, file: str) -> tuple[int, _ColmapCamera]:
    """Parse a line of cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]."""
    number, model, width, height, *parameters = _split_fields(line, 4, None, file)
    sizes = (_whole_number(width, file), _whole_number(height, file))
    return _whole_number(number, file), _camera(
        model, *sizes, numbers(parameters, len(parameters), file=file, what=line), file
    )


def _camera_record(reader: _BinaryReader, file: str) -> tuple[int, _ColmapCamera]:
    """Read one camera of cameras.bin: its number and the camera."""
    number, kind, width, height = reader.take("<IiQQ")
    model = _MODELS[kind] if 0 <= kind < len(_MODELS) else f"number {kind}"
    count = max(_PARAMETER_INDICES.get(model, (-1,))) + 1
    return number, _camera(model, width, height, np.array(reader.take(f"<{count}d")), file)


def _images(folder: Folder, file: str) -> Iterator[_Image]:
    """Read all images of the model, text or binary."""
    if file.endswith(".txt"):
        yield from _text_images(_lines(folder, file), file)
        return
    reader = _BinaryReader(_read_model_file(folder, file), file)
    for _ in range(reader.count(_IMAGE_BYTES)):
        _, *pose, camera = reader.take("<I7dI")
        name = reader.name()
        reader.skip(reader.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
        yield _Image(name, camera, np.array(pose))


def _text_images(lines: list[str], file: str) -> Iterator[_Image]:
    """Parse images.txt: the line of a pose, then one of the image's observations, which may be empty or left out."""
    after_pose = False
    for line in lines:
        if after_pose and not _is_pose_line(line):
            after_pose = False  # the observations, or the empty line that stands for none
        elif line:
            yield _image_line(line, file)
            after_pose = True


def _is_pose_line(line: str) -> bool:
    """Return whether a line has an image's number, seven numbers of its pose, its camera's number, and a name.

    Observations are numbers in threes, which may be whole numbers too.
    """
    words = line.split(None, 9)
    if len(words) < 10 or not (_is_whole(words[0]) and _is_whole(words[8]) and all(map(_is_number, words[1:8]))):
        return False
    name = words[9].split()
    return len(name) % 3 != 0 or not all(map(_is_number, name))


def _image_line(line: str, file: str) -> _Image:
    """Parse a line of images.txt: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME."""
    words = _split_fields(line, 10, 9, file)
    return _Image(words[9], _whole_number(words[8], file), numbers(words[1:8], 7, file=file, what="a pose"))


def _split_fields(line: str, least: int, splits: int | None, file: str) -> list[str]:
    words = line.split(None, -1 if splits is None else splits)
    if len(words) < least:
        raise unreadable(file, say("has_line_fields_where_least", count=len(words), least=least, line=repr(line[:60])))
    return words


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_whole(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) < 10


def _whole_number(word: str, file: str) -> int:
    if not _is_whole(word):
        raise unreadable(file, say("has_where_whole_number_expected", word=repr(word[:40])))
    return int(word)


def _lines(folder: Folder, file: str) -> list[str]:
    """Read the lines of a text file without comments; empty lines stay."""
    lines = (line.strip() for line in read_text(folder.path(file), file).splitlines())
    return [line for line in lines if not line.startswith("#")]


def _read_model_file(folder: Folder, file: str) -> bytes:
    if folder.path(file).stat().st_size > MAX_BYTES:
        reason = say("larger_than_mib_most_read_colmap", size=MAX_BYTES // 2**20)
        raise CaptureError("CAPTURE_TOO_LARGE", reason, file=file)
    return read_bytes(folder.path(file), file)


@dataclass(slots=True)
class _BinaryReader:
    """Reads little-endian values one after the other. Raises CAPTURE_TRUNCATED when the file ends too early."""

    data: bytes
    file: str
    at: int = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        start = self.at
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def skip(self, count: int) -> None:
        if count > len(self.data) - self.at:
            raise truncated(self.file, say("cut_off_in_middle_entry"))
        self.at += count

    def count(self, smallest: int) -> int:
        """Read the number of entries that follow, of at least `smallest` bytes each; raise if the file is too short."""
        (count,) = self.take("<Q")
        if count * smallest > len(self.data) - self.at:
            raise truncated(self.file, say("cut_off_announces_entries", count=count))
        return int(count)

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _NAME_BYTES)
        if end < 0:
            raise unreadable(self.file, say("has_photo_name_does", bytes=_NAME_BYTES))
        start, self.at = self.at, end + 1
        return self.data[start:end].decode("utf-8", errors="replace")
