"""Read Record3D's `.r3d`: a zip (or its unpacked folder) of `metadata` and `rgbd/N.{jpg,depth,conf}`.

depth is LZFSE(float32 metres) of dh x dw, conf LZFSE(uint8 0 ... 2), K column-major for the colour image of w x h.
Poses are camera-to-world in OpenGL axes, relative to frame 0; multiplied by `initPose` they are in ARKit's world, Y
against gravity. Phones without a depth sensor write no .depth.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.depth import zero_invalid_depth
from capture2vr.edge.capture.files import MAX_FILES, Folder, number, numbers, parse_json, translate_errors, unreadable
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    check_mostly_paired,
    matrix_pinhole,
    pinhole,
    rgbd_capture,
)
from capture2vr.edge.capture.images import broken_image, check_pixels, decode_rgb, header_size, read_bytes
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.picture import PhotoPixels
from capture2vr.edge.capture.posed_photos import posed_capture, with_app_camera
from capture2vr.edge.capture.poses import checked_pose, pose_from_quaternion
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_METADATA = "metadata"
_MAX_ENTRY_BYTES = 64 * 2**20  # of one file in the zip, unpacked; a phone's picture or depth image has a few MiB
_LOCAL_HEADER = struct.Struct("<4s22x2H")  # of an entry of a zip: magic, lengths of name and extra (APPNOTE 4.3.7)
_UP_Y = np.array([0.0, 1.0, 0.0])


class _RecordingFiles(Protocol):
    """Files of a recording, in a folder or in a zip."""

    @property
    def names(self) -> tuple[str, ...]: ...

    def read(self, name: str) -> bytes: ...


@dataclass(frozen=True, slots=True)
class _Unpacked:
    """Files of a recording in a folder."""

    folder: Folder

    @property
    def names(self) -> tuple[str, ...]:
        return self.folder.names

    def read(self, name: str) -> bytes:
        return read_bytes(self.folder.path(name), name)


@dataclass(frozen=True, slots=True)
class _Archive:
    """Files of a recording in a zip, read one by one in memory; files above _MAX_ENTRY_BYTES are refused.

    Its list of files is read once: with ten thousand frames, reading it for each would take half an hour.
    """

    path: Path
    entries: Mapping[str, zipfile.ZipInfo]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.entries)

    def read(self, name: str) -> bytes:
        with translate_errors(name, "entry of the .r3d"):
            entry = self.entries[name]
            if entry.file_size > _MAX_ENTRY_BYTES:
                reason = say("unpacks_to_bytes_most_read", found=entry.file_size, most=_MAX_ENTRY_BYTES)
                raise CaptureError("CAPTURE_TOO_LARGE", reason, file=name)
            plain = _unpacked(self.path, entry)
            if zlib.crc32(plain) != entry.CRC:
                raise zipfile.BadZipFile("its checksum is wrong")
            return plain


def _unpacked(path: Path, entry: zipfile.ZipInfo) -> bytes:
    """Read a zip's entry, at most _MAX_ENTRY_BYTES of it; the file is opened anew, as other processes read it too."""
    with path.open("rb") as stream:
        stream.seek(entry.header_offset)
        head = stream.read(_LOCAL_HEADER.size)
        magic, name_bytes, extra_bytes = _LOCAL_HEADER.unpack(head)
        if magic != b"PK\x03\x04" or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise zipfile.BadZipFile("its header is wrong")
        stream.seek(name_bytes + extra_bytes, 1)
        packed = stream.read(min(entry.compress_size, 2 * _MAX_ENTRY_BYTES))
    if entry.compress_type == zipfile.ZIP_STORED:
        return packed[:_MAX_ENTRY_BYTES]
    return zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed, _MAX_ENTRY_BYTES)


def matches(folder: Folder) -> bool:
    """Return whether the folder is an unpacked .r3d."""
    return folder.has(_METADATA) and folder.has_folder("rgbd")


def read(folder: Folder) -> Capture:
    """Read an unpacked .r3d. Raises CaptureError, naming the file."""
    return _read(_Unpacked(folder))


