"""Stanford PLY, ASCII and binary of both byte orders: vertices, and faces where it has them.

Every count in the header is held against the bytes that are there before anything is allocated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Ints
from services.edge.capture.files import reading, unreadable
from services.edge.capture.nouns import Cloud
from services.edge.capture.tables import MAX_POINTS, named_columns, too_many, truncated

_HEADER_BYTES = 2**20  # comments included; real headers have a few hundred bytes
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ALIASES = {"diffuse_red": "red", "diffuse_green": "green", "diffuse_blue": "blue"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str = ""  # set for lists


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def has_list(self) -> bool:
        return any(item.count_kind for item in self.properties)

    def smallest(self, order: str) -> int:
        """Bytes that one record takes at least: an ASCII value a digit and a separator, a list its count."""
        if not order:
            return 2 * len(self.properties)
        return sum(np.dtype(item.count_kind or item.kind).itemsize for item in self.properties)


def read_ply(path: Path, file: str) -> tuple[Cloud, Ints]:
    """The vertices and the faces (F,3), polygons cut into fans; a point cloud has F = 0."""
    with reading(file, "PLY"):
        data = path.read_bytes()
        elements, order, start = _header(data[:_HEADER_BYTES], file)
        if order:
            return _read_binary(data, start, elements, order, file)
        return _read_ascii(data[start:], elements, file)


def _header(head: bytes, file: str) -> tuple[list[_Element], str, int]:
    """The elements, the byte order ("" is ASCII), and where the data starts."""
    end = head.find(b"end_header")
    stop = head.find(b"\n", end) if end >= 0 else -1
    if stop < 0:
        raise truncated(file, "ends before the PLY header does")
    order: str | None = None
    elements: list[_Element] = []
    for line in head[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, _property(words[1:])))
    if order is None or any(element.count < 0 for element in elements):
        raise unreadable(file, "has a PLY header without a known format")
    return elements, order, stop + 1


def _property(words: list[str]) -> _Property:
    if words[0] == "list":
        return _Property(words[3], _TYPES[words[2]], _TYPES[words[1]])
    return _Property(words[1], _TYPES[words[0]])


def _check_counts(element: _Element, left: int, order: str, file: str) -> None:
    need = element.count * element.smallest(order)
    if need > left + 1:  # the last ASCII line may lack its newline
        what = f"promises {element.count:,} x {element.name!r}, at least {need:,} bytes, and has {left:,}"
        raise truncated(file, what)
    if element.count > MAX_POINTS:
        raise too_many(element.count, file)


def _read_binary(data: bytes, at: int, elements: list[_Element], order: str, file: str) -> tuple[Cloud, Ints]:
    cloud: Cloud | None = None
    faces: Ints = np.zeros((0, 3), np.int64)
    for element in elements:
        _check_counts(element, len(data) - at, order, file)
        if not element.has_list:
            dtype = _record(element, order, {})
            if element.name == "vertex":
                cloud = _cloud(np.frombuffer(data, dtype, element.count, at), file)
            at += dtype.itemsize * element.count
        elif element.name == "face" or cloud is None:
            polygons, at = _binary_lists(data, at, element, order, file)
            faces = _fans(polygons, cloud, file) if element.name == "face" else faces
        if cloud is not None and element.name == "face":
            break
    if cloud is None:
        raise unreadable(file, "is a PLY without vertices")
    return cloud, faces


def _record(element: _Element, order: str, lengths: dict[str, int]) -> np.dtype[Any]:
    """The structured type of a record whose lists have the given lengths; list counts become fields '#name'."""
    fields: list[Any] = []
    for item in element.properties:
        if item.count_kind:
            fields.append((f"#{item.name}", order + item.count_kind))
            fields.append((item.name, order + item.kind, (lengths[item.name],)))
        else:
            fields.append((item.name, order + item.kind))
    return np.dtype(fields)


def _cloud(records: NDArray[Any], file: str) -> Cloud:
    columns = {_ALIASES.get(name, name): records[name] for name in records.dtype.names or ()}
    return named_columns(columns, file)


def _binary_lists(data: bytes, at: int, element: _Element, order: str, file: str) -> tuple[list[Ints], int]:
    """Polygons grouped by their number of corners, each (F,k), and where the next element starts."""
    if element.count == 0:
        return [], at
    first = _one_record(data, at, element, order, file)[1]
    dtype = _record(element, order, {name: len(values) for name, values in first.items()})
    if element.count * dtype.itemsize <= len(data) - at:
        records = np.frombuffer(data, dtype, element.count, at)
        if all((records[f"#{name}"] == len(values)).all() for name, values in first.items()):
            return [records[_corners(element, file)].astype(np.int64)], at + records.nbytes
    return _mixed_lists(data, at, element, order, file)


def _mixed_lists(data: bytes, at: int, element: _Element, order: str, file: str) -> tuple[list[Ints], int]:
    groups: dict[int, list[NDArray[Any]]] = {}
    corners = _corners(element, file)
    for _ in range(element.count):
        at, lists = _one_record(data, at, element, order, file)
        groups.setdefault(len(lists[corners]), []).append(lists[corners])
    return [np.stack(group).astype(np.int64) for group in groups.values()], at


def _one_record(data: bytes, at: int, element: _Element, order: str, file: str) -> tuple[int, dict[str, NDArray[Any]]]:
    """Where the record ends, and its lists."""
    lists: dict[str, NDArray[Any]] = {}
    for item in element.properties:
        kind, count = np.dtype(order + item.kind), 1
        if item.count_kind:
            count_kind = np.dtype(order + item.count_kind)
            if at + count_kind.itemsize > len(data):
                raise truncated(file, f"ends inside its {element.name!r} list")
            count = int(np.frombuffer(data, count_kind, 1, at)[0])
            at += count_kind.itemsize
        if count < 0 or at + count * kind.itemsize > len(data):
            raise truncated(file, f"ends inside its {element.name!r} list")
        if item.count_kind:
            lists[item.name] = np.frombuffer(data, kind, count, at)
        at += count * kind.itemsize
    return at, lists


def _corners(element: _Element, file: str) -> str:
    """The name of the list that holds a face's corners."""
    lists = [item.name for item in element.properties if item.count_kind]
    known = [name for name in lists if name in ("vertex_indices", "vertex_index")]
    return (known or lists)[0]


