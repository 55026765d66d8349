"""Reads a .glb of any packing back into a mesh, by the extensions' own words."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

_TYPES = {5126: "<f4", 5120: "i1", 5123: "<u2", 5125: "<u4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass
class Glb:
    """A parsed file: the document, and its accessors as arrays."""

    document: dict[str, Any]
    binary: bytes

    @classmethod
    def of(cls, data: bytes) -> Glb:
        magic, version, total, length, kind = struct.unpack_from("<4sIIII", data)
        assert (magic, version, total, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
        return cls(json.loads(data[20 : 20 + length]), data[28 + length :])

    @property
    def primitive(self) -> dict[str, Any]:
        ((primitive,),) = (mesh["primitives"] for mesh in self.document["meshes"])
        return dict(primitive)

    def accessor(self, number: int) -> np.ndarray[Any, Any]:
        accessor = self.document["accessors"][number]
        view = self.document["bufferViews"][accessor["bufferView"]]
        width, kind = _WIDTHS[accessor["type"]], np.dtype(_TYPES[accessor["componentType"]])
        stride = view.get("byteStride", width * kind.itemsize)
        compressed = view.get("extensions", {}).get("EXT_meshopt_compression")
        content = _decoded(self.binary, compressed) if compressed else self.binary[view["byteOffset"] :]
        rows = np.frombuffer(content, kind, accessor["count"] * stride // kind.itemsize).reshape(accessor["count"], -1)
        return rows[:, :width] if width > 1 else rows.ravel()

    def attribute(self, name: str) -> np.ndarray[Any, Any]:
        return self.accessor(self.primitive["attributes"][name])

    @property
    def faces(self) -> np.ndarray[Any, Any]:
        return self.accessor(self.primitive["indices"]).reshape(-1, 3)

    @property
    def positions(self) -> np.ndarray[Any, Any]:
        """(V,3) metres: through the node's scale and translation."""
        (node,) = self.document["nodes"]
        scale, translation = node.get("scale", [1, 1, 1]), node.get("translation", [0, 0, 0])
        return self.attribute("POSITION") * np.array(scale, float) + np.array(translation, float)

    @property
    def uv(self) -> np.ndarray[Any, Any]:
        """(V,2) in [0,1]: whole numbers are normalised."""
        uv = self.attribute("TEXCOORD_0")
        return uv / 65535 if uv.dtype == np.uint16 else uv

    @property
    def image(self) -> bytes:
        """The file of the only picture."""
        (image,) = self.document["images"]
        view = self.document["bufferViews"][image["bufferView"]]
        return self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    @property
    def normals(self) -> np.ndarray[Any, Any]:
        """(V,3) of unit length, as a renderer makes them."""
        normals = self.attribute("NORMAL").astype(float)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _decoded(binary: bytes, how: dict[str, Any]) -> bytes:
    import meshoptimizer

    part = np.frombuffer(binary, np.uint8, how["byteLength"], how["byteOffset"])
    if how["mode"] == "TRIANGLES":
        indices = meshoptimizer.decode_index_buffer(how["count"], 4, part)
        return np.asarray(indices).astype({2: "<u2", 4: "<u4"}[how["byteStride"]]).tobytes()
    assert how["mode"] == "ATTRIBUTES"
    assert part[0] == 0xA0  # the version of the codec that the extension knows
    rows = np.asarray(meshoptimizer.decode_vertex_buffer(how["count"], how["byteStride"], part))
    rows = rows.view(np.uint8).reshape(how["count"], how["byteStride"])
    if how.get("filter") == "OCTAHEDRAL":
        return _octahedral(rows.view(np.int8)).tobytes()
    assert "filter" not in how
    return rows.tobytes()


def _octahedral(rows: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Appendix of EXT_meshopt_compression: x and y of the unfolded octahedron, z is what one is."""
    x, y, one = (rows[:, number].astype(float) for number in range(3))
    z = one - np.abs(x) - np.abs(y)
    under = np.maximum(-z, 0)
    x, y = x - np.where(x >= 0, under, -under), y - np.where(y >= 0, under, -under)
    xyz = np.stack([x, y, z], axis=1)
    xyz = np.rint(127 * xyz / np.linalg.norm(xyz, axis=1, keepdims=True))
    return np.concatenate([xyz, rows[:, 3:]], axis=1).astype(np.int8)
