"""Read Wavefront OBJ files: triangles in the colours of their textures, vertices and materials, or points alone.

trimesh loses the texture of quads, which most modelling programs write, takes relative indices for those of the whole
file, and finds no face behind a tab.
"""

from __future__ import annotations

import posixpath
import warnings
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Ints, Tick
from capture2vr.edge.capture.files import Folder, translate_errors, unreadable
from capture2vr.edge.capture.images import read_bytes
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.capture.text_encoding import decode_text, encoding_of
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.obj_materials import Material, ObjColours, read_mtl, texture_size, without_remark
from capture2vr.edge.clouds.sample_surface import MAX_FACES, SampledSurface, too_many_faces
from capture2vr.edge.clouds.surface_colours import TexturePixels, absent_textures
from capture2vr.edge.clouds.table_rows import NO_NUMBER
from capture2vr.edge.clouds.table_text import text_lines
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.mesh.polygons import triangulate
from capture2vr.sentences.sentence import say

MAX_MATERIALS = 500  # scanners write tens; a large texture takes a second to decode
MAX_LIBRARIES = 100  # files of materials; programs write one, or one for each part that was joined
_PACKED = 200_000  # rows or faces that wait as words before they become numbers: words take ten times as much memory
_COLOURED, _NO_COLOUR = 6, [b"nan"] * 3  # numbers of a vertex with a colour; what stands for the colour of another
_HEAD = 2**12  # bytes by which the encoding is told
_TICK = 100_000  # lines between calls of the folder's tick


@dataclass(frozen=True, slots=True)
class ObjFile:
    """What an OBJ file holds: its vertices as a cloud, its triangles if it has any, and warnings."""

    vertices: Cloud
    surface: SampledSurface | None
    warnings: tuple[str, ...] = ()


def read_obj(folder: Folder, file: str) -> ObjFile:
    """Read an OBJ file, with the materials and textures that it names, in the file's own frame and units.

    Raises CAPTURE_UNREADABLE, CAPTURE_TOO_LARGE and IMAGE_TOO_LARGE.
    """
    reader = _Reader(file)
    with translate_errors(file, "OBJ"):
        reader.read(_bytewise(read_bytes(folder.path(file), file)), folder.tick)
        vertices, coordinates = reader.vertices.array(), reader.coordinates.array()
        faces, uv_faces, material = reader.triangles(vertices[:, :3], len(coordinates))
    if len(vertices) == 0:
        raise unreadable(file, say("has_no_vertices"))
    rgb, notes = read_colours(_filled_in(vertices[:, 3:]) if vertices.shape[1] == _COLOURED else None)
    cloud = Cloud(vertices[:, :3], rgb, notes=notes)
    if len(faces) == 0:
        return ObjFile(cloud, None)
    known = _materials(folder, file, reader.libraries, frozenset(reader.materials))
    used = [known.get(name, Material()) for name in reader.materials]
    pixels = TexturePixels(file)
    for name in {each.texture for each in used if each.texture}:
        pixels.add(texture_size(folder, name))
    uv = np.zeros((len(coordinates), 2))
    uv[:, : coordinates.shape[1]] = coordinates[:, :2]
    colours = ObjColours(folder, used, material, uv, uv_faces, faces, rgb)
    surface = SampledSurface(cloud.xyz, faces, colours.colour_at if colours.there else None)
    return ObjFile(cloud, surface, absent_textures(file, [each.absent for each in used if each.absent]))


def _bytewise(data: bytes) -> bytes:
    """Return a text with its Latin letters and digits as single bytes: UTF-16 as UTF-8, all others as they are."""
    encoding, mark = encoding_of(data[:_HEAD])
    return data[mark:].decode(encoding, "replace").encode() if encoding.startswith("utf-16") else data


def _filled_in(colours: Floats) -> Floats:
    """Return colours (N,3) with the mean of the others where a vertex has none."""
    known = np.asarray(np.isfinite(colours).all(axis=1))
    return np.where(known[:, None], colours, colours[known].mean(axis=0)) if known.any() else colours