def _fans(polygons: list[Ints], cloud: Cloud | None, file: str) -> Ints:
    """(F,3): every polygon (a, b, c, d, ...) becomes the triangles (a, b, c), (a, c, d), ..."""
    triangles: list[Ints] = [np.zeros((0, 3), np.int64)]
    for group in polygons:
        triangles += [group[:, [0, corner, corner + 1]] for corner in range(1, group.shape[1] - 1)]
    faces = np.concatenate(triangles)
    if cloud is None or (len(faces) and (faces.min() < 0 or faces.max() >= len(cloud.xyz))):
        raise unreadable(file, "has faces of vertices that do not exist")
    return faces


def _read_ascii(body: bytes, elements: list[_Element], file: str) -> tuple[Cloud, Ints]:
    cloud: Cloud | None = None
    faces: Ints = np.zeros((0, 3), np.int64)
    for element in elements:
        _check_counts(element, len(body), "", file)
    lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
    at = 0
    for element in elements:
        rows, at = lines[at : at + element.count], at + element.count
        if len(rows) < element.count:
            raise truncated(file, f"promises {element.count:,} x {element.name!r} and has {len(rows):,} lines of them")
        if element.name == "vertex":
            cloud = _ascii_cloud(rows, element, file)
        elif element.name == "face":
            faces = _fans(_ascii_lists(rows), cloud, file)
    if cloud is None:
        raise unreadable(file, "is a PLY without vertices")
    return cloud, faces


def _ascii_cloud(rows: list[str], element: _Element, file: str) -> Cloud:
    """Parsed as float64, which holds every PLY type exactly, then cast, so that colours keep their range."""
    if element.has_list:
        raise unreadable(file, "has vertices with lists, which are not read")
    table = np.loadtxt(rows, np.float64, comments=None, ndmin=2) if rows else np.zeros((0, len(element.properties)))
    if table.shape[1] != len(element.properties):
        raise unreadable(file, f"has {table.shape[1]} numbers per vertex, not {len(element.properties)}")
    columns = {
        _ALIASES.get(item.name, item.name): table[:, at] if item.kind[0] == "f" else table[:, at].astype(item.kind)
        for at, item in enumerate(element.properties)
    }
    return named_columns(columns, file)


def _ascii_lists(rows: list[str]) -> list[Ints]:
    """Polygons grouped by their number of corners; the corners are the row's first list."""
    groups: dict[int, list[list[int]]] = {}
    for row in rows:
        fields = row.split()
        count = int(fields[0])
        corners = [int(field) for field in fields[1 : 1 + count]]
        if len(corners) != count:
            raise ValueError("a face has fewer corners than it says")
        groups.setdefault(count, []).append(corners)
    return [np.array(group, np.int64).reshape(len(group), -1) for group in groups.values()]
