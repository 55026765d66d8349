"""Read the centres of Gaussian splats from the files in which programs pack them: .splat, .spz, SuperSplat's .ply.

Each splat that can be seen is a point, with the colour that it has from all sides together, as of a trainer's PLY.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.clouds.cloud import capture_of_cloud
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.ply import LEAST_OPACITY, read_columns, splat_warning
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.splats.spz import COLOUR_GAIN, whole_numbers
from capture2vr.sentences.sentence import say

SPZ_MAGIC = b"NGSP"
_SPZ_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, splats, degree of the harmonics, bits, flags, nothing
_SPZ_HALVES, _SPZ_STREAMS = 1, 4  # versions whose places are halves, and whose properties are streams of Zstandard
_SPZ_POSITION_BYTES = {1: 6, 2: 9, 3: 9, 4: 9}  # of a splat, by the version: halves, then numbers of 24 bits
# Further bytes of a splat: opacity, colour, logarithms of scales, rotation (4 bytes from version 3 on), and harmonics.
_SPZ_BYTES = {1: 1 + 3 + 3 + 3, 2: 1 + 3 + 3 + 3, 3: 1 + 3 + 3 + 4}
_SPZ_HARMONICS = (0, 3, 8, 15, 24)
_SPZ_STREAM = struct.Struct("<QQ")  # bytes of a stream, packed and not
_ZSTANDARD = 50_000  # compression of a TIFF
_SPZ_MOST_PACKED = 1024  # bytes of splats for a byte of the file: no scene is packed so well

_SPLAT = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
_WIDEST = 1e5  # standard deviation of a splat; a larger one is none
_MOST_BAD = 0.1  # share of a .splat that may be no splats

_CHUNK = 256  # splats that share a box
_POSITION_BITS = ((21, 11), (11, 10), (0, 11))  # where x, y and z begin in a packed position, and their bits
_COLOUR_SHIFTS = (24, 16, 8)  # where red, green and blue begin in a packed colour; opacity is the last byte
_PACKED = "packed_position"


def is_packed_ply(head: bytes) -> bool:
    """Return whether the first bytes of a PLY announce packed splats, as SuperSplat and PlayCanvas write them."""
    header = head.partition(b"end_header")[0]
    return b"element chunk" in header and _PACKED.encode() in header


def read_packed_ply(path: Path, file: str) -> Capture:
    """Read the centres of a PLY of packed splats: positions as shares of the box of each 256 of them."""
    columns = read_columns(path, file)
    with translate_errors(file, "PLY"):
        boxes, splats = columns["chunk"], columns["vertex"]
        box = np.arange(len(splats[_PACKED])) // _CHUNK
        count = len(boxes["min_x"])
        if len(box) and box[-1] >= count:
            raise truncated(
                file, say("has_boxes_for_fewer_splats", count=count, splats=len(box), least=int(box[-1]) + 1)
            )
        position, colour = splats[_PACKED].astype(np.uint32), splats["packed_color"].astype(np.uint32)
        shares = [_share(position, at, bits) for at, bits in _POSITION_BITS]
        xyz = np.stack([_between(boxes, axis, box, share) for axis, share in zip("xyz", shares, strict=True)], axis=1)
        tints = [_share(colour, at, 8) for at in _COLOUR_SHIFTS]
        if "min_r" in boxes:
            tints = [_between(boxes, name, box, share) for name, share in zip("rgb", tints, strict=True)]
        return capture_of_splats(
            "ply", file, xyz, rgb8(np.stack(tints, axis=1), 255.0), _share(colour, 0, 8) >= LEAST_OPACITY
        )


def _share(packed: NDArray[np.uint32], at: int, bits: int) -> Floats:
    """Return the bits of packed numbers (N,) from `at` on, as shares 0 to 1."""
    top = (1 << bits) - 1
    return (packed >> np.uint32(at) & np.uint32(top)).astype(np.float64) / top


def _between(boxes: dict[str, NDArray[Any]], name: str, box: NDArray[Any], share: Floats) -> Floats:
    """Return the values (N,) that are a share of the way from the least to the greatest of each one's box."""
    low, high = (boxes[f"{end}_{name}"].astype(np.float64)[box] for end in ("min", "max"))
    between: Floats = low + share * (high - low)
    return between


