"""Read the elements of a PLY by the order of properties that its header declares, lists wherever they are."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.files import truncated, unreadable
from capture2vr.edge.clouds.sample_surface import MAX_FACES, too_many_faces
from capture2vr.edge.clouds.table_rows import NO_NUMBER
from capture2vr.edge.mesh.polygons import triangulate
from capture2vr.sentences.sentence import say

_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class Property:
    """A property of an element: its name, NumPy's code of its type, and that of a list's length; "" for a scalar."""

    name: str
    kind: str
    count_kind: str = ""


@dataclass(frozen=True, slots=True)
class PlyElement:
    """An element: its name in lower case, how many records it has, and their properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_list(self) -> bool:
        """Whether any property is a list."""
        return any(item.count_kind for item in self.properties)

    @property
    def corners(self) -> str:
        """Name of a face's list of vertices: by its name, else the first list; "" of other elements, or without one."""
        lists = [item.name for item in self.properties if item.count_kind and self.name == "face"]
        return next((name for name in lists if name in _CORNERS), lists[0] if lists else "")

    def least_bytes(self, order: str) -> int:
        """Return the least bytes of one record: two per ASCII value (digit, separator), only the count of a list."""
        if not order:
            return 2 * len(self.properties)
        return sum(np.dtype(item.count_kind or item.kind).itemsize for item in self.properties)

    def record(self, order: str, lengths: dict[str, int]) -> np.dtype[Any]:
        """Return the record type of an element whose lists have the given lengths; list counts are fields '#name'."""
        fields: list[Any] = []
        for item in self.properties:
            if item.count_kind:
                fields.append((f"#{item.name}", order + item.count_kind))
                fields.append((item.name, order + item.kind, (lengths[item.name],)))
            else:
                fields.append((item.name, order + item.kind))
        return np.dtype(fields)


@dataclass(frozen=True, slots=True)
class Records:
    """An element's records: its scalars (N,) by name, and the list of corners, grouped by length.

    polygons  rows (F,) of the records whose list has k values, and these (F,k)
    """

    columns: dict[str, NDArray[Any]]
    polygons: list[tuple[Ints, Ints]]


def binary_records(data: bytes, at: int, element: PlyElement, order: str, file: str) -> tuple[Records, int]:
    """Read an element that begins at byte `at`, and return the offset behind it. Raises CAPTURE_TRUNCATED."""
    lengths = _first_lengths(data, at, element, order)
    if lengths is not None:
        dtype = element.record(order, lengths)
        if element.count * dtype.itemsize <= len(data) - at:
            records = np.frombuffer(data, dtype, element.count, at)
            if all((records[f"#{name}"] == length).all() for name, length in lengths.items()):
                columns = {item.name: records[item.name] for item in element.properties if not item.count_kind}
                corners = element.corners
                polygons: list[tuple[Ints, Ints]] = []
                if corners:
                    polygons = [(np.arange(element.count), records[corners].astype(np.int64))]
                return Records(columns, polygons), at + records.nbytes
    return _records_of_lengths(data, at, element, order, file)


def _first_lengths(data: bytes, at: int, element: PlyElement, order: str) -> dict[str, int] | None:
    """Return how long the first record's lists are, as all may be; None where it does not end."""
    lengths: dict[str, int] = {}
    for item in element.properties:
        if item.count_kind:
            kind = np.dtype(order + item.count_kind)
            if at + kind.itemsize > len(data):
                return None
            count = int(np.frombuffer(data, kind, 1, at)[0]) if element.count else 0
            if not 0 <= count <= len(data) // np.dtype(item.kind).itemsize:
                return None
            lengths[item.name] = count
            at += kind.itemsize + count * np.dtype(item.kind).itemsize
        else:
            at += np.dtype(item.kind).itemsize
    return lengths


def _records_of_lengths(data: bytes, at: int, element: PlyElement, order: str, file: str) -> tuple[Records, int]:
    """Read records whose lists differ in length: first where each list is, then all values of a property at once."""
    offsets, counts, end = _find_lists(data, at, element, order, file)
    columns: dict[str, NDArray[Any]] = {}
    polygons: list[tuple[Ints, Ints]] = []
    segment, inside = 0, 0
    for item in element.properties:
        kind = np.dtype(order + item.kind)
        if not item.count_kind:
            columns[item.name] = _gather(data, offsets[:, segment] + inside, kind, 1)[:, 0]
            inside += kind.itemsize
            continue
        if item.name == element.corners:
            head = np.dtype(item.count_kind).itemsize + inside
            for count in np.unique(counts[:, segment]).tolist():
                rows = np.flatnonzero(counts[:, segment] == count)
                polygons.append((rows, _gather(data, offsets[rows, segment] + head, kind, count).astype(np.int64)))
        segment, inside = segment + 1, 0
    return Records(columns, polygons), end


