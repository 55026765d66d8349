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

from capture2vr.edge.arrays import Ints
from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.raw_parts import LARGE, PART, RawPart, RawParts
from capture2vr.edge.clouds.sample_surface import MAX_FACES, too_many_faces
from capture2vr.edge.clouds.tables import MAX_PARTED_POINTS, MAX_POINTS, named_columns, raw_columns, too_many_points
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
_ALIASES = {"diffuse_red": "red", "diffuse_green": "green", "diffuse_blue": "blue"}
_TEXTURE = re.compile(rb"^comment[ \t]+TextureFile[ \t]+(\S[^\r\n]*)", re.MULTILINE)
_SPLAT = ("f_dc_0", "f_dc_1", "f_dc_2")
_HARMONIC = 0.28209479177387814  # the spherical harmonic of degree 0, which is constant: 1 / (2 sqrt(pi))
_LEAST_LOGIT = math.log(0.1 / 0.9)  # of a splat's opacity: under a tenth it is haze, and no surface
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str = ""  # type of a list's length; "" for a scalar


@dataclass(frozen=True, slots=True)
class _PlyElement:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def has_list(self) -> bool:
        return any(item.count_kind for item in self.properties)

    def least_bytes(self, order: str) -> int:
        """Return the least bytes of one record: two per ASCII value (digit, separator), only the count of a list."""
        if not order:
            return 2 * len(self.properties)
        return sum(np.dtype(item.count_kind or item.kind).itemsize for item in self.properties)


def read_ply(path: Path, file: str) -> tuple[Cloud, Ints, tuple[str, ...]]:
    """Read the vertices and the faces (F,3) of a PLY, and warnings; polygons become triangle fans. F = 0 for points.

    Of Gaussian splats the centres are read, with the colour that each has from all sides together.
    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PLY"):
        data = path.read_bytes()
        elements, order, start = _header(data[:_HEADER_BYTES], file)
        splats = _are_splats(elements)
        if order:
            cloud, faces = _read_binary(data, start, elements, order, file)
        else:
            cloud, faces = _read_ascii(data[start:], elements, file)
        if splats:
            return cloud, faces, (_splat_warning(file),)
        texture = _TEXTURE.search(data[:start])
        return cloud, faces, (_texture_warning(texture[1], cloud, file),) if texture and len(faces) else ()


def ply_parts(path: Path, file: str) -> RawParts | None:
    """Read a binary PLY without faces in parts; None for others, and for what `read_ply` reads at once.

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    with translate_errors(file, "PLY"), path.open("rb") as stream:
        elements, order, start = _header(stream.read(_HEADER_BYTES), file)
    first = elements[0] if elements else _PlyElement("", 0, ())
    if not order or first.name != "vertex" or first.has_list or first.count <= LARGE:
        return None
    if any(each.name == "face" and each.count for each in elements):
        return None
    _check_counts(first, path.stat().st_size - start, order, file, MAX_PARTED_POINTS)
    records, splats = _record(first, order, {}), _are_splats(elements)

    def read() -> Iterator[RawPart]:
        for row in range(0, first.count, PART):
            rows = np.fromfile(path, records, min(PART, first.count - row), offset=start + row * records.itemsize)
            columns = {_ALIASES.get(name, name): rows[name] for name in rows.dtype.names or ()}
            yield raw_columns(_splat_centres(columns) if splats else columns, file)

    return RawParts(first.count, read, (_splat_warning(file),) if splats else ())


def _are_splats(elements: list[_PlyElement]) -> bool:
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


def _splat_warning(file: str) -> str:
    what = say("holds_gaussian_splats_centres_those")
    return say("not_on_send_photos_made", file=file, what=what)


def _texture_warning(name: bytes, cloud: Cloud, file: str) -> str:
    """Return the warning that the texture of this name is not read."""
    instead = say("mesh_has_no_colours") if cloud.rgb is None else say("colours_those_vertices")
    texture = name.decode("latin-1").strip()[:120]
    return say("texture_not_read_export_mesh", file=file, texture=repr(texture), instead=instead)


