"""Detect the format of a capture from its content, and read it: `read_capture` is the only entry point."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture import photos, pose_files
from capture2vr.edge.capture.calibration import is_side_table
from capture2vr.edge.capture.doubts import doubts_about
from capture2vr.edge.capture.files import Folder, open_folder, translate_errors, unreadable
from capture2vr.edge.capture.frame_records import first_names
from capture2vr.edge.capture.nouns import MIN_PHOTOS, Capture
from capture2vr.edge.capture.units import in_unit
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.films import film
from capture2vr.edge.recordings import (
    arkitscenes,
    blender,
    colmap,
    depth16,
    kitti,
    nerfstudio,
    polycam,
    record3d,
    record3d_exr,
    replica,
    rtabmap,
    scanner3d,
    sog,
    stray,
    tum,
)
from capture2vr.edge.recordings.scan_files import file_format, read_file
from capture2vr.order.reading import AS_IT_SEEMS, FileReading
from capture2vr.sentences.sentence import say

_FORMATS: tuple[tuple[Callable[[Folder], bool], Callable[[Folder], Capture]], ...] = (
    (sog.matches, sog.read),
    (record3d.matches, record3d.read),
    (record3d_exr.matches, record3d_exr.read),
    (stray.matches, stray.read),
    (polycam.matches, polycam.read),
    (scanner3d.matches, scanner3d.read),
    (nerfstudio.matches, nerfstudio.read),
    (blender.matches, blender.read),
    (colmap.matches, colmap.read),
    (depth16.matches, depth16.read),
    (pose_files.matches, pose_files.read),
    (arkitscenes.matches, arkitscenes.read),
    (replica.matches, replica.read),
    (kitti.matches, kitti.read),
    (rtabmap.matches, rtabmap.read),
    (tum.matches, tum.read),  # last: it accepts any capture with a folder called "depth"
)
_CLOUD_SUFFIXES = (
    ".ply",
    ".pcd",
    ".xyz",
    ".pts",
    ".npy",
    ".las",
    ".laz",
    ".e57",
    ".ptx",
    ".splat",
    ".ksplat",
    ".spz",
    ".obj",
    ".off",
    ".stl",
    ".glb",
    ".gltf",
)
_MESH_SUFFIXES = (".obj", ".off", ".stl", ".glb", ".gltf")
# Of models that are not read, whose folders and archives have textures: these are no photos of the thing.
_UNREAD_MODELS = (".usd", ".usda", ".usdc", ".usdz", ".fbx", ".dae", ".3mf", ".3ds", ".blend", ".skp", ".step", ".stp")
_ARCHIVES = (b"PK\x03\x04", b"Rar!\x1a\x07", b"7z\xbc\xaf\x27\x1c", b"\x1f\x8b\x08", b"\xfd7zXZ", b"BZh")
# Text tables of numbers that belong to a recording; they look like point clouds, and are none.
_SIDE_TABLES = ("odometry.csv", "poses.csv", "imu.csv", "camera_matrix.csv", "groundtruth.txt", "rgb.txt", "depth.txt")
# Where a model names its textures, besides its own first lines; and the folders that programs put them into.
_MATERIALS = (".mtl", ".gltf")
_MATERIAL_BYTES = 4 * 2**20
_BETWEEN_NAMES = re.compile(r"[\s\"'/\\,;:=<>()]")
_SEARCHED = 2**18  # characters in which a name of several words is searched for
_TEXTURES = re.compile("texture|material|maps", re.IGNORECASE)
_FORMATS_HINT = say("send_photos_video_point_cloud")


def read_capture(folder: Path, *, reading: FileReading = AS_IT_SEEMS, tick: Tick = no_tick) -> Capture:
    """Read and check an uploaded capture: an unpacked folder or a single file.

    Poses, intrinsics, counts, image headers and the first and last depth image are checked here; images load lazily.
    `tick` is called while a video is scanned and while a LAZ is decoded; reading: what a person says of the files.
    Raises CaptureError, naming the file, the reason and what to do, and Cancelled when `tick` does.
    """
    # No floating-point warnings for overflow and NaN: the values are checked after reading.
    with np.errstate(all="ignore"), translate_errors(folder.name, "capture"):
        if not folder.exists():
            raise CaptureError("CAPTURE_EMPTY", say("no_such_file_folder"), file=folder.name)
        if folder.is_dir():
            files = _skip_wrapper_folders(replace(open_folder(folder), tick=tick, reading=reading))
            capture = in_unit(_read_folder(files), reading.unit)
        else:
            files = Folder(folder.parent, (folder.name,), tick, reading)
            capture = in_unit(_read_files(files), reading.unit)
        return replace(capture, warnings=(*capture.warnings, *doubts_about(capture, files.names, reading)))


def _skip_wrapper_folders(folder: Folder) -> Folder:
    """Return the innermost folder that contains all files: archives often wrap everything in a single top folder."""
    tops = {name.split("/", 1)[0] for name in folder.names}
    if len(tops) != 1 or any("/" not in name for name in folder.names):
        return folder
    (top,) = tops
    if top in ("depth", "keyframes", "rgbd"):
        return folder
    inner = tuple(name.split("/", 1)[1] for name in folder.names)
    return _skip_wrapper_folders(replace(folder, root=folder.root / top, names=inner))


def _read_folder(folder: Folder) -> Capture:
    if not folder.names:
        raise CaptureError("CAPTURE_EMPTY", say("capture_has_no_files"), hints=(_FORMATS_HINT,))
    for matches, read in _FORMATS:
        if matches(folder):
            capture = read(folder)
            return replace(capture, warnings=(*capture.warnings, *_meshes_beside(folder, capture)))
    return _read_files(folder)


def _meshes_beside(folder: Folder, capture: Capture) -> tuple[str, ...]:
    """Return a warning about the meshes beside the pictures of a recording, by their names alone, if any."""
    meshes = [name for name in folder.names if name.lower().endswith(_MESH_SUFFIXES)]
    if not meshes:
        return ()
    what = say("word_depth_images") if capture.kind == "rgbd" else say("word_photos")
    return (say("meshes_beside_not_used", what=what, names=first_names(meshes)),)


def _read_files(folder: Folder) -> Capture:
    """Read the largest point cloud or mesh among the files; without one, photos or a video."""
    archive = next((name for name in folder.names if record3d.is_archive(folder.path(name))), None)
    if archive is not None:
        return record3d.read_archive(folder.path(archive), archive)
    candidates = [(name, kind) for name in folder.names if (kind := _candidate(folder, name)) is not None]
    if not candidates:
        return _read_pictures(folder)
    candidates.sort(key=lambda found: -folder.path(found[0]).stat().st_size)
    (name, kind), others = candidates[0], [other for other, _ in candidates[1:]]
    capture = read_file(folder, name, kind)
    unused = _unused_photos(folder, name)
    warnings = list(capture.warnings)
    if others:
        warnings.append(say("only_used_other_point_clouds", name=name, count=len(others), names=", ".join(others[:3])))
    warnings += [say("video_beside_not_used", name=name, video=video) for video in film.find_videos(folder)[:1]]
    if unused:
        warnings.append(say("photos_beside_not_used", name=name, count=len(unused), first=unused[0]))
    return replace(capture, warnings=tuple(warnings))


def _unused_photos(folder: Folder, model: str) -> list[str]:
    """Return the photos beside a model that may have been meant to become the mesh; none for the model's textures.

    Textures are named in the model's materials or first lines, or are in a folder of textures; fewer than MIN_PHOTOS
    pictures are no capture.
    """
    if len(pictures := photos.pictures(folder)) < MIN_PHOTOS:
        return []
    texts = [
        _head(folder.path(name), _MATERIAL_BYTES)
        for name in folder.names
        if name == model or name.lower().endswith(_MATERIALS)
    ]
    named = _Named(unquote(b"\n".join(texts).decode("utf-8", "replace")))
    found = [
        name
        for name in pictures
        if posixpath.basename(name) not in named and not _TEXTURES.search(posixpath.dirname(name))
    ]
    return found if len(found) >= MIN_PHOTOS else []


class _Named:
    """Tells the file names that a text has: looked up among its words, as searching it for each of 5,000 takes long.

    A name that is itself several words is searched for in the text's beginning.
    """

    def __init__(self, text: str) -> None:
        self._head = text[:_SEARCHED]
        self._words = frozenset(_BETWEEN_NAMES.split(text))

    def __contains__(self, name: str) -> bool:
        return name in self._words or (_BETWEEN_NAMES.search(name) is not None and name in self._head)


def _read_pictures(folder: Folder) -> Capture:
    """Read the photos, or a video when there are too few photos. Called after clouds: meshes have texture images."""
    videos = film.find_videos(folder)
    model = next((name for name in folder.names if name.lower().endswith(_UNREAD_MODELS)), None)
    if model is not None and not videos and not any(_is_by_camera(folder, name) for name in photos.pictures(folder)):
        hints = (say("export_as_glb_obj_ply"),)
        raise CaptureError("CAPTURE_UNKNOWN_FORMAT", say("model_in_format_not_read"), file=model, hints=hints)
    if videos and len(photos.pictures(folder)) < MIN_PHOTOS:
        return film.read(folder)
    if not photos.matches(folder):
        raise _nothing_readable(folder)
    capture = photos.read(folder)
    return replace(capture, warnings=(*capture.warnings, *film.unused_warning(videos)))


def _is_by_camera(folder: Folder, name: str) -> bool:
    """Return whether a picture tells the focal length that it was taken with."""
    try:
        return photos.read_photo(folder, name).focal_px is not None
    except CaptureError:
        return False


def _candidate(folder: Folder, name: str) -> str | None:
    """Return the point cloud or mesh format of a file, or None when it is neither."""
    if name.rsplit("/", 1)[-1].lower() in _SIDE_TABLES:
        return None
    kind = file_format(folder, name)
    return None if kind == "xyz" and len(folder.names) > 1 and is_side_table(folder, name) else kind


def _nothing_readable(folder: Folder) -> CaptureError:
    """Return the most specific error for a capture without a readable file: empty, mislabelled, archive, unknown."""
    return _all_empty(folder) or _mislabelled_cloud(folder) or _packed(folder) or _unknown(folder)


def _all_empty(folder: Folder) -> CaptureError | None:
    if any(folder.path(name).stat().st_size for name in folder.names):
        return None
    only = _only_file(folder)
    return CaptureError("CAPTURE_EMPTY", say("file_empty") if only else say("all_files_empty"), file=only)


def _mislabelled_cloud(folder: Folder) -> CaptureError | None:
    name = next((name for name in folder.names if name.lower().endswith(_CLOUD_SUFFIXES)), None)
    if name is None:
        return None
    if folder.path(name).stat().st_size == 0:
        return CaptureError("CAPTURE_EMPTY", say("file_empty"), file=name)
    return unreadable(name, say("has_suffix_but_content_another", suffix=Path(name).suffix))


def _packed(folder: Folder) -> CaptureError | None:
    archive = next((name for name in folder.names if _head(folder.path(name)).startswith(_ARCHIVES)), None)
    if archive is None:
        return None
    what, hints = say("archive_archives_not_unpacked_here"), (say("unpack_send_files"),)
    return CaptureError("CAPTURE_UNKNOWN_FORMAT", what, file=archive, hints=hints)


def _unknown(folder: Folder) -> CaptureError:
    only = _only_file(folder)
    what = say("not_in_known_format") if only else say("no_file_capture_in_known")
    return CaptureError("CAPTURE_UNKNOWN_FORMAT", what, file=only, hints=(_FORMATS_HINT,))


def _only_file(folder: Folder) -> str | None:
    return folder.names[0] if len(folder.names) == 1 else None


def _head(path: Path, count: int = 16) -> bytes:
    with path.open("rb") as stream:
        return stream.read(count)
