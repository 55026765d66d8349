"""A mesh as binary glTF 2.0: one mesh, one primitive, one double-sided material, hence one draw call.

Written here rather than by trimesh, whose exporter leaves vertex colours in sRGB, which glTF reads as linear light (the
asset then looks washed out), and stores them in 8 bits, which bands in the shadows once they are linear.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import services
from services.edge.arrays import Bytes, Floats
from services.edge.mesh.normals import face_normals, split_flips, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.srgb import to_linear

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125  # component types, by OpenGL's numbers
_VERTICES, _INDICES = 34962, 34963  # buffer view targets
_JSON, _BIN = 0x4E4F534A, 0x004E4942  # chunk types
_NEUTRAL = 0.6  # linear base colour without captured colours: light grey that shows shading both ways
_ROUGHNESS = 0.9  # cloth, wood, skin: hardly a highlight, as captured light already holds the real ones


def to_glb(mesh: Mesh) -> bytes:
    """A mesh in the asset frame (metres, Y up) as one .glb file.

    Degenerate triangles and unused vertices are left out. Raises ValueError where no triangle with area is left.
    """
    mesh = _drawable(mesh)
    buffer = _Buffer()
    attributes = {
        "POSITION": buffer.add(mesh.vertices, "VEC3", _FLOAT, _VERTICES, bounds=True),
        "NORMAL": buffer.add(_unit32(vertex_normals(_doubles(mesh))), "VEC3", _FLOAT, _VERTICES),
    }
    if mesh.rgb is not None:
        attributes["COLOR_0"] = buffer.add(_rgba16(mesh.rgb), "VEC4", _USHORT, _VERTICES, normalized=True)
    # 65535 itself is the primitive restart value and may not be an index.
    kind, component = (np.uint16, _USHORT) if len(mesh.vertices) <= 65535 else (np.uint32, _UINT)
    indices = buffer.add(mesh.faces.astype(kind).ravel(), "SCALAR", component, _INDICES)
    document = _document(attributes, indices, coloured=mesh.rgb is not None) | buffer.tables()
    return _container(document, bytes(buffer.data))


def _document(attributes: dict[str, int], indices: int, *, coloured: bool) -> dict[str, Any]:
    base = 1.0 if coloured else _NEUTRAL
    surface = {"baseColorFactor": [base, base, base, 1.0], "metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    return {
        "asset": {"version": "2.0", "generator": f"capture2vr {services.__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{"doubleSided": True, "pbrMetallicRoughness": surface}],
    }


@dataclass(slots=True)
class _Buffer:
    """The binary chunk and the two tables that describe it."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(
        self,
        array: NDArray[Any],
        shape: str,
        component: int,
        target: int,
        *,
        bounds: bool = False,
        normalized: bool = False,
    ) -> int:
        """Append an array with elements of whole 4-byte words; return its accessor's number."""
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": component,
            "count": len(array),
            "type": shape,
        }
        if bounds:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        if normalized:
            accessor["normalized"] = True
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes, "target": target}
        self.data += array.tobytes()
        self.data += b"\0" * (-len(self.data) % 4)  # the next accessor must start on a word
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def tables(self) -> dict[str, Any]:
        return {
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
        }


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BIN) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _drawable(mesh: Mesh) -> Mesh:
    """float32 positions, flipped seams split, only faces that still have an area at that precision."""
    mesh = split_flips(mesh)
    vertices = mesh.vertices.astype("<f4")
    area = np.linalg.norm(face_normals(vertices.astype(np.float64), mesh.faces), axis=1)
    faces = mesh.faces[area > 0]
    if len(faces) == 0:
        raise ValueError(f"none of the {len(mesh.faces)} triangles has an area: there is nothing to show")
    used, corners = np.unique(faces, return_inverse=True)
    rgb = None if mesh.rgb is None else mesh.rgb[used]
    return Mesh(vertices[used], corners.reshape(-1, 3), rgb)


def _doubles(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices.astype(np.float64), mesh.faces)


def _unit32(normals: Floats) -> Floats:
    rounded: Floats = normals.astype("<f4")
    return rounded


def _rgba16(rgb: Bytes) -> NDArray[np.uint16]:
    """(V,4) linear light and alpha 1 in 16 bits: RGB alone would not fill whole words."""
    rgba = np.full((len(rgb), 4), 65535, dtype="<u2")
    rgba[:, :3] = np.rint(to_linear(rgb) * 65535.0)
    return rgba