def _header(head: bytes, file: str) -> tuple[list[_PlyElement], str, int]:
    """Parse the header: the elements, the byte order ("" is ASCII), and the offset of the data."""
    end = head.find(b"end_header")
    stop = head.find(b"\n", end) if end >= 0 else -1
    if stop < 0:
        raise truncated(file, say("cut_off_inside_ply_header"))
    order: str | None = None
    elements: list[_PlyElement] = []
    for line in head[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[:1] == ["element"]:
            elements.append(_PlyElement(words[1], int(words[2]), ()))
            _check_header_count("element", len(elements), _MAX_ELEMENTS, file)
        elif words[:1] == ["property"]:
            last = elements[-1]
            _check_header_count("property", len(last.properties) + 1, _MAX_PROPERTIES, file)
            elements[-1] = _PlyElement(last.name, last.count, (*last.properties, _property(words[1:])))
    if order is None or any(element.count < 0 for element in elements):
        raise unreadable(file, say("has_ply_header_without_known"))
    return elements, order, stop + 1


def _check_header_count(word: str, count: int, most: int, file: str) -> None:
    """Raise CAPTURE_TOO_LARGE for more lines of a kind than are read: each costs as much as there are others."""
    if count > most:
        what, hint = say("has_header_with_more_lines", word=word, most=most), say("export_with_fewer_properties")
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(hint,))


def _property(words: list[str]) -> _Property:
    if words[0] == "list":
        return _Property(words[3], _TYPES[words[2]], _TYPES[words[1]])
    return _Property(words[1], _TYPES[words[0]])


def _check_counts(element: _PlyElement, left: int, order: str, file: str, most: int = MAX_POINTS) -> None:
    """Raise CAPTURE_TRUNCATED when an element needs more bytes than are `left`; CAPTURE_TOO_LARGE above `most`."""
    need = element.count * element.least_bytes(order)
    if need > left + 1:  # the last ASCII line may lack its newline
        what = say("records_least_bytes", count=element.count, name=repr(element.name), need=need, left=left)
        raise truncated(file, say("cut_off_header_announces", what=what))
    if element.count > most:
        raise too_many_points(element.count, file, most)


def _read_binary(data: bytes, at: int, elements: list[_PlyElement], order: str, file: str) -> tuple[Cloud, Ints]:
    """Read the elements that start at offset `at`, up to the last of vertices and faces; skip others in between."""
    cloud: Cloud | None = None
    faces: Ints = np.zeros((0, 3), np.int64)
    last = max((place for place, each in enumerate(elements) if each.name in ("vertex", "face")), default=-1)
    for element in elements[: last + 1]:
        _check_counts(element, len(data) - at, order, file)
        if not element.has_list:
            dtype = _record(element, order, {})
            if element.name == "vertex":
                records = np.frombuffer(data, dtype, element.count, at)
                columns = {name: records[name] for name in dtype.names or ()}
                cloud = _cloud(columns, file, splats=_are_splats(elements))
            at += dtype.itemsize * element.count
        else:
            polygons, at = _binary_lists(data, at, element, order, file)
            faces = _triangle_fans(polygons, cloud, file) if element.name == "face" else faces
    if cloud is None:
        raise unreadable(file, say("ply_file_without_vertices"))
    return cloud, faces


def _record(element: _PlyElement, order: str, lengths: dict[str, int]) -> np.dtype[Any]:
    """Return the NumPy record type of an element whose lists have the given lengths; list counts are fields '#name'."""
    fields: list[Any] = []
    for item in element.properties:
        if item.count_kind:
            fields.append((f"#{item.name}", order + item.count_kind))
            fields.append((item.name, order + item.kind, (lengths[item.name],)))
        else:
            fields.append((item.name, order + item.kind))
    return np.dtype(fields)


def _cloud(columns: dict[str, NDArray[Any]], file: str, *, splats: bool) -> Cloud:
    columns = {_ALIASES.get(name, name): values for name, values in columns.items()}
    return named_columns(_splat_centres(columns) if splats else columns, file)


def _binary_lists(data: bytes, at: int, element: _PlyElement, order: str, file: str) -> tuple[list[Ints], int]:
    """Read an element of lists: polygons grouped by their number of corners, each (F,k), and the offset behind it."""
    if element.count == 0:
        return [], at
    first = _one_record(data, at, element, order, file)[1]
    dtype = _record(element, order, {name: len(values) for name, values in first.items()})
    if element.count * dtype.itemsize <= len(data) - at:
        records = np.frombuffer(data, dtype, element.count, at)
        if all((records[f"#{name}"] == len(values)).all() for name, values in first.items()):
            return [records[_corners(element, file)].astype(np.int64)], at + records.nbytes
    return _mixed_lists(data, at, element, order, file)


def _mixed_lists(data: bytes, at: int, element: _PlyElement, order: str, file: str) -> tuple[list[Ints], int]:
    """Read lists of different lengths, one record after the other; returns as `_binary_lists` does."""
    groups: dict[int, list[NDArray[Any]]] = {}
    corners = _corners(element, file)
    for _ in range(element.count):
        at, lists = _one_record(data, at, element, order, file)
        groups.setdefault(len(lists[corners]), []).append(lists[corners])
    return [np.stack(group).astype(np.int64) for group in groups.values()], at


