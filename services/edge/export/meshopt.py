"""meshoptimizer's encoder: the order in which a mesh is best sent and drawn, and its bytes for EXT_meshopt_compression.

An extra that needs a C++ compiler: where `available()` says no, files are sent without it.
"""

from __future__ import annotations

from ctypes import POINTER, c_float, c_int, c_size_t, c_void_p
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats, Ints

_CODEC = 0  # of the vertices: the one that EXT_meshopt_compression knows
_INDEX_CODEC = 1
_OCTAHEDRAL_BITS = 8  # of a normal: off by 0.4 degrees at most


@cache
def available() -> bool:
    """Whether the library is there and loads."""
    try:
        import meshoptimizer  # noqa: F401 - asked only whether it is there and loads
    except (ImportError, OSError):
        return False
    return True


def sent_order(faces: Ints, vertices: int) -> tuple[Ints, Ints]:
    """Faces (F,3) of so many vertices, all used -> the faces in the order of the cache, over vertices in the order of
    their first use, and (V,) which vertex each of these was."""
    import meshoptimizer

    indices = np.ascontiguousarray(faces, np.uint32).ravel()
    ordered, place = np.empty_like(indices), np.empty(vertices, np.uint32)
    meshoptimizer.optimize_vertex_cache(ordered, indices, len(indices), vertices)
    # The alpha declares no C types for this call: plain ints would pass as 32 bits where it reads 64.
    meshoptimizer.optimize_vertex_fetch_remap(place, ordered, c_size_t(len(indices)), c_size_t(vertices))
    was = np.empty(vertices, np.int64)
    was[place] = np.arange(vertices)
    return place[ordered].reshape(-1, 3).astype(np.int64), was


def encoded_rows(rows: NDArray[Any]) -> bytes:
    """Mode ATTRIBUTES: an array (n,k) whose rows are whole words."""
    import meshoptimizer

    meshoptimizer.encode_vertex_version(_CODEC)
    encoded: bytes = meshoptimizer.encode_vertex_buffer(rows)
    return encoded


def encoded_indices(indices: NDArray[Any], vertices: int) -> bytes:
    """Mode TRIANGLES: corners (3F,), best in `sent_order`."""
    import meshoptimizer

    meshoptimizer.encode_index_version(_INDEX_CODEC)
    encoded: bytes = meshoptimizer.encode_index_buffer(indices, len(indices), vertices)
    return encoded


def octahedral(normals: Floats) -> NDArray[np.int8]:
    """(n,3) unit normals -> (n,4) for the filter OCTAHEDRAL: two numbers of eight bits tell a direction."""
    from meshoptimizer._loader import lib  # the package wraps the filter's decoder alone

    padded = np.zeros((len(normals), 4), np.float32)
    padded[:, :3] = normals
    out = np.empty((len(normals), 4), np.int8)
    lib.meshopt_encodeFilterOct(
        out.ctypes.data_as(c_void_p),
        c_size_t(len(normals)),
        c_size_t(out.strides[0]),
        c_int(_OCTAHEDRAL_BITS),
        padded.ctypes.data_as(POINTER(c_float)),
    )
    return out
