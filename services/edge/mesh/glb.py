"""A mesh as binary glTF 2.0: one mesh, one primitive, one double-sided material, hence one draw call.

Written here rather than by trimesh, whose exporter leaves vertex colours in sRGB, which glTF reads as linear light (the
asset then looks washed out), and stores them in 8 bits, which bands in the shadows once they are linear.

Three ways to pack the same mesh:
    float      positions and normals as 32-bit floats: for programs that know no extension
    quantised  KHR_mesh_quantization: whole numbers on a grid of at most 0.1 mm, normals of 8 bits
    meshopt    the same, ordered and compressed (EXT_meshopt_compression): a quarter of the bytes
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import services
from services.edge.arrays import Bools, Bytes, Floats
from services.edge.mesh import meshopt
from services.edge.mesh.glb_buffer import Buffer, CompressedBuffer
from services.edge.mesh.normals import face_normals, split_flips, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.srgb import to_linear

Packing = Literal["float", "quantised", "meshopt"]

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125  # component types, by OpenGL's numbers
_JSON, _BIN = 0x4E4F534A, 0x004E4942  # chunk types
_NEUTRAL = 0.6  # linear base colour without captured colours: light grey that shows shading both ways
_ROUGHNESS = 0.9  # cloth, wood, skin: hardly a highlight, as captured light already holds the real ones
_STEP_M = 1e-4  # of the grid of positions: less than a scan can tell
_BITS = (12, 16)  # fewest and most of a position
_KEPT = 0.8  # of the way to where the next colour begins: reading back gives the same


def best_packing() -> Packing:
    """The smallest that can be written here."""
    return "meshopt" if meshopt.available() else "quantised"


def to_glb(mesh: Mesh, packing: Packing = "float") -> bytes:
    """A mesh in the asset frame (metres, Y up) as one .glb file.

    Degenerate triangles and unused vertices are left out. Raises ValueError where no triangle with area is left.
    """
    mesh = split_flips(mesh)
    mesh, _ = _drawable(_with_vertices(mesh, mesh.vertices.astype("<f4")))
    normals = vertex_normals(_with_vertices(mesh, mesh.vertices.astype(np.float64)))
    if packing == "float":
        return _floats(mesh, normals)
    return _quantised(mesh, normals, compressed=packing == "meshopt")


def _with_vertices(mesh: Mesh, vertices: NDArray[Any]) -> Mesh:
    return Mesh(vertices, mesh.faces, mesh.rgb)


def _floats(mesh: Mesh, normals: Floats) -> bytes:
    buffer = Buffer()
    attributes = {
        "POSITION": buffer.add(mesh.vertices, "VEC3", _FLOAT, bounds=True),
        "NORMAL": buffer.add(normals.astype("<f4"), "VEC3", _FLOAT),
    }
    return _file(mesh, _TRUE, buffer, attributes, {"mesh": 0})


def _quantised(mesh: Mesh, normals: Floats, *, compressed: bool) -> bytes:
    grid = _Grid.of(mesh.vertices.astype(np.float64))
    mesh, used = _drawable(_with_vertices(mesh, grid.whole(mesh.vertices)))
    normals = normals[used]
    if compressed:
        faces, was = meshopt.sent_order(mesh.faces, len(mesh.vertices))
        mesh = Mesh(mesh.vertices[was], faces, None if mesh.rgb is None else mesh.rgb[was])
        normals = normals[was]
    buffer = CompressedBuffer() if compressed else Buffer()
    attributes = {
        "POSITION": buffer.add(_padded(mesh.vertices, np.uint16), "VEC3", _USHORT, bounds=True),
        "NORMAL": buffer.add_normals(normals),
    }
    return _file(mesh, _SHORT, buffer, attributes, {"mesh": 0, **grid.node()})


def _file(
    mesh: Mesh, light: NDArray[np.uint16], buffer: Buffer, attributes: dict[str, int], node: dict[str, Any]
) -> bytes:
    """light (256,): the linear light of every sRGB code."""
    if mesh.rgb is not None:
        attributes["COLOR_0"] = buffer.add(_rgba16(mesh.rgb, light), "VEC4", _USHORT, normalized=True)
    # 65535 itself is the primitive restart value and may not be an index.
    kind, component = (np.uint16, _USHORT) if len(mesh.vertices) <= 65535 else (np.uint32, _UINT)
    indices = buffer.add_indices(mesh.faces.astype(kind).ravel(), component, len(mesh.vertices))
    document = _document(attributes, indices, node, coloured=mesh.rgb is not None) | buffer.tables()
    used = ["KHR_mesh_quantization"] * ("scale" in node) + buffer.extensions
    if used:
        document |= {"extensionsUsed": used, "extensionsRequired": used}
    return _container(document, bytes(buffer.data))


def _document(attributes: dict[str, int], indices: int, node: dict[str, Any], *, coloured: bool) -> dict[str, Any]:
    base = 1.0 if coloured else _NEUTRAL
    surface = {"baseColorFactor": [base, base, base, 1.0], "metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    return {
        "asset": {"version": "2.0", "generator": f"capture2vr {services.__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{"doubleSided": True, "pbrMetallicRoughness": surface}],
    }


@dataclass(frozen=True, slots=True)
class _Grid:
    """Whole numbers for positions: xyz = corner + step · whole, the same step along all axes, so that normals stay."""

    corner: Floats
    step: float

    @classmethod
    def of(cls, vertices: Floats) -> _Grid:
        """The coarsest grid that is fine enough, of 2^12 to 2^16 places along the longest side."""
        corner, side = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
        fewest, most = _BITS
        bits = next((bits for bits in range(fewest, most) if side / (2**bits - 1) <= _STEP_M), most)
        return cls(corner.astype(np.float32).astype(np.float64), max(side / (2**bits - 1), 1e-30))

    def whole(self, vertices: Floats) -> NDArray[np.int64]:
        return np.rint((vertices - self.corner) / self.step).clip(0, 65535).astype(np.int64)

    def node(self) -> dict[str, Any]:
        return {"translation": self.corner.tolist(), "scale": [self.step] * 3}


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BIN) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _drawable(mesh: Mesh) -> tuple[Mesh, Bools]:
    """Only faces that still have an area after rounding, and (V,) the vertices that they use and keep."""
    area = np.linalg.norm(face_normals(mesh.vertices.astype(np.float64), mesh.faces), axis=1)
    faces = mesh.faces[area > 0]
    if len(faces) == 0:
        raise ValueError(f"none of the {len(mesh.faces)} triangles has an area: there is nothing to show")
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    rgb = None if mesh.rgb is None else mesh.rgb[used]
    return Mesh(mesh.vertices[used], (np.cumsum(used) - 1)[faces], rgb), used


def _padded(rows: NDArray[Any], kind: type[np.generic]) -> NDArray[Any]:
    """(n,3) -> (n,4): rows of whole words, the last number unread."""
    padded = np.zeros((len(rows), 4), kind)
    padded[:, :3] = rows
    return padded


def _rgba16(rgb: Bytes, light: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(V,4) linear light and alpha 1 in 16 bits: RGB alone would not fill whole words."""
    rgba = np.full((len(rgb), 4), 65535, dtype="<u2")
    rgba[:, :3] = light[rgb]
    return rgba


def _shortest() -> NDArray[np.uint16]:
    """(256,) for every sRGB code the number that ends in the most zeros of those that mean it: bytes of zeros take no
    space, and 8 bits of linear light would band in the shadows."""
    own = to_linear(np.arange(256, dtype=np.uint8)) * 65535.0
    half = _KEPT / 2 * np.diff(own)
    low, high = own.copy(), own.copy()
    low[1:] -= half
    high[:-1] += half
    chosen = own.round().astype(np.uint16)
    for zeros in range(1, 16):
        step = float(1 << zeros)
        number = np.round(own / step) * step
        means = (number >= low) & (number <= np.minimum(high, 65535))
        chosen[means] = number[means]
    return chosen


_TRUE = np.rint(to_linear(np.arange(256, dtype=np.uint8)) * 65535.0).astype(np.uint16)
_SHORT = _shortest()
