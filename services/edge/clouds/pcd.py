"""Read point clouds in PCL's .pcd format: ASCII, binary, and binary_compressed (LZF, column by column)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.colours import read_colours, unpack_rgb
from capture2vr.edge.clouds.tables import MAX_POINTS, named_columns, too_many_points
from capture2vr.sentences.sentence import say

_HEADER_BYTES = 2**16
_LZF_MAX_RATIO = 100  # decompressed over compressed size: three bytes of LZF make at most 264


@dataclass(frozen=True, slots=True)
class _Header:
    fields: tuple[str, ...]
    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    organised: bool
    storage: str
    start: int

    def record(self) -> np.dtype[Any]:
        """Return the NumPy record type of one point. Padding fields, all called "_", get unique names."""
        columns = zip(self.fields, self.kinds, self.counts, strict=True)
        return np.dtype([(_name(i, name), kind, (count,)) for i, (name, kind, count) in enumerate(columns)])


def _name(index: int, name: str) -> str:
    return f"_{index}" if name == "_" else name.lower()


def read_pcd(path: Path, file: str) -> Cloud:
    """Read the cloud. Empty pixels of an organised cloud, which the format marks by NaN, are left out.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PCD"):
        data = path.read_bytes()
        header = _header(data[:_HEADER_BYTES], file)
        if header.points > MAX_POINTS and len(data) > MAX_POINTS:
            raise too_many_points(header.points, file)
        columns = _READERS[header.storage](data[header.start :], header, file)
    cloud = _with_colours(columns, file)
    if not header.organised:
        return cloud
    return cloud.subset(np.asarray(np.isfinite(cloud.xyz).all(axis=1)))


def _entries(head: bytes, file: str) -> tuple[dict[str, list[str]], int]:
    """Return the header's lines by their first words, up to the line DATA, and where the data begin."""
    at, entries = 0, dict[str, list[str]]()
    while "DATA" not in entries:
        stop = head.find(b"\n", at)
        if stop < 0:
            raise truncated(file, say("cut_off_inside_pcd_header"))
        words = head[at:stop].decode("latin-1").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        at = stop + 1
    return entries, at


def _header(head: bytes, file: str) -> _Header:
    """Parse the header, up to the line DATA."""
    entries, at = _entries(head, file)
    fields = entries.get("FIELDS") or entries.get("COLUMNS") or []
    sizes = entries.get("SIZE", [])
    kinds = tuple("<" + kind.lower() + size for kind, size in zip(entries.get("TYPE", []), sizes, strict=True))
    counts = tuple(int(count) for count in entries.get("COUNT", ["1"] * len(fields)))
    width, height = int(entries["WIDTH"][0]), int(entries.get("HEIGHT", ["1"])[0])
    points = int(entries.get("POINTS", [str(width * height)])[0])
    storage = entries["DATA"][0].lower()
    sound = 0 < len(fields) == len(kinds) == len(counts) <= 256 and all(0 < count <= 4096 for count in counts)
    if not sound or points < 0 or storage not in _READERS:
        raise unreadable(file, say("has_invalid_pcd_header_fields"))
    return _Header(tuple(fields), kinds, counts, points, height > 1, storage, at)


def _read_ascii(body: bytes, header: _Header, file: str) -> dict[str, NDArray[Any]]:
    if header.points * 2 * sum(header.counts) > len(body) + 1:
        what = say("points_but_only_bytes_text", points=header.points, bytes=len(body))
        raise truncated(file, say("cut_off_header_announces", what=what))
    lines = [line for line in body.decode("latin-1").splitlines() if line.strip()][: header.points]
    if len(lines) < header.points:
        raise truncated(file, _announced(header, len(lines)))
    table = np.loadtxt(lines, np.float64, comments=None, ndmin=2) if lines else np.zeros((0, sum(header.counts)))
    starts = np.cumsum((0, *header.counts))[:-1]
    columns: dict[str, NDArray[Any]] = {}
    for index, (name, kind, start) in enumerate(zip(header.fields, header.kinds, starts, strict=True)):
        values = table[:, start]
        whole = "f" in kind or np.isfinite(values).all()  # an integer cannot hold the NaN of an empty pixel
        columns[_name(index, name)] = values.astype(kind) if whole else values
    return columns


def _read_binary(body: bytes, header: _Header, file: str) -> dict[str, NDArray[Any]]:
    dtype = header.record()
    if header.points * dtype.itemsize > len(body):
        raise truncated(file, _announced(header, len(body) // dtype.itemsize))
    records = np.frombuffer(body, dtype, header.points)
    return {name: records[name][:, 0] for name in dtype.names or ()}


def _read_compressed(body: bytes, header: _Header, file: str) -> dict[str, NDArray[Any]]:
    dtype = header.record()
    packed, size = struct.unpack_from("<II", body) if len(body) >= 8 else (len(body), 0)
    if packed > len(body) - 8:
        what = say("bytes_compressed_points_announced", packed=packed, found=max(0, len(body) - 8))
        raise truncated(file, say("cut_off", what=what))
    if size != header.points * dtype.itemsize or size > _LZF_MAX_RATIO * packed:
        raise unreadable(file, say("has_compressed_points_whose_size"))
    plain = lzf_decompress(body[8 : 8 + packed], size)
    columns: dict[str, NDArray[Any]] = {}
    at = 0
    for index, (name, kind, count) in enumerate(zip(header.fields, header.kinds, header.counts, strict=True)):
        values = np.frombuffer(plain, kind, header.points * count, at)
        columns[_name(index, name)] = values.reshape(header.points, count)[:, 0]
        at += values.nbytes
    return columns


def _announced(header: _Header, count: int) -> str:
    return say("cut_off_header_announces_points", points=header.points, count=count)


_READERS = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}


def lzf_decompress(data: bytes, size: int) -> bytes:
    """Decompress LZF (LibLZF, Marc Lehmann) to exactly `size` bytes; raise ValueError if the data make another number.

    A control byte below 32 starts a run of literals; the others copy bytes from the output so far.
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length, high = (control >> 5) + 2, (control & 31) << 8
        if length == 9:
            length += data[at]
            at += 1
        start = len(out) - high - data[at] - 1
        at += 1
        if start < 0:
            raise ValueError(say("lzf_back_reference_points_before"))
        _copy(out, start, length)
    if len(out) != size:
        raise ValueError(say("lzf_data_decompress_to_bytes", found=len(out), size=size))
    return bytes(out)


def _copy(out: bytearray, start: int, length: int) -> None:
    """Append `length` bytes from `start`, which may run into the bytes being appended (a repeating pattern)."""
    gap = len(out) - start
    if gap >= length:
        out += out[start : start + length]
    else:
        out += (bytes(out[start:]) * (length // gap + 1))[:length]


def _with_colours(columns: dict[str, NDArray[Any]], file: str) -> Cloud:
    """Make the cloud, unpacking colours from the field "rgb" or "rgba": PCL stores them as the bits of one number."""
    packed = next((columns.pop(name) for name in ("rgb", "rgba") if name in columns), None)
    cloud = named_columns(columns, file)
    if packed is None or packed.dtype.itemsize != 4:
        return cloud
    rgb, notes = read_colours(unpack_rgb(np.ascontiguousarray(packed).view(np.uint32)))
    return cloud if rgb is None else Cloud(cloud.xyz, rgb, cloud.normals, notes)
