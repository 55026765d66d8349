"""Read mesh files with trimesh: .off, .stl, .glb and .gltf, with their textures, materials and buffers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.colour_profile import rgb_of
from capture2vr.edge.capture.files import Folder, translate_errors, truncated
from capture2vr.edge.capture.images import check_header, read_bytes
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.gltf import LIGHT, find_uri, plain_gltf
from capture2vr.edge.clouds.sample_surface import MAX_FACES, ColourAt, SampledSurface, too_many_faces
from capture2vr.edge.clouds.surface_colours import TexturePixels, absent_textures, nearest_texels, vertex_colours
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.sentences.sentence import say

_STL_HEADER = 84  # bytes: a remark, and the number of facets of 50 bytes each
_MAX_SOLIDS = 1_000  # of an ASCII STL; programs write one, or one for each part


class _SiblingFiles(Mapping[str, bytes]):
    """trimesh resolver: reads the files that a mesh refers to; a file outside the capture is never opened."""

    def __init__(self, folder: Folder, file: str) -> None:
        self._folder, self._file = folder, file
        self.buffers: dict[str, bytes] = {}  # those of a rewritten glTF, by their URIs
        self.absent: list[str] = []  # names of textures
        self.refused: CaptureError | None = None  # trimesh swallows errors raised here and continues without colours

    def __getitem__(self, name: str) -> bytes:
        if name in self.buffers:
            return self.buffers[name]
        try:
            return self._read(name)
        except CaptureError as error:
            self.refused = error
            raise

    def _read(self, name: str) -> bytes:
        beside = find_uri(self._folder, self._file, name)
        if beside is None:
            self.absent.append(name)
            raise KeyError(name)  # trimesh continues without a texture
        data = read_bytes(self._folder.path(beside), beside)
        check_header(data, beside)
        return data

    def __iter__(self) -> Iterator[str]:
        return iter(self._folder.names)

    def __len__(self) -> int:
        return len(self._folder.names)


@dataclass(frozen=True, slots=True)
class MeshFile:
    """What a mesh file has, in the scene's frame: its surfaces, else its points if it has any, and warnings."""

    surfaces: list[SampledSurface]
    points: Cloud | None
    warnings: tuple[str, ...]


def read_mesh(folder: Folder, file: str, kind: str) -> MeshFile:
    """Read the triangles, else the points, of a file of `kind` "off", "stl", "glb" or "gltf".

    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    import trimesh

    data = read_bytes(folder.path(file), file)
    beside, parser = _SiblingFiles(folder, file), kind
    if kind == "off":
        _check_off(data, file)
    elif kind == "stl":
        _check_solids(data, file)
        data = data[: _stl_bytes(data)] if is_binary_stl(data, len(data), named=True) else data
    elif kind in ("glb", "gltf"):
        data, beside.buffers = plain_gltf(data, kind, folder, file, beside)
        parser = "gltf"
    with translate_errors(file, kind.upper()):
        loaded = trimesh.load_scene(
            BytesIO(data), file_type=parser, resolver=beside, process=False, maintain_order=True
        )
        if beside.refused is not None:
            raise beside.refused
        nodes = list(loaded.graph.nodes_geometry)
        faces = sum(len(getattr(loaded.geometry[loaded.graph[node][1]], "faces", ())) for node in nodes)
        if faces > MAX_FACES:
            raise too_many_faces(faces, file)
        _check_textures(loaded, nodes, file)
        pictures: _Pictures = {}
        surfaces = [surface for node in nodes if (surface := _surface(loaded, node, pictures)) is not None]
        points = None if surfaces else _points(loaded, nodes, file)
    return MeshFile(surfaces, points, absent_textures(file, beside.absent))


def _points(scene: Any, nodes: Sequence[str], file: str) -> Cloud | None:
    """Return the points of a scene that has no triangles, or None; their colours where all nodes have some."""
    import trimesh

    placed = [scene.graph[node] for node in nodes]
    clouds = [(pose, scene.geometry[name]) for pose, name in placed]
    clouds = [(pose, cloud) for pose, cloud in clouds if isinstance(cloud, trimesh.PointCloud)]
    if (count := sum(len(cloud.vertices) for _, cloud in clouds)) > MAX_POINTS:
        raise too_many_points(count, file)
    if not count:
        return None
    xyz = [np.asarray(cloud.vertices, np.float64) @ pose[:3, :3].T + pose[:3, 3] for pose, cloud in clouds]
    colours = [np.asarray(cloud.colors) for _, cloud in clouds]
    coloured = all(len(each) == len(cloud.vertices) for each, (_, cloud) in zip(colours, clouds, strict=True))
    rgb, notes = read_colours(np.concatenate(colours)[:, :3] if coloured else None)
    return Cloud(np.concatenate(xyz), rgb, notes=notes)


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


_Pictures = dict[int, Bytes]
"""Cache of decoded textures by the `id` of their image: many parts of a scene share a few textures."""


def _check_textures(loaded: Any, nodes: Iterable[str], file: str) -> None:
    """Add up the pixels of a scene's textures before any is decoded. Raises IMAGE_TOO_LARGE, CAPTURE_TOO_LARGE."""
    shown = (loaded.geometry[loaded.graph[node][1]] for node in nodes)
    images = (_base_texture(getattr(getattr(each, "visual", None), "material", None)) for each in shown)
    pixels = TexturePixels(file)
    for image in {id(image): image for image in images if image is not None}.values():
        pixels.add(image.size)


