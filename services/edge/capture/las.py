"""LAS and LAZ through laspy. Georeferenced coordinates are moved near the origin, which keeps their millimetres."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats
from services.edge.capture.colours import rgb8
from services.edge.capture.files import reading, unreadable
from services.edge.capture.nouns import Cloud
from services.edge.capture.tables import MAX_POINTS, too_many, truncated
from services.edge.errors import CaptureError

_CHUNK_BYTES = 64 * 2**20  # of records decoded at a time; a file cut short fails before the whole is allocated
_FAR = 10_000.0  # metres from the origin above which a cloud is georeferenced, not scanned in a room
_HEADER_BYTES = 227  # of LAS 1.2
_VLR_HEADER_BYTES = 54
_MAX_RECORD_BYTES = 1024  # the largest standard point has 67 bytes; the rest is room for extra dimensions
_COMPRESSED = 0x80  # bit of the point format that marks LAZ
_CHILD_BYTES = 6 * 2**30  # of address space; 20 million points take under 2 GiB
_CHILD_SECONDS = 120.0  # 20 million points take about 40 s


def read_las(path: Path, file: str) -> tuple[Cloud, tuple[str, ...]]:
    """The cloud in metres (Z up) and warnings."""
    compressed = _check_header(path, file)
    with reading(file, "LAS"):
        xyz, rgb = _read_in_child(path, file) if compressed else points(path)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    colours = None if rgb is None else rgb8(rgb)
    if not len(finite) or np.abs(finite).max() < _FAR:
        return Cloud(xyz, colours), ()
    origin = np.floor(finite.min(axis=0))
    moved = ", ".join(f"{value:.0f}" for value in origin)
    return Cloud(xyz - origin, colours), (f"{file}: georeferenced; ({moved}) was subtracted from every point",)


def _check_header(path: Path, file: str) -> bool:
    """Whether the points are compressed, after holding every count against the file's size."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(375).ljust(375, b"\0")
    if size < _HEADER_BYTES:
        raise truncated(file, "ends before the LAS header does")
    offset, vlrs, form, record, count = struct.unpack_from("<IIBHI", head, 96)
    if head[24:26] >= b"\x01\x04":
        count = max(count, struct.unpack_from("<Q", head, 247)[0])
        vlrs += struct.unpack_from("<I", head, 243)[0]
    compressed = bool(form & _COMPRESSED)
    if vlrs * _VLR_HEADER_BYTES > size or offset > size:
        raise truncated(file, f"promises {vlrs:,} records before its points and has {size:,} bytes")
    if not compressed and offset + count * record > size:
        raise truncated(file, f"promises {count:,} points of {record} bytes and has {size - offset:,} bytes of them")
    if compressed:
        _check_chunk_table(path, offset, size, file)
    if count > MAX_POINTS:
        raise too_many(count, file)
    if not 20 <= record <= _MAX_RECORD_BYTES:
        raise unreadable(file, f"has points of {record} bytes")
    if count == 0:
        raise CaptureError("CAPTURE_EMPTY", "holds no points", file=file, hints=("export the capture again",))
    return compressed


def _check_chunk_table(path: Path, offset: int, size: int, file: str) -> None:
    """A LAZ states before its points where its chunk table lies, after them; -1 means in its last eight bytes."""
    with path.open("rb") as stream:
        stream.seek(offset)
        (table,) = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))
    if table != -1 and not offset < table <= size - 8:
        raise truncated(file, f"promises a chunk table at byte {table:,} and has {size:,} bytes")


def points(path: Path) -> tuple[Floats, NDArray[Any] | None]:
    """xyz (N,3) float64 and colours (N,3) as stored, or None. Raises what laspy raises."""
    import laspy

    with laspy.open(path) as reader:
        promised = reader.header.point_count
        step = max(1, _CHUNK_BYTES // reader.header.point_format.size)
        chunks = [_columns(chunk) for chunk in reader.chunk_iterator(step)]
    xyz = np.concatenate([chunk[0] for chunk in chunks])
    if len(xyz) != promised:
        raise ValueError(f"{promised:,} points are promised, {len(xyz):,} are there")
    colours = [chunk[1] for chunk in chunks if chunk[1] is not None]
    return xyz, np.concatenate(colours) if colours else None


def _columns(chunk: Any) -> tuple[Floats, NDArray[Any] | None]:
    xyz = np.stack([np.asarray(chunk.x), np.asarray(chunk.y), np.asarray(chunk.z)], axis=1)
    if "red" not in set(chunk.point_format.dimension_names):
        return xyz, None
    return xyz, np.stack([np.asarray(chunk.red), np.asarray(chunk.green), np.asarray(chunk.blue)], axis=1)


def _read_in_child(path: Path, file: str) -> tuple[Floats, NDArray[Any] | None]:
    """Decode a LAZ in a process of its own: the decoder, in Rust, ends the process on a count it cannot allocate."""
    command = [sys.executable, "-m", "services.edge.capture.laz_child", str(path.resolve()), str(_CHILD_BYTES)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_CHILD_SECONDS, check=False)  # noqa: S603 - our own module
    except subprocess.TimeoutExpired:
        raise CaptureError("CAPTURE_TOO_LARGE", f"takes over {_CHILD_SECONDS:.0f} s to decode", file=file) from None
    if done.returncode != 0 or len(done.stdout) < 9:
        raise unreadable(file, "is not a readable LAZ (its compressed points are broken)")
    count, coloured = struct.unpack_from("<Q?", done.stdout)
    xyz = np.frombuffer(done.stdout, np.float64, 3 * count, 9).reshape(count, 3)
    if not coloured:
        return xyz, None
    return xyz, np.frombuffer(done.stdout, np.uint16, 3 * count, 9 + xyz.nbytes).reshape(count, 3)
