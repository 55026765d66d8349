"""Read Stanford PLY files, ASCII and binary of both byte orders: vertices, and faces if there are any.

Every count in the header is checked against the file's size before anything is allocated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Ints, pick
from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.colours import read_colours, rgb8
from capture2vr.edge.clouds.ply_records import (
    PlyElement,
    Property,
    Records,
    ascii_records,
    binary_records,
    triangles_of,
)
from capture2vr.edge.clouds.raw_parts import LARGE, PART, RawPart, RawParts
from capture2vr.edge.clouds.tables import (
    MAX_PARTED_POINTS,
    MAX_POINTS,
    RGB,
    first_present,
    named_columns,
    raw_columns,
    too_many_points,
)
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_HEADER_BYTES = 2**20  # limit of a header with its comments; real ones have a few hundred bytes
_MAX_ELEMENTS, _MAX_PROPERTIES = 100, 1_000  # of a header; real ones have two elements, and splats 62 properties
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_END = re.compile(rb"^[ \t]*+end_header[^\n]*+\n", re.MULTILINE)  # of the header: in a remark the words are none
_TEXTURE = re.compile(rb"^comment[ \t]+TextureFile[ \t]+(\S[^\r\n]*)", re.MULTILINE)
_SPLAT = ("f_dc_0", "f_dc_1", "f_dc_2")
_HARMONIC = 0.28209479177387814  # the spherical harmonic of degree 0, which is constant: 1 / (2 sqrt(pi))
LEAST_OPACITY = 0.1  # of a splat: below it is haze, and no surface
_LEAST_LOGIT = math.log(LEAST_OPACITY / (1 - LEAST_OPACITY))
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class PlyFile:
    """What a PLY has: vertices, faces (F,3), colours of the faces (F,3) uint8 or None, and warnings."""

    cloud: Cloud
    faces: Ints
    face_rgb: Bytes | None = None
    warnings: tuple[str, ...] = ()


def read_ply(path: Path, file: str) -> PlyFile:
    """Read a PLY; polygons become triangles, and without faces it has points.

    Of Gaussian splats the centres are read, with the colour that each has from all sides together.
    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PLY"):
        data = path.read_bytes()
        elements, order, start = _header(data[:_HEADER_BYTES], file)
        splats = _are_splats(elements)
        read = _read_binary(data, start, elements, order, file) if order else _read_ascii(data[start:], elements, file)
        if "vertex" not in read:
            raise unreadable(file, say("ply_file_without_vertices"))
        columns = read["vertex"].columns
        cloud = named_columns(_splat_centres(columns) if splats else columns, file)
        of_faces = read.get("face", Records({}, []))
        faces, record = triangles_of(of_faces.polygons, cloud.xyz, file)
    if splats:
        return PlyFile(cloud, faces, None, (splat_warning(file),))
    texture = _TEXTURE.search(data[:start])
    rgb = first_present(of_faces.columns, RGB)
    painted, _ = read_colours(rgb) if cloud.rgb is None else (None, ())
    warnings = (_texture_warning(texture[1], cloud, file),) if texture and len(faces) else ()
    return PlyFile(cloud, faces, pick(painted, record), warnings)


def read_columns(path: Path, file: str) -> dict[str, dict[str, NDArray[Any]]]:
    """Read the scalars of a binary PLY's elements up to its vertices: by the names of elements and of properties.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PLY"):
        data = path.read_bytes()
        elements, order, start = _header(data[:_HEADER_BYTES], file)
        read = _read_binary(data, start, elements, order, file) if order else {}
        return {name: records.columns for name, records in read.items()}


def ply_parts(path: Path, file: str) -> RawParts | None:
    """Read a binary PLY without faces in parts; None for others, and for what `read_ply` reads at once.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PLY"), path.open("rb") as stream:
        elements, order, start = _header(stream.read(_HEADER_BYTES), file)
    first = elements[0] if elements else PlyElement("", 0, ())
    if not order or first.name != "vertex" or first.has_list or first.count <= LARGE:
        return None
    if any(each.name == "face" and each.count for each in elements):
        return None
    _check_counts(first, path.stat().st_size - start, order, file, MAX_PARTED_POINTS)
    records, splats = first.record(order, {}), _are_splats(elements)

    def read() -> Iterator[RawPart]:
        for row in range(0, first.count, PART):
            rows = np.fromfile(path, records, min(PART, first.count - row), offset=start + row * records.itemsize)
            columns = {name: rows[name] for name in rows.dtype.names or ()}
            yield raw_columns(_splat_centres(columns) if splats else columns, file)

    return RawParts(first.count, read, (splat_warning(file),) if splats else ())