def _base_texture(material: Any) -> Any:
    return getattr(material, "baseColorTexture", None)


def _surface(scene: Any, node: str, pictures: _Pictures) -> SampledSurface | None:
    """Return the triangles of one scene node, transformed to the scene's frame, or None if it has none."""
    import trimesh

    transform, name = scene.graph[node]
    geometry = scene.geometry[name]
    if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
        return None
    vertices = np.asarray(geometry.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
    faces = np.asarray(geometry.faces, np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(say("face_has_indices_vertices"))
    return SampledSurface(vertices, faces, _colours(geometry, faces, pictures))


def _colours(geometry: Any, faces: Ints, pictures: _Pictures) -> ColourAt | None:
    """Return the function that looks up colours: from texture, material, vertices or faces; None without colours."""
    visual = geometry.visual
    material, light = getattr(visual, "material", None), _per_vertex(geometry, LIGHT)
    if light is not None or hasattr(material, "baseColorTexture"):
        return _gltf_colours(material, visual, light, faces, pictures)
    if visual.kind == "vertex":
        return vertex_colours(np.asarray(visual.vertex_colors)[:, :3], faces)
    if visual.kind == "face":
        flat = np.asarray(visual.face_colors)[:, :3].astype(np.uint8)
        return lambda triangle, weights: flat[triangle]
    return None


def _per_vertex(geometry: Any, name: str) -> Floats | None:
    """Return an attribute (V,3) of a mesh's vertices, or None where it has none, or one of another length."""
    values = geometry.vertex_attributes.get(name)
    return None if values is None or np.shape(values) != (len(geometry.vertices), 3) else np.asarray(values)


def _gltf_colours(material: Any, visual: Any, light: Floats | None, faces: Ints, pictures: _Pictures) -> ColourAt:
    """Return a function that multiplies texture, factor and vertex colours as linear light (glTF 2.0, section 3.9.2).

    White for a material without any of them.
    """
    factor = getattr(material, "baseColorFactor", None)  # bytes of linear light
    texel_at = _texture(_base_texture(material), visual, faces, pictures)
    linear = np.ones(3) if factor is None else np.asarray(factor, np.float64)[:3] / 255

    def colour_at(triangle: Ints, weights: Floats) -> Bytes:
        shade = np.tile(linear, (len(triangle), 1))
        if light is not None:
            shade *= np.einsum("nc,ncd->nd", weights, light[faces[triangle]])
        return to_srgb(shade if texel_at is None else shade * to_linear(texel_at(triangle, weights)))

    return colour_at


def _texture(image: Any, visual: Any, faces: Ints, pictures: _Pictures) -> ColourAt | None:
    """Return a function that looks up the texels of a picture, or None without picture or texture coordinates."""
    if image is None or visual.uv is None:
        return None
    uv = np.asarray(visual.uv, np.float64)
    if id(image) not in pictures:
        pictures[id(image)] = rgb_of(image)
    pixels = pictures[id(image)]
    return lambda triangle, weights: nearest_texels(pixels, np.einsum("nc,ncd->nd", weights, uv[faces[triangle]]))
