"""Write a mesh as binary PLY, for desktop tools: vertices, triangles and, where known, colours in sRGB
and the origin of what was not measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh

if TYPE_CHECKING:
    import trimesh

_TYPES = {"<f4": "float", "<f8": "double", "u1": "uchar"}


def ply_bytes(mesh: Mesh, *, offset: Floats | None = None) -> bytes:
    """Encode a mesh as little-endian binary PLY; positions become float32, in the mesh's frame.

    A mesh with an origin gets the property `origin`: 0 measured, 1 proposed, 2 filled, as `edge/origin.py`.
    offset (3,): added to all positions, which become float64, as those of surveys are large; None: none.
    """
    kind = "<f4" if offset is None else "<f8"
    fields = [("x", kind), ("y", kind), ("z", kind)]
    if mesh.rgb is not None:
        fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    if mesh.origin is not None:
        fields.append(("origin", "u1"))
    vertices = np.empty(len(mesh.vertices), dtype=fields)
    placed = mesh.vertices if offset is None else np.asarray(mesh.vertices, np.float64) + offset
    for name, column in zip("xyz", np.asarray(placed).T, strict=True):
        vertices[name] = column
    if mesh.rgb is not None:
        for name, column in zip(("red", "green", "blue"), np.asarray(mesh.rgb).T, strict=True):
            vertices[name] = column
    if mesh.origin is not None:
        vertices["origin"] = mesh.origin
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property {_TYPES[kind]} {name}" for name, kind in fields),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode("ascii") + vertices.tobytes() + faces.tobytes()


def write_ply(mesh: Mesh, path: Path) -> None:
    """Write `ply_bytes` to a file."""
    path.write_bytes(ply_bytes(mesh))


def stored_origin(mesh: trimesh.Trimesh) -> Bytes | None:
    """Return the origins (V,) that `ply_bytes` wrote of a mesh that trimesh read unprocessed; None without."""
    stored = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if getattr(stored, "dtype", None) is None or "origin" not in (stored.dtype.names or ()):
        return None
    origin: Bytes = np.array(stored["origin"], np.uint8).reshape(-1)
    return origin