def is_archive(path: Path) -> bool:
    """Return whether a file is a zip with Record3D's `metadata` at its top level."""
    with path.open("rb") as stream:
        if stream.read(4) != b"PK\x03\x04":
            return False
    try:
        with zipfile.ZipFile(path) as archive:
            return _METADATA in archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, RuntimeError):
        return False


def read_archive(path: Path, file: str) -> Capture:
    """Read a .r3d. Raises CaptureError, naming the file."""
    with translate_errors(file, ".r3d"), zipfile.ZipFile(path) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
    if len(entries) > MAX_FILES:
        what = say("has_files_most_read", count=len(entries), most=MAX_FILES)
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file)
    return _read(_Archive(path, entries))


def _read(files: _RecordingFiles) -> Capture:
    """Read a recording: RGB-D frames, or posed photos without depth."""
    meta = parse_json(files.read(_METADATA).decode("utf-8", "replace"), _METADATA)
    poses = poses_of(meta, _METADATA)
    depths, pictures = _numbered(files, ".depth"), _numbered(files, ".jpg")
    numbered, of = (depths, say("word_depth_images")) if depths else (pictures, say("word_pictures"))
    posed = sorted(index for index in numbered if index < len(poses))
    warnings = check_mostly_paired(len(posed), len(numbered), len(poses), file=_METADATA, what=say("word_poses"), of=of)
    cameras = cameras_of(meta, len(poses), _METADATA)
    up = up_of(meta)
    if not depths:
        tries = [partial(_photo, files, pictures[index], cameras[index], poses[index]) for index in posed]
        return posed_capture("record3d", tries, scale="metric", up=up, warnings=warnings)
    size = _image_side(meta, "dw", _METADATA), _image_side(meta, "dh", _METADATA)
    check_pixels(size, _METADATA)
    names = frozenset(files.names)
    records = [_record(files, names, index, numbered[index], cameras[index], poses[index], size) for index in posed]
    return rgbd_capture("record3d", records, axes="opengl", up=up, file="rgbd", warnings=warnings)


def _numbered(files: _RecordingFiles, suffix: str) -> dict[int, str]:
    """Return frame number -> file name, for the files in `rgbd` with this suffix."""
    stems = {name[5 : -len(suffix)]: name for name in files.names if name.startswith("rgbd/") and name.endswith(suffix)}
    return {int(stem): name for stem, name in stems.items() if stem.isascii() and stem.isdigit() and len(stem) < 9}


def _photo(files: _RecordingFiles, name: str, camera: Intrinsics, pose: Floats) -> Photo:
    """Make a posed photo from a frame's JPEG. Raises IMAGE_UNREADABLE."""
    size = header_size(files.read(name))
    if size is None:
        raise broken_image(name, say("not_jpeg_image"))
    pixels = PhotoPixels(partial(files.read, name), name, "opencv", check_pixels(size, name), 0)
    return with_app_camera(Photo(name, size, "", pixels), camera, pose, "opengl")


def _record(
    files: _RecordingFiles,
    names: frozenset[str],
    index: int,
    depth: str,
    camera: Intrinsics,
    pose: Floats,
    size: tuple[int, int],
) -> FrameRecord:
    confidence, colour = f"rgbd/{index}.conf", f"rgbd/{index}.jpg"
    load_confidence = partial(_confidence, files, confidence, size) if confidence in names else None
    rgb = _Jpeg(files, colour, (camera.width, camera.height)) if colour in names else None
    return FrameRecord(depth, camera, pose, LzfseDepth(files, depth, size), load_confidence, rgb)


def poses_of(meta: Mapping[str, Any], file: str) -> list[Floats]:
    """Return the camera-to-world poses (4,4) in OpenGL axes; in ARKit's world when `initPose` is given."""
    listed = meta.get("poses")
    if not isinstance(listed, list) or not listed:
        hint = say("export_as_r3d")
        raise CaptureError("CAPTURE_NO_POSES", say("has_no_camera_poses"), file=file, hints=(hint,))
    start: Floats = np.eye(4)
    if "initPose" in meta:
        start = checked_pose(_pose(meta["initPose"], "initPose", file), axes="opencv", file=file)
    return [start @ _pose(words, f"pose {index}", file) for index, words in enumerate(listed)]