def _are_splats(elements: list[PlyElement]) -> bool:
    """Return whether the vertices are Gaussian splats, as programs that train them write them: without faces."""
    names = {item.name for each in elements if each.name == "vertex" for item in each.properties}
    return names.issuperset(_SPLAT) and not any(each.name == "face" and each.count for each in elements)


def _splat_centres(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return positions and colours of Gaussian splats, without those that can hardly be seen.

    Their opacity is stored before the sigmoid, and their colour as the factor of a spherical harmonic; their normals
    are zeros (Kerbl et al. 2023, as their program writes them).
    """
    seen = columns["opacity"] >= _LEAST_LOGIT if "opacity" in columns else slice(None)
    rgb = (rgb8(0.5 + _HARMONIC * columns[name][seen].astype(np.float64), 255.0) for name in _SPLAT)
    return {axis: columns[axis][seen] for axis in "xyz" if axis in columns} | dict(
        zip(("red", "green", "blue"), rgb, strict=True)
    )


def splat_warning(file: str) -> str:
    """Return the warning that a file's splats are read as points."""
    what = say("holds_gaussian_splats_centres_those")
    return say("not_on_send_photos_made", file=file, what=what)


def _texture_warning(name: bytes, cloud: Cloud, file: str) -> str:
    """Return the warning that the texture of this name is not read."""
    instead = say("mesh_has_no_colours") if cloud.rgb is None else say("colours_those_vertices")
    texture = name.decode("latin-1").strip()[:120]
    return say("texture_not_read_export_mesh", file=file, texture=repr(texture), instead=instead)


def _header(head: bytes, file: str) -> tuple[list[PlyElement], str, int]:
    """Parse the header: the elements, the byte order ("" is ASCII), and the offset of the data."""
    end = _END.search(head)
    if end is None:
        raise truncated(file, say("cut_off_inside_ply_header"))
    order: str | None = None
    elements: list[PlyElement] = []
    for line in head[: end.start()].decode("latin-1").split("\n")[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[:1] == ["element"]:
            elements.append(PlyElement(words[1].lower(), int(words[2]), ()))
            _check_header_count("element", len(elements), _MAX_ELEMENTS, file)
        elif words[:1] == ["property"]:
            last = elements[-1]
            _check_header_count("property", len(last.properties) + 1, _MAX_PROPERTIES, file)
            elements[-1] = PlyElement(last.name, last.count, (*last.properties, _property(words[1:])))
    if order is None or any(element.count < 0 for element in elements):
        raise unreadable(file, say("has_ply_header_without_known"))
    return elements, order, end.end()


def _check_header_count(word: str, count: int, most: int, file: str) -> None:
    """Raise CAPTURE_TOO_LARGE for more lines of a kind than are read: each costs as much as there are others."""
    if count > most:
        what, hint = say("has_header_with_more_lines", word=word, most=most), say("export_with_fewer_properties")
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(hint,))


def _property(words: list[str]) -> Property:
    if words[0] == "list":
        return Property(words[3].lower(), _TYPES[words[2]], _TYPES[words[1]])
    return Property(words[1].lower(), _TYPES[words[0]])


def _check_counts(element: PlyElement, left: int, order: str, file: str, most: int = MAX_POINTS) -> None:
    """Raise CAPTURE_TRUNCATED when an element needs more bytes than are `left`; CAPTURE_TOO_LARGE above `most`."""
    need = element.count * element.least_bytes(order)
    if need > left + 1:  # the last ASCII line may lack its newline
        what = say("records_least_bytes", count=element.count, name=repr(element.name), need=need, left=left)
        raise truncated(file, say("cut_off_header_announces", what=what))
    if element.count > most:
        raise too_many_points(element.count, file, most)


def _read_binary(data: bytes, at: int, elements: list[PlyElement], order: str, file: str) -> dict[str, Records]:
    """Read the elements that start at offset `at`, up to the last of vertices and faces."""
    read: dict[str, Records] = {}
    last = max((place for place, each in enumerate(elements) if each.name in ("vertex", "face")), default=-1)
    for element in elements[: last + 1]:
        _check_counts(element, len(data) - at, order, file)
        read[element.name], at = binary_records(data, at, element, order, file)
    return read


def _read_ascii(body: bytes, elements: list[PlyElement], file: str) -> dict[str, Records]:
    """Read the vertices and faces, each record of which has a line."""
    read: dict[str, Records] = {}
    for element in elements:
        _check_counts(element, len(body), "", file)
    lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
    at = 0
    for element in elements:
        rows, at = lines[at : at + element.count], at + element.count
        if len(rows) < element.count:
            what = say("lines_but", count=element.count, name=repr(element.name), found=len(rows))
            raise truncated(file, say("cut_off_header_announces", what=what))
        if element.name in ("vertex", "face"):
            read[element.name] = ascii_records(rows, element, file)
    return read