def read_splat(path: Path, file: str) -> Capture:
    """Read the centres of a .splat: records of 32 bytes without a header."""
    size = path.stat().st_size
    if size % _SPLAT.itemsize:
        raise truncated(file, say("has_no_whole_number_of_splats", size=size, each=_SPLAT.itemsize))
    if size // _SPLAT.itemsize > MAX_POINTS:
        raise too_many_points(size // _SPLAT.itemsize, file)
    with translate_errors(file, ".splat"):
        splats = np.fromfile(path, _SPLAT)
    wrong = ~((splats["scale"] >= 0) & (splats["scale"] < _WIDEST)).all(axis=1)
    if wrong.sum() > _MOST_BAD * len(splats):
        raise unreadable(file, say("has_splats_of_impossible_size", bad=int(wrong.sum()), count=len(splats)))
    kept, rgba = splats["xyz"].astype(np.float64), splats["rgba"]
    return capture_of_splats("splat", file, kept, rgba[:, :3], ~wrong & (rgba[:, 3] >= LEAST_OPACITY * 255))


def read_spz(path: Path, file: str) -> Capture:
    """Read the centres of an .spz whose gzip is undone. Its counts are checked before anything is allocated."""
    size = path.stat().st_size
    with translate_errors(file, ".spz"), path.open("rb") as stream:
        head = stream.read(_SPZ_HEADER.size)
        if len(head) < _SPZ_HEADER.size:
            raise truncated(file, say("cut_off_inside_header"))
        _, version, count, degree, bits, _, streams = _SPZ_HEADER.unpack(head)
        if version not in _SPZ_POSITION_BYTES or degree >= len(_SPZ_HARMONICS) or bits > 24:
            hint = say("export_splats_as_ply")
            raise CaptureError("CAPTURE_UNREADABLE", say("spz_of_version", version=version), file=file, hints=(hint,))
        if count > MAX_POINTS:
            raise too_many_points(count, file)
        wanted = _SPZ_POSITION_BYTES[version] * count, count, 3 * count
        if version == _SPZ_STREAMS:
            places, opacity, colour = _spz_streams(stream, size, streams, wanted, file)
        else:
            each = _SPZ_POSITION_BYTES[version] + _SPZ_BYTES[version] + 3 * _SPZ_HARMONICS[degree]
            _check_spz_size(count, count * each, size - _SPZ_HEADER.size, file)
            places, opacity, colour = (np.fromfile(stream, np.uint8, number) for number in wanted)
    xyz = places.view("<f2").astype(np.float64) if version == _SPZ_HALVES else whole_numbers(places) / float(1 << bits)
    rgb = rgb8((colour.reshape(-1, 3) / 255 - 0.5) / COLOUR_GAIN + 0.5, 255.0)
    return capture_of_splats("spz", file, xyz.reshape(-1, 3), rgb, opacity >= LEAST_OPACITY * 255)


def _check_spz_size(count: int, need: int, left: int, file: str) -> None:
    if left < need:
        what = say("splats_least_bytes", count=count, need=need, left=left)
        raise truncated(file, say("cut_off_header_announces", what=what))


def _spz_streams(stream: IO[bytes], size: int, streams: int, wanted: Sequence[int], file: str) -> list[Bytes]:
    """Unpack the first streams of an .spz of version 4, of as many bytes as are wanted: behind a list of all sizes."""
    (start,) = struct.unpack("<I", stream.read(4))
    stream.seek(start)
    sizes = [_SPZ_STREAM.unpack(stream.read(_SPZ_STREAM.size)) for _ in range(streams)]
    _check_spz_size(wanted[1], sum(packed for packed, _ in sizes), size - stream.tell(), file)
    _check_spz_size(wanted[1], sum(wanted) // _SPZ_MOST_PACKED, size, file)
    if [plain for _, plain in sizes[: len(wanted)]] != list(wanted):
        raise unreadable(file, say("spz_of_other_sizes"))
    return [_unpacked(stream.read(packed), plain) for packed, plain in sizes[: len(wanted)]]


def _unpacked(packed: bytes, size: int) -> Bytes:
    """Undo Zstandard, which Python itself knows from 3.14 on: as the pixels of a TIFF, which Pillow decodes.

    Pillow limits the pixels, so there are three bytes in each where that comes out even.
    """
    from PIL import Image

    across, start = (3 if size % 3 == 0 else 1), 16
    longs = {256: size // across, 257: 1, 259: _ZSTANDARD, 262: 2 if across == 3 else 1}
    longs |= {273: start, 277: across, 278: 1, 279: len(packed)}
    fields = [(tag, 4, 1, value) for tag, value in longs.items()]
    fields.append((258, 3, across, 8))  # bits: of one byte 8, of three what stands at byte 8
    listed = b"".join(struct.pack("<HHII", *field) for field in sorted(fields))
    end = start + len(packed) + len(packed) % 2
    head = struct.pack("<4sIHHHxx", b"II*\0", end, 8, 8, 8)
    tiff = (head, packed, bytes(len(packed) % 2), struct.pack("<H", len(fields)), listed, bytes(4))
    with Image.open(BytesIO(b"".join(tiff)), formats=("TIFF",)) as image:
        return np.asarray(image).reshape(-1)


def capture_of_splats(kind: str, file: str, xyz: Floats, rgb: Bytes, seen: Bools) -> Capture:
    """Return the capture of the splats that can be seen: places (N,3), colours (N,3), and which of them."""
    return capture_of_cloud(Cloud(xyz, rgb).subset(seen), file, kind, (splat_warning(file),))
