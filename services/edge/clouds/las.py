"""Read LAS and LAZ point clouds with laspy; a LAZ in a child process, as its decoder may abort on hostile counts."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.cloud_process import decode_in_child, decode_to_disk, near_origin
from capture2vr.edge.clouds.raw_parts import LARGE, RawPart, RawParts
from capture2vr.edge.clouds.stated_reference import LasUnits, las_units
from capture2vr.edge.clouds.tables import MAX_PARTED_POINTS, MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_CHUNK_BYTES = 64 * 2**20  # of records decoded at a time: a truncated file fails before all points are allocated
_HEADER_BYTES = 227  # of LAS 1.2
_VLR_HEADER_BYTES = 54
_MOST_HEAD = 1 << 20  # bytes in which LASzip's own record is looked for
_LASZIP, _POINT_BY_POINT = b"laszip encoded", b"\x01\x00"  # its user id, and the compressor of before 2011
_MAX_RECORD_BYTES = 1024  # the largest standard point has 67 bytes; the rest is room for extra dimensions
_COMPRESSED = 0x80  # bit of the point format that marks LAZ


def read_las(path: Path, file: str, tick: Tick = no_tick) -> tuple[Cloud, tuple[str, ...]]:
    """Read a LAS or LAZ: the cloud in the unit across (Z up) and warnings. `tick` is called while a LAZ is decoded.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED, CAPTURE_TOO_LARGE and CAPTURE_EMPTY.
    """
    compressed = _check_header(path, file)
    with translate_errors(file, "LAS"):
        xyz, rgb = decode_in_child("LAZ", path, file, tick)[:2] if compressed else decode_points(path)
    return near_origin(_level_units(xyz, las_units(path)), rgb, file)


def las_parts(path: Path, file: str, tick: Tick = no_tick) -> RawParts | None:
    """Read a LAS or LAZ file in parts, in the unit across; None where it has no more than `read_las` reads at once.

    A LAZ is decoded in a child process to the disk, as its decoder may abort. Errors as of `read_las`.
    """
    with translate_errors(file, "LAS"), path.open("rb") as stream:
        count = _point_count(stream.read(375).ljust(375, b"\0"))
    if count <= LARGE:
        return None
    units = las_units(path)
    if _check_header(path, file, MAX_PARTED_POINTS):
        parts = decode_to_disk("LAZ", path, file, count, tick)
        return replace(parts, read=lambda: (replace(part, xyz=_level_units(part.xyz, units)) for part in parts.read()))

    def read() -> Iterator[RawPart]:
        with translate_errors(file, "LAS"):
            for xyz, colours in iter_points(path):
                yield RawPart(_level_units(xyz, units), colours)

    return RawParts(count, read)


def _level_units(xyz: Floats, units: LasUnits | None) -> Floats:
    """Return coordinates (N,3) with the heights in the unit of the others."""
    return xyz if units is None or units.height == units.across else xyz * (1, 1, units.height / units.across)


def _point_count(head: bytes) -> int:
    """Number of points that the first 375 bytes announce."""
    (count,) = struct.unpack_from("<I", head, 107)
    return int(max(count, struct.unpack_from("<Q", head, 247)[0])) if head[24:26] >= b"\x01\x04" else int(count)


def _check_header(path: Path, file: str, most: int = MAX_POINTS) -> bool:
    """Check every count in the header against the file's size; return whether the points are compressed (LAZ)."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(375).ljust(375, b"\0")
    if size < _HEADER_BYTES:
        raise truncated(file, say("cut_off_inside_las_header"))
    offset, vlrs, form, record = struct.unpack_from("<IIBH", head, 96)
    count = _point_count(head)
    if head[24:26] >= b"\x01\x04":
        vlrs += struct.unpack_from("<I", head, 243)[0]
    compressed = bool(form & _COMPRESSED)
    if vlrs * _VLR_HEADER_BYTES > size or offset > size:
        what = say("variable_length_records_then_points", vlrs=vlrs, offset=offset, size=size)
        raise truncated(file, say("cut_off_header_announces", what=what))
    if not compressed and offset + count * record > size:
        what = say("points_bytes_but_only_bytes", count=count, record=record, size=size - offset)
        raise truncated(file, say("cut_off_header_announces", what=what))
    if compressed:
        _check_chunk_table(path, offset, size, file)
    if count > most:
        raise too_many_points(count, file, most)
    if not 20 <= record <= _MAX_RECORD_BYTES:
        raise unreadable(file, say("has_point_records_bytes_20", record=record, most=_MAX_RECORD_BYTES))
    if count == 0:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_points"), file=file, hints=(say("export_capture_again"),))
    return compressed


def _check_chunk_table(path: Path, offset: int, size: int, file: str) -> None:
    """Raise CAPTURE_TRUNCATED when a LAZ ends before its chunk table, CAPTURE_UNREADABLE when it is too old for one.

    The 8 bytes before the points are the offset of the table, which comes after them; -1: it is in the last 8 bytes.
    """
    with path.open("rb") as stream:
        head = stream.read(min(offset, _MOST_HEAD))
        if (at := head.find(_LASZIP)) >= 0 and head[at + _VLR_HEADER_BYTES - 2 :][:2] == _POINT_BY_POINT:
            raise unreadable(file, say("laz_point_by_point"), say("compress_laz_again"))
        stream.seek(offset)
        (table,) = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))
    if table != -1 and not offset < table <= size - 8:
        raise truncated(file, say("cut_off_chunk_table_should", place=table, size=size))


def decode_points(path: Path) -> tuple[Floats, NDArray[Any] | None]:
    """Decode xyz (N,3) float64 and the colours (N,3) as stored, or None. Raises what laspy raises."""
    chunks = list(iter_points(path))
    xyz = np.concatenate([chunk[0] for chunk in chunks])
    colours = [chunk[1] for chunk in chunks if chunk[1] is not None]
    return xyz, np.concatenate(colours) if colours else None


def iter_points(path: Path) -> Iterator[tuple[Floats, NDArray[Any] | None]]:
    """Decode a file part by part: xyz (N,3) float64 and the colours (N,3) as stored, or None. Raises what laspy raises,
    and ValueError where points are missing."""
    import laspy

    with laspy.open(path) as reader:
        announced, found = reader.header.point_count, 0
        for chunk in reader.chunk_iterator(max(1, _CHUNK_BYTES // reader.header.point_format.size)):
            found += len(chunk)
            yield _columns(chunk)
    if found != announced:
        raise ValueError(say("header_announces_points", announced=announced, found=found))


def _columns(chunk: Any) -> tuple[Floats, NDArray[Any] | None]:
    """Return a chunk's points and colours; where these were never filled its intensities, as grey."""
    xyz = np.stack([np.asarray(chunk.x), np.asarray(chunk.y), np.asarray(chunk.z)], axis=1)
    if "red" in set(chunk.point_format.dimension_names):
        colours = np.stack([np.asarray(chunk.red), np.asarray(chunk.green), np.asarray(chunk.blue)], axis=1)
        if colours.any():
            return xyz, colours
    return xyz, np.repeat(np.asarray(chunk.intensity)[:, None], 3, axis=1)
