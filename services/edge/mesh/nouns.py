"""The mesh types that the extraction makes and all later stages use."""

from __future__ import annotations

from dataclasses import dataclass

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, pick


@dataclass(frozen=True, slots=True)
class Mesh:
    """A triangle mesh, open or closed, orientable or not.

    vertices (V,3) float64; faces (F,3) int64 into them; rgb (V,3) uint8 sRGB or None. The frame depends on the stage.
    """

    vertices: Floats
    faces: Ints
    rgb: Bytes | None = None

    def with_vertices(self, which: Bools | Ints, faces: Ints) -> Mesh:
        """Copy with a selection of vertices (a mask, or indices in the new order), and `faces` (F,3) over them."""
        return Mesh(self.vertices[which], faces, pick(self.rgb, which))


@dataclass(frozen=True, slots=True)
class TexturedMesh:
    """A mesh with a colour texture.

    mesh     vertices doubled along the seams of the unwrapping; its rgb is None
    uv       (V,2) float64 in [0,1], as in glTF: (0,0) is the upper left corner of the picture
    jpeg     the base colour, sRGB; side: its pixels along each side
    ktx2     the same picture with mips, which replaces the JPEG in the .glb; None: the .glb has the JPEG
    normals  normal map as JPEG, in glTF's frame of tangents; None: it is lit by its vertices' normals alone
    """

    mesh: Mesh
    uv: Floats
    jpeg: bytes
    side: int
    ktx2: bytes | None = None
    normals: bytes | None = None