class _Rows:
    """Rows of numbers of one kind: words as they are read, arrays of float64 as soon as there are many."""

    def __init__(self, least: int) -> None:
        self._least = least
        self._words: list[list[bytes]] = []
        self._arrays: list[Floats] = []
        self.count = 0

    def add(self, words: list[bytes]) -> None:
        self._words.append(words)
        self.count += 1
        if len(self._words) == _PACKED:
            self._pack()

    def array(self) -> Floats:
        """Return all rows as an array (N,C), C = 6 where any row has colours behind a place, which are NaN in others,
        else the fewest numbers that a row has."""
        self._pack()
        widths = [each.shape[1] for each in self._arrays]
        width = _COLOURED if _COLOURED in widths else min(widths, default=self._least)
        table = np.full((self.count, width), np.nan)
        at = 0
        for each in self._arrays:
            kept = width if each.shape[1] >= width else 3
            table[at : at + len(each), :kept] = each[:, :kept]
            at += len(each)
        return table

    def _pack(self) -> None:
        if not self._words:
            return
        least, most = min(map(len, self._words)), max(map(len, self._words))
        if least < self._least:
            raise ValueError(say("vertex_has_numbers", count=least, least=self._least))
        width = _COLOURED if most >= _COLOURED else least
        if least < width:
            self._words = [row if len(row) >= width else [*row[:3], *_NO_COLOUR] for row in self._words]
        words = list(chain.from_iterable(row[:width] for row in self._words))
        self._arrays.append(numbers_of(words, np.float64).reshape(-1, width))
        self._words.clear()


class _Reader:
    """Reads the lines of an OBJ: vertices, texture coordinates, and faces, which become triangles."""

    def __init__(self, file: str) -> None:
        self._file = file
        self.vertices, self.coordinates = _Rows(3), _Rows(1)
        self.materials = [""]  # names, in the order of their first use; "" before the first
        self.libraries: dict[str, None] = {}  # as they are written, each once
        self._numbers = {"": 0}
        self._material = 0
        self._corners: list[bytes] = []
        self._sizes: list[int] = []  # corners of each face
        self._before: list[tuple[int, int, int]] = []  # vertices and coordinates before each face, and its material
        self._parts: list[tuple[Ints, Ints, Ints]] = []  # corners (C,2), their number per face, and its material
        self._count = 0

    def read(self, data: bytes, tick: Tick) -> None:
        """Read all lines. A backslash at the end of one continues it on the next."""
        for ending in (b"\\\r\n", b"\\\n", b"\\\r"):
            data = data.replace(ending, b" ")
        at = 0
        for number, line in enumerate(text_lines(data, self._file)):
            at += len(line)
            if number % _TICK == 0:
                tick(at / len(data))
            self._read_line(line)

    def triangles(self, xyz: Floats, coordinates: int) -> tuple[Ints, Ints, Ints]:
        """Triangulate: indices of vertices (F,3), of texture coordinates (F,3), -1: none, and of materials (F,)."""
        self._pack()
        empty = np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64)
        corners, sizes, material = (np.concatenate(parts) for parts in zip(empty, *self._parts, strict=True))
        if len(corners) and (corners[:, 0].min() < 0 or corners[:, 0].max() >= len(xyz)):
            raise ValueError(say("face_has_indices_vertices"))
        rows, face = triangulate(xyz, corners[:, 0], sizes)
        uv_faces = corners[rows, 1]
        return corners[rows, 0], np.where(uv_faces < coordinates, uv_faces, -1), material[face]

    def _read_line(self, line: bytes) -> None:
        key, *words = line.split() or (b"",)
        if b"#" in line:
            words = list(takewhile(lambda word: not word.startswith(b"#"), words))
        if not words:
            return
        if key == b"v":
            self.vertices.add(words)
        elif key == b"vt":
            self.coordinates.add(words)
        elif key == b"f":
            self._add_face(words)
        elif key == b"usemtl":
            self._use(_rest(line))
        elif key == b"mtllib":
            self._add_library(_rest(line))

    def _use(self, name: str) -> None:
        self._material = self._numbers.setdefault(name, len(self.materials))
        if self._material == len(self.materials):
            self.materials.append(name)
        if len(self.materials) - 1 > MAX_MATERIALS:
            what = say("has_more_than_materials", most=MAX_MATERIALS)
            hints = (say("export_mesh_with_one_texture"),)
            raise CaptureError("CAPTURE_TOO_LARGE", what, file=self._file, hints=hints)

    def _add_library(self, written: str) -> None:
        self.libraries[written] = None
        if len(self.libraries) > MAX_LIBRARIES:
            raise _too_many_libraries(self._file)

    def _add_face(self, corners: list[bytes]) -> None:
        if len(corners) < 3:
            return
        self._corners += corners
        self._sizes.append(len(corners))
        self._before.append((self.vertices.count, self.coordinates.count, self._material))
        self._count += len(corners) - 2
        if len(self._corners) >= 4 * _PACKED:
            self._pack()

    def _pack(self) -> None:
        """Make arrays of the faces that wait."""
        if self._count > MAX_FACES:
            raise too_many_faces(self._count, self._file)
        if not self._sizes:
            return
        size, before = np.array(self._sizes), np.array(self._before)
        indices = _corner_indices(self._corners)
        counts = np.repeat(before[:, :2], size, axis=0)
        indices = np.where(indices < 0, indices + counts, indices - 1)  # relative to the last, or from 1 on
        self._parts.append((indices, size, before[:, 2]))
        self._corners.clear()
        self._sizes.clear()
        self._before.clear()