def up_of(meta: Mapping[str, Any]) -> Floats | None:
    """Return which way is up in the world of the poses, where `initPose` tells it."""
    return _UP_Y if "initPose" in meta else None


def _pose(words: object, what: str, file: str) -> Floats:
    vector = numbers(words, 7, file=file, what=what)
    return pose_from_quaternion(vector[4:], vector[:4])


def cameras_of(meta: Mapping[str, Any], count: int, file: str) -> list[Intrinsics]:
    """Return the intrinsics of each frame for the colour image's size.

    From `perFrameIntrinsicCoeffs` (fx, fy, cx, cy), or else from K, the same for all frames.
    """
    width, height = _image_side(meta, "w", file), _image_side(meta, "h", file)
    each = meta.get("perFrameIntrinsicCoeffs")
    if isinstance(each, list) and len(each) == count:
        rows = [numbers(row, 4, file=file, what="perFrameIntrinsicCoeffs") for row in each]
        return [pinhole(row, (width, height)) for row in rows]
    k = numbers(meta.get("K"), 9, file=file, what="K").reshape(3, 3).T
    return [matrix_pinhole(k, (width, height))] * count


def _image_side(meta: Mapping[str, Any], key: str, file: str) -> int:
    """Return an image side in pixels. Raises CAPTURE_UNREADABLE."""
    value = number(meta, key, file=file)
    if not 1 <= value <= 1e6:
        raise unreadable(file, say("has_not_size_image", key=key, value=value))
    return int(value)


def _lzfse(data: bytes, size: int, file: str) -> bytes:
    """Decompress LZFSE data to exactly `size` bytes; data of this size are uncompressed. Raises IMAGE_UNREADABLE."""
    import lzfse

    if len(data) > 2 * size + 4096:  # compression never doubles the size: such data are broken or hostile
        raise broken_image(file, say("has_bytes_too_many_image", count=len(data), size=size))
    try:
        plain: bytes = data if len(data) == size else lzfse.decompress(data)
    except (lzfse.error, MemoryError) as error:
        raise broken_image(file, say("cannot_be_decompressed_as_lzfse", why=error)) from None
    if len(plain) != size:
        raise broken_image(file, say("unpacks_to_bytes_expected_size", found=len(plain), size=size))
    return plain


@dataclass(frozen=True, slots=True)
class LzfseDepth:
    """Depth image: LZFSE-compressed float32 metres, of `shape` = (width, height) from the metadata."""

    files: _RecordingFiles
    file: str
    shape: tuple[int, int]

    def size(self) -> tuple[int, int]:
        return self.shape

    def load(self) -> Floats:
        width, height = self.shape
        plain = _lzfse(self.files.read(self.file), width * height * 4, self.file)
        return zero_invalid_depth(np.frombuffer(plain, "<f4").reshape(height, width))


def _confidence(files: _RecordingFiles, file: str, size: tuple[int, int]) -> Floats:
    """Read a confidence image (H,W): ARKit's levels 0, 1, 2 become 0, 0.5, 1."""
    plain = _lzfse(files.read(file), size[0] * size[1], file)
    levels = np.frombuffer(plain, np.uint8).reshape(size[1], size[0])
    confidence: Floats = np.clip(levels.astype(np.float32) / np.float32(2), 0, 1)
    return confidence


@dataclass(frozen=True, slots=True)
class _Jpeg:
    """Colour image of a frame, of `shape` = (width, height) from the metadata."""

    files: _RecordingFiles
    file: str
    shape: tuple[int, int]

    def size(self) -> tuple[int, int]:
        return self.shape

    def load(self) -> Bytes:
        return decode_rgb(self.files.read(self.file), self.file)