def _find_lists(data: bytes, at: int, element: PlyElement, order: str, file: str) -> tuple[Ints, Ints, int]:
    """Return where the parts of each record begin, (N,lists + 1), each behind a list; the lists' lengths (N,lists); and
    the offset behind the last record. Raises CAPTURE_TRUNCATED."""
    steps: list[tuple[int, struct.Struct, int]] = []
    fixed = 0
    for item in element.properties:
        size = np.dtype(item.kind).itemsize
        if item.count_kind:
            steps.append((fixed, struct.Struct((order or "=") + np.dtype(item.count_kind).char), size))
            fixed = 0
        else:
            fixed += size
    offsets: list[int] = []
    counts: list[int] = []
    for _ in range(element.count):
        for before, count_of, size in steps:
            offsets.append(at)
            at += before
            if at + count_of.size > len(data):
                raise truncated(file, say("cut_off_inside_records", name=repr(element.name)))
            count = int(count_of.unpack_from(data, at)[0])
            counts.append(count)
            at += count_of.size + count * size
            if count < 0 or at > len(data):
                raise truncated(file, say("cut_off_inside_records", name=repr(element.name)))
        offsets.append(at)
        at += fixed
    if at > len(data):
        raise truncated(file, say("cut_off_inside_records", name=repr(element.name)))
    shape = (element.count, len(steps))
    return np.array(offsets, np.int64).reshape(-1, len(steps) + 1), np.array(counts, np.int64).reshape(shape), at


def _gather(data: bytes, places: Ints, kind: np.dtype[Any], count: int) -> NDArray[Any]:
    """Return `count` values (N,count) of a type at each of the offsets `places` (N,)."""
    width = count * kind.itemsize
    if not width:
        return np.empty((len(places), 0), kind)
    found = np.frombuffer(data, np.uint8)[places[:, None] + np.arange(width)]
    return np.ascontiguousarray(found).view(kind).reshape(len(places), count)


def ascii_records(rows: Sequence[str], element: PlyElement, file: str) -> Records:
    """Read the lines of an element; scalars as float64, exact for all types, then cast, so that colours keep theirs."""
    scalars = [item for item in element.properties if not item.count_kind]
    if any("#" in row for row in rows):
        rows = [NO_NUMBER.sub("nan", row) for row in rows]
    polygons: list[tuple[Ints, Ints]] = []
    if element.has_list:
        table, polygons = _ascii_lists(rows, element)
    else:
        table = np.loadtxt(rows, np.float64, comments=None, ndmin=2) if rows else np.zeros((0, len(scalars)))
    if table.shape[1] != len(scalars):
        what = say("has_numbers_per_vertex_header", count=table.shape[1], announced=len(scalars))
        raise unreadable(file, what)
    columns = {
        item.name: table[:, at] if item.kind[0] == "f" else table[:, at].astype(item.kind)
        for at, item in enumerate(scalars)
    }
    return Records(columns, polygons)


def _ascii_lists(rows: Sequence[str], element: PlyElement) -> tuple[NDArray[Any], list[tuple[Ints, Ints]]]:
    """Read lines with lists: the scalars (N,s), and the corners grouped by their number."""
    scalars: list[list[str]] = []
    groups: dict[int, tuple[list[int], list[list[int]]]] = {}
    corners = element.corners
    for number, row in enumerate(rows):
        fields, at, found = row.split(), 0, list[str]()
        for item in element.properties:
            if not item.count_kind:
                found.append(fields[at])
                at += 1
                continue
            count = int(fields[at])
            at += 1 + count
            if count < 0 or at > len(fields):
                raise ValueError(say("face_has_fewer_corners_than"))
            if item.name == corners:
                of_length = groups.setdefault(count, ([], []))
                of_length[0].append(number)
                of_length[1].append([int(field) for field in fields[at - count : at]])
        scalars.append(found)
    table = np.array(scalars, np.float64).reshape(len(rows), sum(not item.count_kind for item in element.properties))
    return table, [
        (np.array(lines, np.int64), np.array(values, np.int64).reshape(len(lines), -1))
        for lines, values in groups.values()
    ]


def triangles_of(polygons: Sequence[tuple[Ints, Ints]], xyz: Floats, file: str) -> tuple[Ints, Ints]:
    """Cut polygons into triangles (F,3) of the vertices (V,3), and tell the record (F,) of each."""
    polygons = [(rows, group) for rows, group in polygons if group.shape[1] >= 3]
    if (count := sum(len(group) * (group.shape[1] - 2) for _, group in polygons)) > MAX_FACES:
        raise too_many_faces(count, file)
    none = np.zeros(0, np.int64)
    corners = np.concatenate([none, *(group.ravel() for _, group in polygons)])
    if len(corners) and (corners.min() < 0 or corners.max() >= len(xyz)):
        raise unreadable(file, say("has_faces_with_indices_vertices"))
    sizes = np.concatenate([none, *(np.full(len(group), group.shape[1]) for _, group in polygons)])
    rows, polygon = triangulate(xyz, corners, sizes)
    return corners[rows], np.concatenate([none, *(rows for rows, _ in polygons)])[polygon]
