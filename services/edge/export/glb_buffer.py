"""The binary chunk of a .glb and the tables that describe it, plain or compressed by meshoptimizer."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

import capture2vr
from capture2vr.edge.arrays import Floats
from capture2vr.edge.export import meshopt

_BYTE, _UBYTE = 5120, 5121  # component types
_VERTICES, _INDICES = 34962, 34963  # buffer view targets
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MESHOPT = "EXT_meshopt_compression"
_JSON, _BIN = 0x4E4F534A, 0x004E4942  # chunk types


def glb_document(primitive: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    """The glTF document of a scene of one node whose mesh has one primitive; the buffer's tables are not in it yet."""
    return {
        "asset": {"version": "2.0", "generator": f"capture2vr {capture2vr.__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [primitive]}],
    }


def glb_bytes(document: dict[str, Any], binary: bytes) -> bytes:
    """Encode a .glb from its glTF document and its binary chunk, which is of whole 32-bit words."""
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BIN) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def with_extras(glb: bytes, extras: dict[str, Any]) -> bytes:
    """Return a .glb with extras of the asset: what programs that do not know them leave alone."""
    (length,) = struct.unpack_from("<I", glb, 12)
    document = json.loads(glb[20 : 20 + length])
    document["asset"]["extras"] = extras
    return glb_bytes(document, glb[28 + length :])


class Buffer:
    """Binary chunk of a .glb: arrays one after the other, each aligned to a 32-bit word, with their tables."""

    extensions: list[str] = []  # noqa: RUF012 - nobody changes it

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(
        self, rows: NDArray[Any], shape: str, component: int, *, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append a vertex attribute (n,k), rows of whole 32-bit words; return the number of its accessor.

        shape  "VEC3" for example: how many numbers of a row are read
        """
        accessor: dict[str, Any] = {"componentType": component, "count": len(rows), "type": shape}
        if bounds:
            told = rows[:, : _WIDTHS[shape]]
            accessor |= {"min": told.min(axis=0).tolist(), "max": told.max(axis=0).tolist()}
        if normalized:
            accessor["normalized"] = True
        view = {"target": _VERTICES}
        if rows.shape[1] != _WIDTHS[shape]:
            view["byteStride"] = rows.strides[0]
        return self._append(accessor, view | self._stored_rows(rows))

    def add_bytes(self, numbers: NDArray[np.uint8]) -> int:
        """Append one byte (n,) a vertex, padded to a 32-bit word; return the number of its accessor."""
        rows = np.zeros((len(numbers), 4), np.uint8)
        rows[:, 0] = numbers
        return self.add(rows, "SCALAR", _UBYTE)

    def add_indices(self, indices: NDArray[Any], component: int) -> int:
        """Append the vertex indices of triangles (3F,); return the number of their accessor."""
        accessor = {"componentType": component, "count": len(indices), "type": "SCALAR"}
        return self._append(accessor, {"target": _INDICES} | self._stored_indices(indices))

    def add_file(self, content: bytes) -> int:
        """Append a whole file, as it is; return the number of its buffer view."""
        self._views.append({"buffer": 0, **self._written(content)})
        return len(self._views) - 1

    def tables(self) -> dict[str, Any]:
        """The glTF document's tables: buffers, buffer views and accessors."""
        return {"buffers": self._buffers(), "bufferViews": self._views, "accessors": self._accessors}

    def _append(self, accessor: dict[str, Any], view: dict[str, Any]) -> int:
        self._accessors.append({"bufferView": len(self._views), **accessor})
        self._views.append(view)
        return len(self._accessors) - 1

    def _stored_rows(self, rows: NDArray[Any]) -> dict[str, Any]:
        return {"buffer": 0, **self._written(rows.tobytes())}

    def _stored_indices(self, indices: NDArray[Any]) -> dict[str, Any]:
        return self._stored_rows(indices)

    def _buffers(self) -> list[dict[str, Any]]:
        return [{"byteLength": len(self.data)}]

    def _written(self, content: bytes) -> dict[str, int]:
        place = {"byteOffset": len(self.data), "byteLength": len(content)}
        self.data += content
        self.data += b"\0" * (-len(self.data) % 4)  # the next array must start on a word
        return place


class CompressedBuffer(Buffer):
    """Buffer whose arrays are compressed by meshoptimizer. Views point into a second buffer, which is not in the file:
    the decoder fills it."""

    extensions = [_MESHOPT]  # noqa: RUF012 - nobody changes it

    def __init__(self) -> None:
        super().__init__()
        self._unpacked = 0

    def add_normals(self, normals: Floats) -> int:
        """Append unit normals (n,3), 8 bits a number."""
        return self._add_octahedral(meshopt.octahedral(normals), "VEC3")

    def add_tangents(self, tangents: Floats) -> int:
        """Append tangents (n,4), 8 bits a number: unit vectors, and the sign of the bitangent."""
        rows = meshopt.octahedral(tangents[:, :3])
        rows[:, 3] = np.where(tangents[:, 3] < 0, -127, 127)
        return self._add_octahedral(rows, "VEC4")

    def _add_octahedral(self, rows: NDArray[Any], shape: str) -> int:
        """Append directions (n,4) that `meshopt.octahedral` has encoded."""
        number = self.add(rows, shape, _BYTE, normalized=True)
        self._views[-1]["extensions"][_MESHOPT]["filter"] = "OCTAHEDRAL"
        return number

    def _stored_rows(self, rows: NDArray[Any]) -> dict[str, Any]:
        return self._compressed(rows, meshopt.encoded_rows(rows), "ATTRIBUTES")

    def _stored_indices(self, indices: NDArray[Any]) -> dict[str, Any]:
        return self._compressed(indices, meshopt.encoded_indices(indices), "TRIANGLES")

    def _compressed(self, rows: NDArray[Any], content: bytes, mode: str) -> dict[str, Any]:
        row = {"byteStride": rows.strides[0], "count": len(rows), "mode": mode}
        view = {
            "buffer": 1,
            "byteOffset": self._unpacked,
            "byteLength": rows.nbytes,
            "extensions": {_MESHOPT: {"buffer": 0, **self._written(content), **row}},
        }
        self._unpacked += rows.nbytes + -rows.nbytes % 4
        return view

    def _buffers(self) -> list[dict[str, Any]]:
        nowhere = {"byteLength": self._unpacked, "extensions": {_MESHOPT: {"fallback": True}}}
        return [*super()._buffers(), nowhere]
