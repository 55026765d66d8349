"""Detect a file's type by its first bytes (magic number), and by its name only where the bytes do not tell."""

from __future__ import annotations

from enum import Enum
from pathlib import PurePosixPath

from capture2vr.order.raw_photos import is_raw_photo

HEAD_BYTES = 64  # enough for every magic number below


class Kind(Enum):
    """Type of an uploaded file. DATA is checked by the worker only.

    RAW, SIDECAR and UNKNOWN do not belong to a capture. RAW: a raw photo, as cameras write beside a JPEG. A sidecar
    says where, when and by whom other files were made.
    """

    JPEG = "jpeg"
    PNG = "png"
    WEBP = "webp"
    TIFF = "tiff"
    HEIF = "heif"
    EXR = "exr"
    VIDEO = "video"
    MATROSKA = "matroska"
    ARCHIVE = "archive"
    E57 = "e57"
    DATA = "data"
    RAW = "raw"
    SIDECAR = "sidecar"
    UNKNOWN = "unknown"


IMAGES = {Kind.JPEG, Kind.PNG, Kind.WEBP, Kind.TIFF, Kind.HEIF, Kind.EXR}

_MAGIC = (
    (b"\xff\xd8\xff", Kind.JPEG),
    (b"\x89PNG\r\n\x1a\n", Kind.PNG),
    (b"II*\0", Kind.TIFF),
    (b"MM\0*", Kind.TIFF),
    (b"v/1\x01", Kind.EXR),
    (b"\x1aE\xdf\xa3", Kind.MATROSKA),
    (b"ASTM-E57", Kind.E57),
    (b"NGSP", Kind.DATA),  # Gaussian splats of an .spz, whose gzip is undone
    (b"PK\x03\x04", Kind.ARCHIVE),
    (b"PK\x05\x06", Kind.ARCHIVE),
    (b"\x1f\x8b\x08", Kind.ARCHIVE),
    (b"7z\xbc\xaf\x27\x1c", Kind.ARCHIVE),
    (b"Rar!\x1a\x07", Kind.ARCHIVE),
    (b"\xfd7zXZ\x00", Kind.ARCHIVE),
    (b"BZh91AY&SY", Kind.ARCHIVE),
    (b"\x28\xb5\x2f\xfd", Kind.ARCHIVE),
)
_HEIF_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif", b"avis"}
_OLD_MOVIE = {b"moov", b"mdat", b"wide", b"free", b"skip"}  # first boxes of old QuickTime files without `ftyp`
_IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic", ".heif", ".exr"}
_VIDEO_SUFFIXES = {".mp4", ".mov", ".m4v"}
_MATROSKA_SUFFIXES = {".webm", ".mkv"}
# Point clouds and meshes; Record3D's depth and confidence; Android's DEPTH16 and glTF's buffers; arrays; poses,
# intrinsics.
_DATA_SUFFIXES = {".ply", ".pcd", ".xyz", ".pts", ".las", ".laz", ".obj", ".off", ".stl", ".glb", ".gltf", ".mtl"}
_DATA_SUFFIXES |= {
    ".e57",
    ".ptx",
    ".splat",
    ".ksplat",
    ".info",
    ".depth",
    ".conf",
    ".bin",
    ".npy",
    ".json",
    ".csv",
    ".txt",
    ".log",
    ".yaml",
    ".yml",
    ".xml",
    ".md",
}
# Tracks of a way, the subtitles in which drones write theirs, and what programs know about a photo.
_SIDECAR_SUFFIXES = {".gpx", ".kml", ".nmea", ".igc", ".srt", ".vtt", ".xmp", ".aae"}


def sniff(name: str, head: bytes) -> Kind:
    """Return the type of a file. name: its path in the upload; head: its first HEAD_BYTES

    A file with the extension of a raw photo, an image or a video has that type whatever its bytes are: the check of
    that type then reports what is wrong.
    """
    if is_raw_photo(name):
        return Kind.RAW
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return Kind.WEBP
    if head[4:8] == b"ftyp":
        return Kind.HEIF if head[8:12] in _HEIF_BRANDS else Kind.VIDEO
    return Kind.SIDECAR if _is_sidecar(name) else _kind_by_suffix(name, head)


def _kind_by_suffix(name: str, head: bytes) -> Kind:
    """Return the type of a file whose first bytes name none."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix in _VIDEO_SUFFIXES or (head[4:8] in _OLD_MOVIE and suffix not in _DATA_SUFFIXES):
        return Kind.VIDEO
    if suffix in _MATROSKA_SUFFIXES:
        return Kind.MATROSKA
    if suffix in _IMAGE_SUFFIXES:
        return {".exr": Kind.EXR, ".png": Kind.PNG}.get(suffix, Kind.JPEG)
    return Kind.DATA if suffix in _DATA_SUFFIXES or _is_text(head) else Kind.UNKNOWN


def _is_sidecar(name: str) -> bool:
    """Return whether a name is that of a sidecar: also of a JSON named after a picture or a film, as photo services
    export them."""
    *others, suffix = ("", *PurePosixPath(name.lower()).suffixes)
    return suffix in _SIDECAR_SUFFIXES or (
        suffix == ".json" and not (_IMAGE_SUFFIXES | _VIDEO_SUFFIXES | _MATROSKA_SUFFIXES).isdisjoint(others)
    )


def _is_text(head: bytes) -> bool:
    """Return whether the bytes begin a UTF-8 text without control characters: `metadata`, LICENSE, a list of poses."""
    text = head.decode("utf-8", errors="ignore")
    return len(text.encode()) >= len(head) - 3 and all(
        letter.isprintable() or letter in "\r\n\t\ufeff" for letter in text
    )
