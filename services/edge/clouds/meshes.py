"""Read mesh files: glTF with its textures, materials and buffers, .off and .stl.

trimesh cuts the polygons of an OFF as fans, finds no counts behind a remark, and takes the name of a solid for numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.files import Folder, translate_errors, truncated
from capture2vr.edge.capture.images import read_bytes
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.gltf import GltfFile
from capture2vr.edge.clouds.gltf_materials import GltfMaterials
from capture2vr.edge.clouds.gltf_scene import (
    POINTS,
    SURFACES,
    TRIANGLES,
    Primitive,
    check_counts,
    placed_meshes,
    primitives,
)
from capture2vr.edge.clouds.obj import numbers_of
from capture2vr.edge.clouds.sample_surface import MAX_FACES, ColourAt, SampledSurface, too_many_faces
from capture2vr.edge.clouds.surface_colours import absent_textures, face_colours, vertex_colours
from capture2vr.edge.clouds.table_text import text_lines
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.mesh.polygons import triangulate
from capture2vr.edge.srgb import to_srgb
from capture2vr.sentences.sentence import in_row, say

_STL_HEADER = 84  # bytes: a remark, and the number of facets of 50 bytes each
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CORNER = re.compile(rb"(?:^|(?<=[\r\n]))[ \t]*+vertex[ \t]++([^\r\n]++)", re.IGNORECASE)
_AT_ONCE = 200_000  # lines of a text that are words at the same time, which take ten times as much memory


@dataclass(frozen=True, slots=True)
class MeshFile:
    """What a mesh file has, in the scene's frame: its surfaces, else its points if it has any, and warnings."""

    surfaces: list[SampledSurface]
    points: Cloud | None
    warnings: tuple[str, ...] = ()


