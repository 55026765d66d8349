"""The binary chunk of a .glb and the tables that describe it, plain or compressed by meshoptimizer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats
from services.edge.mesh import meshopt

_BYTE = 5120  # component type
_VERTICES, _INDICES = 34962, 34963  # buffer view targets
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MESHOPT = "EXT_meshopt_compression"


class Buffer:
    """Arrays behind each other, each from a whole word on."""

    extensions: list[str] = []  # noqa: RUF012 - nobody changes it

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(
        self, rows: NDArray[Any], shape: str, component: int, *, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append vertices (n,k), rows of whole words of which `shape` tells how many numbers count; the accessor."""
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

    def add_normals(self, normals: Floats) -> int:
        """Append unit normals (n,3), 8 bits a number."""
        rows = np.zeros((len(normals), 4), np.int8)
        rows[:, :3] = np.rint(127 * normals)
        return self.add(rows, "VEC3", _BYTE, normalized=True)

    def add_indices(self, indices: NDArray[Any], component: int, vertices: int) -> int:
        """Append the corners of triangles (3F,) over so many vertices."""
        accessor = {"componentType": component, "count": len(indices), "type": "SCALAR"}
        return self._append(accessor, {"target": _INDICES} | self._stored_indices(indices, vertices))

    def add_file(self, content: bytes) -> int:
        """Append a whole file, as it is; the buffer view."""
        self._views.append({"buffer": 0, **self._written(content)})
        return len(self._views) - 1

    def tables(self) -> dict[str, Any]:
        """What the document holds of it."""
        return {"buffers": self._buffers(), "bufferViews": self._views, "accessors": self._accessors}

    def _append(self, accessor: dict[str, Any], view: dict[str, Any]) -> int:
        self._accessors.append({"bufferView": len(self._views), **accessor})
        self._views.append(view)
        return len(self._accessors) - 1

    def _stored_rows(self, rows: NDArray[Any]) -> dict[str, Any]:
        return {"buffer": 0, **self._written(rows.tobytes())}

    def _stored_indices(self, indices: NDArray[Any], vertices: int) -> dict[str, Any]:
        return self._stored_rows(indices)

    def _buffers(self) -> list[dict[str, Any]]:
        return [{"byteLength": len(self.data)}]

    def _written(self, content: bytes) -> dict[str, int]:
        place = {"byteOffset": len(self.data), "byteLength": len(content)}
        self.data += content
        self.data += b"\0" * (-len(self.data) % 4)  # the next array must start on a word
        return place


class CompressedBuffer(Buffer):
    """The same arrays, each compressed. Views point into a second buffer that no file holds: what a decoder makes."""

    extensions = [_MESHOPT]  # noqa: RUF012 - nobody changes it

    def __init__(self) -> None:
        super().__init__()
        self._unpacked = 0

    def add_normals(self, normals: Floats) -> int:
        number = self.add(meshopt.octahedral(normals), "VEC3", _BYTE, normalized=True)
        self._views[-1]["extensions"][_MESHOPT]["filter"] = "OCTAHEDRAL"
        return number

    def _stored_rows(self, rows: NDArray[Any]) -> dict[str, Any]:
        return self._compressed(rows, meshopt.encoded_rows(rows), "ATTRIBUTES")

    def _stored_indices(self, indices: NDArray[Any], vertices: int) -> dict[str, Any]:
        return self._compressed(indices, meshopt.encoded_indices(indices, vertices), "TRIANGLES")

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
