"""Reads a .glb of any packing back into a mesh, by the extensions' own words."""

from __future__ import annotations

import json
import struct
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import meshopt
import numpy as np

_TYPES = {5126: "<f4", 5120: "i1", 5121: "u1", 5123: "<u2", 5125: "<u4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MESHOPT = "EXT_meshopt_compression"


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
        count = accessor["count"]
        rows = np.frombuffer(self._content(view), kind, count * stride // kind.itemsize).reshape(count, -1)
        return rows[:, :width] if width > 1 else rows[:, 0]

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
        """The file of the base colour."""
        return self.image_file(0)

    def image_file(self, number: int) -> bytes:
        """The file of one of the pictures."""
        image = self.document["images"][number]
        return self._content(self.document["bufferViews"][image["bufferView"]])

    @property
    def normals(self) -> np.ndarray[Any, Any]:
        """(V,3) of unit length, as a renderer makes them."""
        normals = self.attribute("NORMAL").astype(float)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def decompressed(self) -> bytes:
        """The same file without EXT_meshopt_compression: every view holds what a decoder makes of it."""
        document, binary = deepcopy(self.document), b""
        for view in document["bufferViews"]:
            content = self._content(view)
            view |= {"buffer": 0, "byteOffset": len(binary)}
            view.pop("extensions", None)
            assert view["byteLength"] == len(content)
            binary += content + bytes(-len(content) % 4)
        document["buffers"] = [{"byteLength": len(binary)}]
        for listed in (document["extensionsUsed"], document["extensionsRequired"]):
            listed.remove(_MESHOPT)
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
        return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary

    def _content(self, view: dict[str, Any]) -> bytes:
        compressed = view.get("extensions", {}).get(_MESHOPT)
        if compressed:
            return _decoded(self.binary, compressed)
        return self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def _decoded(binary: bytes, how: dict[str, Any]) -> bytes:
    """Of a compressed view what stands in it. The codecs are those whose version the extension knows."""
    part = binary[how["byteOffset"] : how["byteOffset"] + how["byteLength"]]
    assert part[0] == {"TRIANGLES": 0xE1, "ATTRIBUTES": 0xA0}[how["mode"]]
    rows = meshopt.decode_gltf_buffer(part, how["count"], how["byteStride"], how["mode"])
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
