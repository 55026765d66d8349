"""Read mesh files: glTF with its textures, materials and buffers; .off and .stl with trimesh."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

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
from capture2vr.edge.clouds.sample_surface import MAX_FACES, SampledSurface, too_many_faces
from capture2vr.edge.clouds.surface_colours import absent_textures, face_colours, vertex_colours
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.srgb import to_srgb
from capture2vr.sentences.sentence import in_row, say

_STL_HEADER = 84  # bytes: a remark, and the number of facets of 50 bytes each
_MAX_SOLIDS = 1_000  # of an ASCII STL; programs write one, or one for each part


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
    import trimesh

    data = read_bytes(folder.path(file), file)
    if kind == "off":
        _check_off(data, file)
    else:
        _check_solids(data, file)
        data = data[: _stl_bytes(data)] if is_binary_stl(data, len(data), named=True) else data
    with translate_errors(file, kind.upper()):
        loaded = trimesh.load_scene(BytesIO(data), file_type=kind, process=False, maintain_order=True)
        meshes = [loaded.geometry[loaded.graph[node][1]] for node in loaded.graph.nodes_geometry]
        faces = sum(len(getattr(mesh, "faces", ())) for mesh in meshes)
        if faces > MAX_FACES:
            raise too_many_faces(faces, file)
        surfaces = [_surface(mesh) for mesh in meshes if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    return MeshFile(surfaces, None)


def _surface(mesh: Any) -> SampledSurface:
    """Return the triangles of a mesh of trimesh, with the colours of its vertices or faces if it has any."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(say("face_has_indices_vertices"))
    colours = None
    if mesh.visual.kind == "vertex":
        colours = vertex_colours(np.asarray(mesh.visual.vertex_colors)[:, :3], faces)
    elif mesh.visual.kind == "face":
        colours = face_colours(np.asarray(mesh.visual.face_colors)[:, :3].astype(np.uint8))
    return SampledSurface(vertices, faces, colours)


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


def _check_off(data: bytes, file: str) -> None:
    """Check the vertex and face counts at the start of an OFF: a vertex takes at least 6 bytes, a face 8."""
    lines = data[:4096].decode("latin-1").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.strip().startswith("#")]
    with translate_errors(file, "OFF"):
        counts = rows[0][1:] or rows[1]
        vertices, faces = int(counts[0]), int(counts[1])
    if (vertices * 6 + faces * 8) > len(data) + 8:
        what = say("vertices_faces_do_not_fit", vertices=vertices, faces=faces, size=len(data))
        raise truncated(file, say("cut_off_header_announces", what=what))


def is_binary_stl(head: bytes, size: int, *, named: bool) -> bool:
    """Return whether a file of `size` bytes is a binary STL: as long as its number of facets tells.

    named: whether it has the suffix .stl; some programs then write more behind the last facet
    """
    if len(head) < _STL_HEADER:
        return False
    needed = _stl_bytes(head)
    return size == needed or (named and _STL_HEADER < needed < size and not head.lstrip().startswith(b"solid"))


def _stl_bytes(head: bytes) -> int:
    """Return how long a binary STL is, by its header."""
    return _STL_HEADER + 50 * int.from_bytes(head[80:84], "little")


def _check_solids(data: bytes, file: str) -> None:
    """Refuse an ASCII STL of too many solids, in a time that grows with their square where they have one name."""
    if (count := len(re.findall(rb"endsolid", data, re.IGNORECASE))) > _MAX_SOLIDS:
        what = say("has_more_solids_than_read", count=count, most=_MAX_SOLIDS)
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("join_meshes_scene_into"),))
