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


@dataclass(frozen=True, slots=True)
class Textured:
    """A mesh whose colours are a picture.

    mesh   vertices doubled along the seams of the unwrapping; its rgb is None
    uv     (V,2) float64 in [0,1], as in glTF: (0,0) is the upper left corner of the picture
    jpeg   the base colour, sRGB; side: its pixels along each side
    ktx2   the same as the .glb has it instead, with mips; None: it has the JPEG
    """

    mesh: Mesh
    uv: Floats
    jpeg: bytes
    side: int
    ktx2: bytes | None = None
