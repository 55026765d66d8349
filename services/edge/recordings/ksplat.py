"""Read the centres of Gaussian splats from a .ksplat, as the viewer GaussianSplats3D packs them.

Format: https://github.com/mkkellogg/GaussianSplats3D (MIT), `SplatBuffer.js`. A header of 4,096 bytes, one of 1,024 for
each section, and the sections: lengths and middles of buckets, then the splats. Packed ones are numbers of 16 bits
around the middle of their bucket. Nothing is allocated before the file is known to have the bytes for it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.files import translate_errors, truncated
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.clouds.ply import LEAST_OPACITY
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings.splat_files import capture_of_splats
from capture2vr.sentences.sentence import say

_HEAD = struct.Struct("<BBxxIIIIH")  # version (two numbers), sections with and without room, splats likewise, packing
_HEAD_BYTES, _SECTION_BYTES = 4096, 1024
# Splats, with room, of a bucket, buckets, side of a bucket, its bytes, steps, bytes, full buckets, others, harmonics.
_SECTION = struct.Struct("<IIIIfHxxIIIIH")
_MOST_SECTIONS = 1_000  # the viewer packs a scene into one, or into one for each file that was joined
_BUCKET_BYTES = 12
_COLOUR_AT = (40, 20, 20)  # byte of a splat at which its colour begins, by the packing; its place is at 0
_HARMONIC_BYTES = (4, 2, 1)
_HARMONICS = (0, 9, 24, 45)
_STEPS = 32_767  # from the middle of a bucket to its side, where a section does not say


@dataclass(frozen=True, slots=True)
class _Section:
    """What the header of a section says.

    start         byte of its buckets
    full, others  buckets of `bucket_size` splats, and behind them those with a length of their own
    steps, step   from the middle of a bucket to its side, and how long one is
    record        type of a splat
    """

    start: int
    count: int
    bucket_size: int
    buckets: int
    full: int
    others: int
    steps: int
    step: float
    record: np.dtype[Any]

    @property
    def size(self) -> int:
        return 4 * self.others + _BUCKET_BYTES * self.buckets + self.count * self.record.itemsize


def read_ksplat(path: Path, file: str) -> Capture:
    """Read the centres and colours of all sections."""
    with translate_errors(file, ".ksplat"), path.open("rb") as stream:
        sections = list(_sections(stream, path.stat().st_size, file))
        found = [_splats(stream, section, file) for section in sections]
        xyz = np.concatenate([places for places, _ in found])
        rgba = np.concatenate([colours for _, colours in found])
    return capture_of_splats("ksplat", file, xyz, rgba[:, :3], rgba[:, 3] >= LEAST_OPACITY * 255)


def _sections(stream: IO[bytes], size: int, file: str) -> Iterator[_Section]:
    """Yield the sections, each of which is wholly in a file of `size` bytes."""
    head = stream.read(_HEAD_BYTES)
    if len(head) < _HEAD_BYTES:
        raise truncated(file, say("cut_off_inside_header"))
    major, minor, most, *_, packing = _HEAD.unpack_from(head)
    if (major, minor) != (0, 1) or packing >= len(_COLOUR_AT) or not 0 < most <= _MOST_SECTIONS:
        hint = say("export_splats_as_ply")
        what = say("ksplat_of_version", version=f"{major}.{minor}", packing=packing)
        raise CaptureError("CAPTURE_UNREADABLE", what, file=file, hints=(hint,))
    heads, start, count = stream.read(_SECTION_BYTES * most), _HEAD_BYTES + _SECTION_BYTES * most, 0
    if len(heads) < _SECTION_BYTES * most:
        raise truncated(file, say("cut_off_inside_header"))
    for number in range(most):
        section = _section(heads[_SECTION_BYTES * number :], start, packing)
        start, count = start + section.size, count + section.count
        if count > MAX_POINTS:
            raise too_many_points(count, file)
        if start > size or section.full + section.others > section.buckets:
            what = say("splats_least_bytes", count=count, need=start, left=size)
            raise truncated(file, say("cut_off_header_announces", what=what))
        yield section


def _section(head: bytes, start: int, packing: int) -> _Section:
    _, count, bucket_size, buckets, side, bucket_bytes, steps, _, full, others, degree = _SECTION.unpack_from(head)
    if not packing:
        buckets = full = others = 0
    elif bucket_bytes != _BUCKET_BYTES:
        raise ValueError(f"its buckets have {bucket_bytes} bytes")
    record = np.dtype(
        {
            "names": ["xyz", "rgba"],
            "formats": [("<u2" if packing else "<f4", 3), ("u1", 4)],
            "offsets": [0, _COLOUR_AT[packing]],
            "itemsize": _COLOUR_AT[packing] + 4 + _HARMONIC_BYTES[packing] * _HARMONICS[degree],
        }
    )
    steps = steps or _STEPS
    return _Section(start, count, bucket_size, buckets, full, others, steps, side / 2 / steps, record)


def _splats(stream: IO[bytes], section: _Section, file: str) -> tuple[Floats, Bytes]:
    """Return the places (N,3) and the colours with opacity (N,4) of a section."""
    stream.seek(section.start)
    lengths = np.fromfile(stream, "<u4", section.others).astype(np.int64)
    middles = np.fromfile(stream, "<f4", 3 * section.buckets).reshape(-1, 3)
    # A map, as only the places and colours are to be in memory: harmonics may be ten times as much.
    empty = np.zeros(0, section.record)
    splats = np.memmap(stream, section.record, "r", stream.tell(), section.count) if section.count else empty
    rgba = np.array(splats["rgba"])
    if not section.buckets:
        return splats["xyz"].astype(np.float64), rgba
    ends = np.cumsum(np.concatenate([np.full(section.full, section.bucket_size, np.int64), lengths]))
    bucket = np.searchsorted(ends, np.arange(section.count), side="right")
    if section.count and bucket[-1] >= len(ends):
        what = say("has_boxes_for_fewer_splats", count=len(ends), splats=section.count, least=len(ends) + 1)
        raise truncated(file, what)
    steps = splats["xyz"].astype(np.float64) - section.steps
    return steps * section.step + middles[bucket], rgba
