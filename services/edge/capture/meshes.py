"""Read mesh files with trimesh: .obj, .off, .stl, .glb and .gltf, with their textures, materials and buffers."""

from __future__ import annotations

import posixpath
import re
import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

import numpy as np

from services.edge.arrays import Bytes, Floats, Ints
from services.edge.capture.colours import rgb8
from services.edge.capture.files import Folder, parse_json, translate_errors, unreadable
from services.edge.capture.images import check_pixels, header_size, read_bytes
from services.edge.capture.sample_surface import ColourAt, SampledSurface
from services.edge.capture.tables import MAX_POINTS, too_many_points, truncated
from services.edge.errors import CaptureError

MAX_FACES = (
    5_000_000  # summed over all nodes, as a scene can repeat one mesh a million times; sampling takes 200 bytes each
)
MAX_NODES = 5_000  # of a scene; trimesh takes about a millisecond per node
MAX_MATERIALS = 500  # of an OBJ: scanners write tens, and each takes 1 ms and more
_MATERIAL = re.compile(rb"^[ \t]*usemtl[ \t]+(.*)$", re.MULTILINE)
_GLB_HEADER = 12
_UNREAD_EXTENSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def too_many_faces(count: int, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` triangles."""
    what = f"has {count:,} triangles; at most {MAX_FACES:,} are read"
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=("simplify the mesh",))


class _SiblingFiles(Mapping[str, bytes]):
    """trimesh resolver: reads the files that a mesh refers to; a file outside the capture is never opened."""

    def __init__(self, folder: Folder, file: str) -> None:
        self._folder, self._file = folder, file
        self.refused: CaptureError | None = None  # trimesh swallows errors raised here and continues without colours

    def __getitem__(self, name: str) -> bytes:
        try:
            return self._read(name)
        except CaptureError as error:
            self.refused = error
            raise

    def _read(self, name: str) -> bytes:
        beside = self._folder.resolve(name.strip(), by=self._file, base=posixpath.dirname(self._file))
        if beside.endswith(".mtl") and not self._folder.exists(beside):
            beside = posixpath.splitext(self._file)[0] + ".mtl"  # the mesh was renamed together with its materials
        if not self._folder.exists(beside):
            raise KeyError(beside)  # trimesh continues without a texture, and fails without a buffer
        data = read_bytes(self._folder.path(beside), beside)
        size = header_size(data[: 2**18])
        if size is not None:
            check_pixels(size, beside)
        return data

    def __iter__(self) -> Iterator[str]:
        return iter(self._folder.names)

    def __len__(self) -> int:
        return len(self._folder.names)


def read_mesh(folder: Folder, file: str, kind: str) -> list[SampledSurface]:
    """Read the triangles of a file of `kind` "obj", "off", "stl", "glb" or "gltf", in the scene's frame.

    An empty list when there are no triangles. Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    import trimesh

    data = read_bytes(folder.path(file), file)
    _check_before_parsing(data, folder, file, kind)
    beside = _SiblingFiles(folder, file)
    with translate_errors(file, kind.upper()):
        loaded = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=beside, process=False, maintain_order=True)
        if beside.refused is not None:
            raise beside.refused
        nodes = list(loaded.graph.nodes_geometry)
        faces = sum(len(getattr(loaded.geometry[loaded.graph[node][1]], "faces", ())) for node in nodes)
        if faces > MAX_FACES:
            raise too_many_faces(faces, file)
        pictures: _Pictures = {}
        return [surface for node in nodes if (surface := _surface(loaded, node, pictures)) is not None]


def _check_before_parsing(data: bytes, folder: Folder, file: str, kind: str) -> None:
    """Check the counts and file names in a mesh file before trimesh reads it."""
    if kind == "obj":
        _check_obj(data, file)
    elif kind == "off":
        _check_off(data, file)
    elif kind == "glb":
        _check_gltf(_glb_json(data, file), folder, file)
    elif kind == "gltf":
        _check_gltf(parse_json(data.decode("utf-8-sig", "replace"), file), folder, file)


def _check_obj(data: bytes, file: str) -> None:
    """Refuse an OBJ of too many materials: trimesh makes a mesh of each, with all vertices."""
    if (count := len(set(_MATERIAL.findall(data)))) > MAX_MATERIALS:
        what = f"has {count:,} materials; at most {MAX_MATERIALS:,} are read"
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=("export the mesh with one texture",))


def _check_off(data: bytes, file: str) -> None:
    """Check the vertex and face counts at the start of an OFF: a vertex takes at least 6 bytes, a face 8."""
    lines = data[:4096].decode("latin-1").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.strip().startswith("#")]
    with translate_errors(file, "OFF"):
        counts = rows[0][1:] or rows[1]
        vertices, faces = int(counts[0]), int(counts[1])
    if (vertices * 6 + faces * 8) > len(data) + 8:
        what = f"{vertices:,} vertices and {faces:,} faces, which do not fit into its {len(data):,} bytes"
        raise truncated(file, f"is cut off: its header announces {what}")


def _glb_json(data: bytes, file: str) -> dict[str, Any]:
    """Parse the JSON chunk of a GLB."""
    if len(data) < _GLB_HEADER + 8:
        raise truncated(file, "is cut off inside the GLB header")
    total, length = struct.unpack_from("<I", data, 8)[0], struct.unpack_from("<I", data, _GLB_HEADER)[0]
    if max(total, length) > len(data):
        what = f"{max(total, length):,} bytes, but it has only {len(data):,}"
        raise truncated(file, f"is cut off: its header announces {what}")
    return parse_json(data[_GLB_HEADER + 8 : _GLB_HEADER + 8 + length].decode("utf-8", "replace"), file)


def _check_gltf(tree: dict[str, Any], folder: Folder, file: str) -> None:
    """Refuse a glTF with too large counts, unsupported compression, or buffer files that are missing or outside.

    trimesh would allocate memory or open the files before it notices.
    """
    with translate_errors(file, "glTF"):
        used = [name for name in _UNREAD_EXTENSIONS if name in tree.get("extensionsRequired", [])]
        if used:
            raise unreadable(file, f"needs {used[0]}, which is not supported", "export the glTF without compression")
        if len(tree.get("nodes", [])) > MAX_NODES:
            what = f"has more than {MAX_NODES:,} nodes"
            raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=("join the meshes of the scene into one",))
        for accessor in tree.get("accessors", []):
            if int(accessor["count"]) > 3 * MAX_POINTS:
                raise too_many_points(int(accessor["count"]), file)
        unbacked = sum(int(accessor["count"]) for accessor in tree.get("accessors", []) if "bufferView" not in accessor)
        if unbacked > MAX_POINTS:  # zeros that need no bytes in the file
            raise too_many_points(unbacked, file)
        for buffer in tree.get("buffers", []):
            uri = buffer.get("uri", "data:")
            if not uri.startswith("data:") and not folder.exists(_sibling_name(folder, file, uri)):
                hint = "send the .bin file together with the .gltf"
                raise unreadable(file, f"refers to {uri[:120]!r}, which is missing", hint)


def _sibling_name(folder: Folder, file: str, uri: str) -> str:
    """Return the name of the file that a URI refers to, relative to the mesh file."""
    return folder.resolve(uri, by=file, base=posixpath.dirname(file))


_Pictures = dict[int, Bytes]
"""Cache of decoded textures by the `id` of their image: many parts of a scene share a few textures."""


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
        raise ValueError("a face has indices of vertices that do not exist")
    return SampledSurface(vertices, faces, _colours(geometry, faces, pictures))


def _colours(geometry: Any, faces: Ints, pictures: _Pictures) -> ColourAt | None:
    """Return the function that looks up colours: from texture, material, vertices or faces; None without colours."""
    visual = geometry.visual
    if visual.kind == "texture":
        return _material_colours(visual, faces, pictures)
    if visual.kind == "vertex":
        return vertex_colours(np.asarray(visual.vertex_colors)[:, :3], faces)
    if visual.kind == "face":
        flat = np.asarray(visual.face_colors)[:, :3].astype(np.uint8)
        return lambda triangle, weights: flat[triangle]
    return None


def vertex_colours(rgb: Bytes, faces: Ints) -> ColourAt:
    """Return a function that interpolates vertex colours (V,3) uint8 over the triangles."""

    def colour_at(triangle: Ints, weights: Floats) -> Bytes:
        return rgb8(np.rint(np.einsum("nc,ncd->nd", weights, rgb[faces[triangle]])).astype(np.int16))

    return colour_at


def _material_colours(visual: Any, faces: Ints, pictures: _Pictures) -> ColourAt | None:
    """Return a function that samples the texture, times its factor, or else one colour for the whole material."""
    image, factor = _material(visual.material)
    uv = None if visual.uv is None else np.asarray(visual.uv, np.float64)
    if image is not None and uv is not None and factor is not None:
        check_pixels(image.size, "texture")
        if id(image) not in pictures:
            pictures[id(image)] = np.asarray(image.convert("RGB"))
        pixels = pictures[id(image)]

        def colour_at(triangle: Ints, weights: Floats) -> Bytes:
            texel = np.einsum("nc,ncd->nd", weights, uv[faces[triangle]])
            return np.rint(_nearest(pixels, texel) * factor).astype(np.uint8)

        return colour_at
    if factor is None:
        return None
    flat = np.rint(255 * factor).astype(np.uint8)
    return lambda triangle, weights: np.tile(flat, (len(triangle), 1))


def _material(material: Any) -> tuple[Any, Floats | None]:
    """Return the texture, if any, and the sRGB factor (3,) in [0,1] for it; no factor for an .obj without colours."""
    if hasattr(material, "baseColorTexture"):  # glTF: linear light
        factor = material.baseColorFactor
        linear = np.ones(3) if factor is None else np.asarray(factor, np.float64)[:3]
        return material.baseColorTexture, _srgb(linear / 255 if linear.max() > 1 else linear)
    # For a missing texture trimesh substitutes an image of its own, which has no path.
    image = material.image if "file_path" in getattr(material.image, "info", {}) else None
    diffuse = np.clip(np.asarray(material.kwargs["kd"], np.float64)[:3], 0, 1) if "kd" in material.kwargs else None
    return image, diffuse if image is None else np.ones(3)


def _srgb(linear: Floats) -> Floats:
    """Convert linear light to sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def _nearest(pixels: Bytes, uv: Floats) -> Bytes:
    """Look up the nearest texel at uv, with repeat wrapping; trimesh flips v, so 0 is the picture's lower edge."""
    height, width = pixels.shape[:2]
    u, v = np.nan_to_num(uv[:, 0]) % 1.0, 1.0 - np.nan_to_num(uv[:, 1]) % 1.0
    columns = np.minimum((u * width).astype(np.int64), width - 1)
    rows = np.clip((v * height).astype(np.int64), 0, height - 1)
    texels: Bytes = pixels[rows, columns]
    return texels