def _rest(line: bytes) -> str:
    return without_remark(decode_text(line.split(None, 1)[1]))


def _corner_indices(corners: list[bytes]) -> Ints:
    """Read `v`, `v/vt`, `v//vn` and `v/vt/vn` -> (N,2): vertex and texture coordinate, 0 where there is none."""
    text = b" ".join(corners)
    slashes = text.count(b"/")
    if slashes == 0:
        vertex = numbers_of(corners, np.int64)
        return np.stack([vertex, np.zeros_like(vertex)], axis=1)
    alike = {corner.count(b"/") for corner in corners}
    words = text.replace(b"//", b"/0/").replace(b"/", b" ").split()
    if len(alike) == 1 and len(words) == len(corners) + slashes:
        return numbers_of(words, np.int64).reshape(len(corners), -1)[:, :2]
    pairs = ((*corner.split(b"/"), b"")[:2] for corner in corners)
    numbers = (int(number or b"0") for pair in pairs for number in pair)
    return np.fromiter(numbers, np.int64, 2 * len(corners)).reshape(-1, 2)


def numbers_of(words: list[bytes], kind: type[np.float64 | np.int64]) -> NDArray[Any]:
    """Read one number of each word. Raises ValueError."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # what NumPy says of text that is no number
        try:
            text = b" ".join(words)
            if b"#" in text:
                text = NO_NUMBER.sub("nan", text.decode("latin-1")).encode()
            numbers = np.fromstring(text, kind, sep=" ")
        except DeprecationWarning:
            numbers = np.zeros(0, kind)
    if len(numbers) != len(words):
        raise ValueError(say("line_has_something_else_where"))
    return numbers


def _materials(folder: Folder, file: str, libraries: Iterable[str], used: Collection[str]) -> dict[str, Material]:
    """Read the material libraries of a mesh, each once; of one that is absent, the one that has the mesh's own name."""
    materials: dict[str, Material] = {}
    own = posixpath.splitext(file)[0] + ".mtl"  # the mesh was renamed together with its materials
    found = dict.fromkeys(name or own for written in libraries for name in _library_files(folder, file, written))
    for name in found:
        if folder.exists(name):
            materials = read_mtl(folder, name, used) | materials
    return materials


def _library_files(folder: Folder, file: str, written: str) -> Iterator[str | None]:
    """Yield the files that one line `mtllib` names, None for each that is absent; a name may have blanks.

    Raises CAPTURE_TOO_LARGE for a line of too many.
    """
    name, words = folder.find(written, by=file), written.split(None, MAX_LIBRARIES)
    if name is not None or len(words) < 2:
        yield name
        return
    if len(words) > MAX_LIBRARIES:
        raise _too_many_libraries(file)
    yield from (folder.find(each, by=file) for each in words)


def _too_many_libraries(file: str) -> CaptureError:
    what = say("names_more_than_material_libraries", most=MAX_LIBRARIES)
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("export_mesh_with_one_material_library"),))