def _one_record(
    data: bytes, at: int, element: _PlyElement, order: str, file: str
) -> tuple[int, dict[str, NDArray[Any]]]:
    """Read one record: the offset behind it, and its lists by name. Raises CAPTURE_TRUNCATED."""
    lists: dict[str, NDArray[Any]] = {}
    for item in element.properties:
        kind, count = np.dtype(order + item.kind), 1
        if item.count_kind:
            count_kind = np.dtype(order + item.count_kind)
            if at + count_kind.itemsize > len(data):
                raise truncated(file, say("cut_off_inside_records", name=repr(element.name)))
            count = int(np.frombuffer(data, count_kind, 1, at)[0])
            at += count_kind.itemsize
        if count < 0 or at + count * kind.itemsize > len(data):
            raise truncated(file, say("cut_off_inside_records", name=repr(element.name)))
        if item.count_kind:
            lists[item.name] = np.frombuffer(data, kind, count, at)
        at += count * kind.itemsize
    return at, lists


def _corners(element: _PlyElement, file: str) -> str:
    """Return the name of the list property with a face's vertex indices."""
    lists = [item.name for item in element.properties if item.count_kind]
    known = [name for name in lists if name in ("vertex_indices", "vertex_index")]
    return (known or lists)[0]


def _triangle_fans(polygons: list[Ints], cloud: Cloud | None, file: str) -> Ints:
    """Triangulate polygons as fans (F,3): (a, b, c, d, ...) becomes (a, b, c), (a, c, d), ..."""
    if (count := sum(len(group) * max(0, group.shape[1] - 2) for group in polygons)) > MAX_FACES:
        raise too_many_faces(count, file)
    triangles: list[Ints] = [np.zeros((0, 3), np.int64)]
    for group in polygons:
        second, third = group[:, 1:-1], group[:, 2:]
        first = np.broadcast_to(group[:, :1], second.shape)
        triangles.append(np.stack([first, second, third], axis=-1).reshape(-1, 3))
    faces = np.concatenate(triangles)
    if cloud is None or (len(faces) and (faces.min() < 0 or faces.max() >= len(cloud.xyz))):
        raise unreadable(file, say("has_faces_with_indices_vertices"))
    return faces


def _read_ascii(body: bytes, elements: list[_PlyElement], file: str) -> tuple[Cloud, Ints]:
    cloud: Cloud | None = None
    faces: Ints = np.zeros((0, 3), np.int64)
    for element in elements:
        _check_counts(element, len(body), "", file)
    lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
    at = 0
    for element in elements:
        rows, at = lines[at : at + element.count], at + element.count
        if len(rows) < element.count:
            what = say("lines_but", count=element.count, name=repr(element.name), found=len(rows))
            raise truncated(file, say("cut_off_header_announces", what=what))
        if element.name == "vertex":
            cloud = _ascii_cloud(rows, element, file, splats=_are_splats(elements))
        elif element.name == "face":
            faces = _triangle_fans(_ascii_lists(rows), cloud, file)
    if cloud is None:
        raise unreadable(file, say("ply_file_without_vertices"))
    return cloud, faces


def _ascii_cloud(rows: list[str], element: _PlyElement, file: str, *, splats: bool) -> Cloud:
    """Parse the vertex lines as float64, exact for all PLY types, then cast them, so that colours keep their range."""
    if element.has_list:
        raise unreadable(file, say("has_vertices_with_list_properties"))
    table = np.loadtxt(rows, np.float64, comments=None, ndmin=2) if rows else np.zeros((0, len(element.properties)))
    if table.shape[1] != len(element.properties):
        what = say("has_numbers_per_vertex_header", count=table.shape[1], announced=len(element.properties))
        raise unreadable(file, what)
    columns = {
        item.name: table[:, at] if item.kind[0] == "f" else table[:, at].astype(item.kind)
        for at, item in enumerate(element.properties)
    }
    return _cloud(columns, file, splats=splats)


def _ascii_lists(rows: list[str]) -> list[Ints]:
    """Parse the lines of faces: polygons grouped by their number of corners, which are the first list of a line."""
    groups: dict[int, list[list[int]]] = {}
    for row in rows:
        fields = row.split()
        count = int(fields[0])
        corners = [int(field) for field in fields[1 : 1 + count]]
        if len(corners) != count:
            raise ValueError(say("face_has_fewer_corners_than"))
        groups.setdefault(count, []).append(corners)
    return [np.array(group, np.int64).reshape(len(group), -1) for group in groups.values()]
