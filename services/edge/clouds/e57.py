"""Read E57 files (ASTM E2807): the scans of a laser scanner, each placed by its own pose, in metres.

A file is a header of 48 bytes, binary sections, and an XML section that describes them; every page of 1,024 bytes ends
with a checksum of 4. pye57 decodes the points.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.sax.saxutils import unescape

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.capture.files import truncated, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.cloud_process import decode_in_child, decode_to_disk, near_origin
from capture2vr.edge.clouds.raw_parts import LARGE, RawParts
from capture2vr.edge.clouds.tables import MAX_PARTED_POINTS, MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAGIC = b"ASTM-E57"
_HEADER = struct.Struct("<8s2I4Q")  # magic, version, length of the file, offset and length of the XML, page size
_PAGE, _PAYLOAD = 1024, 1020  # bytes of a page, with and without its checksum
_MAX_XML = 64 * 2**20  # bytes; a thousand scans take one
# Of as many characters as are kept of such a text, and some blanks.
_METADATA = re.compile(rb"<coordinateMetadata\b[^<>]*+>\s*+(?:<!\[CDATA\[(.{0,9999}?)\]\]>|([^<]{0,9999}+))", re.DOTALL)
_AXES = ("cartesianX", "cartesianY", "cartesianZ")
_CHANNELS = ("colorRed", "colorGreen", "colorBlue")


def read_e57(path: Path, file: str, tick: Tick = no_tick) -> tuple[Cloud, tuple[str, ...]]:
    """Read all scans of an E57 into one cloud, and warnings. `tick` is called meanwhile.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED, CAPTURE_TOO_LARGE and CAPTURE_EMPTY.
    """
    if find_spec("pye57") is None:
        raise unreadable(file, say("e57_machine_cannot_read"), say("export_scan_as_las_laz"))
    count = sum(_record_counts(path, file))
    if count > MAX_POINTS:
        raise too_many_points(count, file)
    if not count:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_points"), file=file, hints=(say("export_capture_again"),))
    xyz, colours, warnings = decode_in_child("E57", path, file, tick)
    cloud, moved = near_origin(xyz, colours, file)
    return cloud, (*warnings, *moved)


def e57_parts(path: Path, file: str, tick: Tick = no_tick) -> RawParts | None:
    """Read all scans of an E57 in parts; None where they have no more points than `read_e57` reads at once."""
    count = sum(_record_counts(path, file)) if find_spec("pye57") else 0
    if count <= LARGE:
        return None
    if count > MAX_PARTED_POINTS:
        raise too_many_points(count, file, MAX_PARTED_POINTS)
    return decode_to_disk("E57", path, file, count, tick)


def e57_metadata(path: Path, file: str) -> str:
    """Return the coordinate reference system of an E57, as well-known text; "" where it has none. Raises as `read_e57`
    does for a damaged file. What comes through a gateway has none: it removes what tells a place."""
    found = _METADATA.search(_xml(path, file))
    if found is None:
        return ""
    text = (found[1] or found[2] or b"").decode("utf-8", "replace")
    return text if found[1] else unescape(text, {"&quot;": '"'})


def _record_counts(path: Path, file: str) -> list[int]:
    """Return the number of points of each scan."""
    tags = re.findall(rb"<points\b[^<>]*+", _xml(path, file))
    counts = (re.search(rb"\brecordCount\s*=\s*[\"'](\d{1,18})[\"']", tag) for tag in tags)
    return [int(count[1]) for count in counts if count is not None]


def _xml(path: Path, file: str) -> bytes:
    """Return the XML of an E57, after checking the header against the file's size."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEADER.size)
        if len(head) < _HEADER.size:
            raise truncated(file, say("cut_off_inside_e57_header"))
        _, _, _, length, offset, xml_length, page = _HEADER.unpack(head)
        if length > size:
            raise truncated(file, say("cut_off_header_announces_bytes", length=length, size=size))
        if page != _PAGE or offset >= length or xml_length > min(length, _MAX_XML):
            raise unreadable(file, say("has_e57_header_contradicts_file"))
        first = offset - offset % _PAGE
        stream.seek(first)
        pages = stream.read((xml_length // _PAYLOAD + 2) * _PAGE)
    payload = b"".join(pages[at : at + _PAYLOAD] for at in range(0, len(pages), _PAGE))
    return payload[offset % _PAGE :][:xml_length]


def iter_points(path: Path) -> Iterator[tuple[Floats, NDArray[Any] | None]]:
    """Decode scan by scan: xyz (N,3) float64 in the file's frame, and colours (N,3) uint8 or None.

    Where no scan has colours these are the intensities, as grey of 16 bits. Raises what pye57 raises.
    """
    import pye57

    with pye57.E57(str(path)) as reader:
        headers = [reader.get_header(number) for number in range(reader.scan_count)]
        any_coloured = any(set(_CHANNELS) <= {*header.point_fields} for header in headers)
        for number, header in enumerate(headers):
            scan = _read_scan(reader, number)
            colours = None if any_coloured else _grey(scan.get("intensity"), header)
            if set(_CHANNELS) <= scan.keys():
                colours = np.stack([scan[channel] for channel in _CHANNELS], axis=1)
            yield np.stack([scan[axis] for axis in _AXES], axis=1), colours


def _grey(intensity: NDArray[Any] | None, header: Any) -> NDArray[Any] | None:
    """Return a scan's intensities (N,) as grey (N,3) of 16 bits, in the range that its `intensityLimits` name, else in
    their own; None where it has none."""
    if intensity is None or not len(intensity):
        return None
    names = "intensityMinimum", "intensityMaximum"
    low, high = float(intensity.min()), float(intensity.max())
    if header.node.isDefined("intensityLimits") and all(map(header["intensityLimits"].isDefined, names)):
        low, high = (float(header["intensityLimits"][name].value()) for name in names)
    shades = np.clip((intensity - low) / (high - low), 0, 1) if high > low else np.zeros(len(intensity))
    return np.repeat(np.rint(65535 * shades)[:, None], 3, axis=1).astype(np.uint16)


def _read_scan(reader: Any, number: int) -> dict[str, NDArray[Any]]:
    """Read one scan's valid points, moved by its pose, with colours of 0 to 255 where it has any."""
    from pye57 import e57

    limits = _colour_limits(reader.get_header(number))
    if limits is None:
        return dict(reader.read_scan(number, intensity=True, ignore_missing_fields=True))
    usual = {channel: e57.SUPPORTED_POINT_FIELDS[channel] for channel in _CHANNELS}
    wide = any((low, high) != (0, 255) for low, high in limits)
    try:
        e57.SUPPORTED_POINT_FIELDS |= dict.fromkeys(_CHANNELS, "d") if wide else {}  # pye57 reads bytes alone
        scan = dict(reader.read_scan(number, colors=True, ignore_missing_fields=True))
    finally:
        e57.SUPPORTED_POINT_FIELDS |= usual
    for channel, (low, high) in zip(_CHANNELS, limits, strict=True):
        if wide:
            scan[channel] = np.clip(np.rint((scan[channel] - low) * (255 / (high - low))), 0, 255).astype(np.uint8)
    return scan


def _colour_limits(header: Any) -> list[tuple[float, float]] | None:
    """Return the least and the greatest value that each colour of a scan can have, by its `colorLimits` (ASTM E2807),
    else by the type of its numbers; None where it has no colours."""
    from pye57.libe57 import IntegerNode, StructureNode

    if not set(_CHANNELS) <= {*header.point_fields}:
        return None
    known = []
    for channel in _CHANNELS:
        names = f"{channel}Minimum", f"{channel}Maximum"
        if header.node.isDefined("colorLimits") and all(map(header["colorLimits"].isDefined, names)):
            low, high = (float(header["colorLimits"][name].value()) for name in names)
        else:
            field = StructureNode(header.points.prototype())[channel]
            low, high = (float(field.minimum()), float(field.maximum())) if isinstance(field, IntegerNode) else (0, 1)
        known.append((low, high) if high > low else (0.0, 255.0))
    return known