def read_mesh(folder: Folder, file: str, kind: str) -> MeshFile:
    """Read the triangles, else the points, of a file of `kind` "off", "stl", "glb" or "gltf".

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    if kind in ("glb", "gltf"):
        with translate_errors(file, "glTF"):
            return _read_gltf(GltfFile(folder, file, kind))
    data = read_bytes(folder.path(file), file)
    with translate_errors(file, kind.upper()):
        surface = _read_off(data, file) if kind == "off" else _read_stl(data, file)
    return MeshFile([surface] if len(surface.faces) else [], None)


def _read_gltf(gltf: GltfFile) -> MeshFile:
    """Read the triangles, else the points, of a glTF; name what it has that is not read."""
    placed, materials = placed_meshes(gltf), GltfMaterials(gltf)
    check_counts(gltf, placed)
    surfaces = [
        materials.surface(each) for mesh in placed for each in primitives(gltf, mesh, SURFACES) if len(each.faces)
    ]
    points = None
    if not surfaces:
        clouds = [each for mesh in placed for each in primitives(gltf, mesh, (POINTS,)) if len(each.vertices)]
        points = _gltf_points(clouds, materials) if clouds else None
    modes = {each.get("mode", TRIANGLES) for mesh in placed for each in mesh.primitives}
    unread = [*_unread(gltf, modes, bool(surfaces))]
    notes = (in_row(": ", (gltf.file, say("read_without_these_parts", names=in_row(", ", unread)))),) if unread else ()
    return MeshFile(surfaces, points, (*absent_textures(gltf.file, gltf.absent), *notes))


def _unread(gltf: GltfFile, modes: Set[int], are_surfaces: bool) -> Iterator[str]:
    """Name what a glTF of primitives of these modes has and is not read."""
    if gltf.tree.get("animations"):
        yield say("part_animations")
    if gltf.tree.get("cameras"):
        yield say("word_cameras")
    if modes - {POINTS, *SURFACES}:
        yield say("part_lines")
    if are_surfaces and POINTS in modes:
        yield say("part_points_beside_surface")
    yield from gltf.unread_extensions()


def _gltf_points(clouds: Sequence[Primitive], materials: GltfMaterials) -> Cloud:
    """Return the points of primitives; their colours where all have some."""
    lights = [materials.point_light(each) for each in clouds]
    shades = [
        np.resize(to_srgb(light), (len(each.vertices), 3))  # again and again, for each of its instances
        for light, each in zip(lights, clouds, strict=True)
        if light is not None
    ]
    rgb, notes = read_colours(np.concatenate(shades) if len(shades) == len(clouds) else None)
    return Cloud(np.concatenate([each.vertices for each in clouds]), rgb, notes=notes)


def _read_off(data: bytes, file: str) -> SampledSurface:
    """Read an OFF: its polygons, with the colours of its vertices, else of its faces, if these have some."""
    lines = (line for each in text_lines(data, file) if (line := each.split(b"#")[0].strip()))
    head, vertices, faces = _off_head(lines, len(data), file)
    first = (0,) if b"C" not in head else (0, 6) if b"N" in head else (0, 3)
    rows = np.concatenate([np.zeros((0, 3 * len(first))), *(
        np.hstack([_columns(batch, at) for at in first]) for batch in _batches(islice(lines, vertices))
    )])  # fmt: skip
    if len(rows) < vertices:
        raise _too_few(vertices, len(rows), file)
    corners, sizes, colours = _polygons(lines, faces, file)
    xyz = rows[:, :3]
    if len(corners) and (corners.min() < 0 or corners.max() >= len(xyz)):
        raise ValueError(say("face_has_indices_vertices"))
    cut, polygon = triangulate(xyz, corners, sizes)
    return SampledSurface(xyz, corners[cut], _off_colours(rows[:, 3:], corners[cut], colours, polygon))


def _off_head(lines: Iterator[bytes], size: int, file: str) -> tuple[bytes, int, int]:
    """Return the first word of an OFF of `size` bytes, and its counts of vertices and faces."""
    head, *counts = next(lines).split()
    counts = counts or next(lines, b"").split()
    vertices, faces = int(counts[0]), int(counts[1])
    if vertices * 6 + faces * 8 > size + 8:  # the least bytes of their lines
        what = say("vertices_faces_do_not_fit", vertices=vertices, faces=faces, size=size)
        raise truncated(file, say("cut_off_header_announces", what=what))
    return head, vertices, faces


def _polygons(lines: Iterable[bytes], count: int, file: str) -> tuple[Ints, Ints, Floats]:
    """Return the corners (C,) of `count` polygons, how many each has, and their colours (P,3), NaN where one has none.

    Those of less than three corners are left out.
    """
    corners, sizes, colours = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    found = total = 0
    for batch in _batches(islice(lines, count)):
        found += len(batch)
        polygons = [words for line in batch if int((words := line.split())[0]) > 2]
        sizes.append(np.array([int(words[0]) for words in polygons], np.int64))
        if (total := total + int(sizes[-1].sum())) > 3 * MAX_FACES:
            raise too_many_faces(total, file)
        corners.append(numbers_of([*chain.from_iterable(words[1 : 1 + int(words[0])] for words in polygons)], np.int64))
        behind = (words[1 + int(words[0]) :][:3] for words in polygons)
        tints = [*chain.from_iterable(each if len(each) == 3 else [b"nan"] * 3 for each in behind)]
        colours.append(numbers_of(tints, np.float64).reshape(-1, 3))
    if found < count:
        raise _too_few(count, found, file)
    return np.concatenate(corners), np.concatenate(sizes), np.concatenate(colours)


def _too_few(count: int, found: int, file: str) -> CaptureError:
    what = say("lines_but", count=count, name=repr("OFF"), found=found)
    return truncated(file, say("cut_off_header_announces", what=what))


def _batches(items: Iterable[bytes]) -> Iterator[list[bytes]]:
    """Yield so many at once that their words take little memory."""
    rest = iter(items)
    while batch := [*islice(rest, _AT_ONCE)]:
        yield batch


def _columns(lines: Sequence[bytes], first: int) -> Floats:
    """Return the three numbers (N,3) of each line that begin with number `first`."""
    words = chain.from_iterable(line.split(None, first + 3)[first : first + 3] for line in lines)
    return np.asarray(numbers_of([*words], np.float64).reshape(len(lines), 3))


def _off_colours(of_vertices: Floats, faces: Ints, of_polygons: Floats, polygon: Ints) -> ColourAt | None:
    """Return the colours of an OFF: those of its vertices (V,3), else of its polygons (P,3) where all have one."""
    if of_vertices.size:
        rgb, _ = read_colours(of_vertices)
        return None if rgb is None else vertex_colours(rgb, faces)
    if not len(of_polygons) or np.isnan(of_polygons).any():
        return None
    rgb, _ = read_colours(of_polygons)
    return None if rgb is None else face_colours(rgb[polygon])


def _read_stl(data: bytes, file: str) -> SampledSurface:
    """Read the facets of an STL, binary or text."""
    binary = is_binary_stl(data, len(data), named=True)
    count = int.from_bytes(data[80:84], "little")
    if binary and count > MAX_FACES:
        raise too_many_faces(count, file)
    facets = np.frombuffer(data, _FACET, count, _STL_HEADER)["corners"] if binary else _text_facets(data, file)
    vertices = facets.reshape(-1, 3).astype(np.float64)
    return SampledSurface(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _text_facets(data: bytes, file: str) -> Floats:
    """Return the corners (3F,3) of all facets of an STL that is a text, whatever the names of its solids are."""
    parts: list[Floats] = [np.zeros((0, 3))]
    count = 0
    for rows in _batches(match[1] for match in _CORNER.finditer(data)):
        parts.append(_columns(rows, 0))
        count += len(rows)
        if count > 3 * MAX_FACES:
            raise too_many_faces(count // 3, file)
    return np.concatenate(parts)


def is_binary_stl(head: bytes, size: int, *, named: bool) -> bool:
    """Return whether a file of `size` bytes is a binary STL: as long as its number of facets tells.

    named: whether it has the suffix .stl; some programs then write more behind the last facet. The upper byte of the
    number of facets, of which at most MAX_FACES are read, is 0, which no text has; many a head begins with "solid".
    """
    if len(head) < _STL_HEADER:
        return False
    needed = _STL_HEADER + 50 * int.from_bytes(head[80:84], "little")
    return size == needed or (named and _STL_HEADER < needed < size and head[83] == 0)
