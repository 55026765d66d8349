"""Compress meshes with meshoptimizer: reorder faces and vertices, and encode them for EXT_meshopt_compression."""

from __future__ import annotations

from typing import Any

import meshopt
import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Ints

_VERTEX_CODEC = 0  # the version that EXT_meshopt_compression has; later ones are of KHR_meshopt_compression
_OCTAHEDRAL_BITS = 8  # of a normal: off by 0.4 degrees at most


def sent_order(faces: Ints) -> tuple[Ints, Ints]:
    """Order faces (F,3) for the vertex cache, and vertices by their first use; every vertex must be used.

    Returns the faces over the reordered vertices, and (V,) the old index of each vertex.
    """
    indices = np.ascontiguousarray(faces, np.uint32).ravel()
    ordered, place, _ = meshopt.reorder_mesh(indices, triangles=True, optsize=False)
    return ordered.reshape(-1, 3).astype(np.int64), np.argsort(place)


def encoded_rows(rows: NDArray[Any]) -> bytes:
    """Encode a vertex attribute (n,k), whose rows are whole 32-bit words, in mode ATTRIBUTES."""
    encoded: bytes = meshopt.encode_gltf_buffer(rows, "ATTRIBUTES", version=_VERTEX_CODEC)
    return encoded


def encoded_indices(indices: NDArray[Any]) -> bytes:
    """Encode the vertex indices (3F,) of triangles, of 16 or 32 bits, in mode TRIANGLES; shortest in `sent_order`."""
    encoded: bytes = meshopt.encode_gltf_buffer(indices, "TRIANGLES")
    return encoded


def octahedral(normals: Floats) -> NDArray[np.int8]:
    """Encode unit normals (n,3) as (n,4) int8 for the filter OCTAHEDRAL: two numbers of eight bits give a direction."""
    padded = np.zeros((len(normals), 4), np.float32)
    padded[:, :3] = normals
    rows: NDArray[np.int8] = meshopt.encode_filter_oct(padded, stride=4, bits=_OCTAHEDRAL_BITS).view(np.int8)
    return rows
