"""The mesh that the extraction makes and everything after it reads."""

from __future__ import annotations

from dataclasses import dataclass

from services.edge.arrays import Bytes, Floats, Ints


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles, open or closed, orientable or not.

    vertices (V,3) float64; faces (F,3) int64 into them; rgb (V,3) uint8 sRGB or None. The frame is the holder's to say.
    """

    vertices: Floats
    faces: Ints
    rgb: Bytes | None = None
