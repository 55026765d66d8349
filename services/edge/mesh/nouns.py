"""The mesh types that the extraction makes and all later stages use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, pick
from capture2vr.errors import BadInput

if TYPE_CHECKING:  # other programs' types, which only those who ask for them have to load
    import open3d
    import trimesh


@dataclass(frozen=True, slots=True)
class Mesh:
    """A triangle mesh, open or closed, orientable or not.

    vertices (V,3) float64; faces (F,3) int64 into them; rgb (V,3) uint8 sRGB or None; origin (V,) uint8, as
    `edge/origin.py`, or None where all is measured or not told yet. The frame depends on the stage.
    """

    vertices: Floats
    faces: Ints
    rgb: Bytes | None = None
    origin: Bytes | None = None

    def with_vertices(self, which: Bools | Ints, faces: Ints) -> Mesh:
        """Copy with a selection of vertices (a mask, or indices in the new order), and `faces` (F,3) over them."""
        return Mesh(self.vertices[which], faces, pick(self.rgb, which), pick(self.origin, which))

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert to a mesh of trimesh, which writes GLB, PLY, OBJ and STL: `mesh.to_trimesh().export("mesh.glb")`.

        Same vertices and units; colours become vertex colours (V,4) uint8.

        >>> triangle = Mesh(np.eye(3), np.array([[0, 1, 2]]))
        >>> round(float(triangle.to_trimesh().area), 3)
        0.866
        """
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, vertex_colors=self.rgb, process=False)

    def to_open3d(self) -> open3d.geometry.TriangleMesh:
        """Convert to a triangle mesh of Open3D; colours become floats (V,3) in [0,1]. Raises BadInput without Open3D.

        >>> Mesh(np.eye(3), np.array([[0, 1, 2]])).to_open3d()  # doctest: +SKIP
        TriangleMesh with 3 points and 1 triangles.
        """
        try:
            import open3d
        except ImportError:
            raise BadInput("Open3D is not installed: pip install open3d") from None
        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(self.vertices), open3d.utility.Vector3iVector(self.faces)
        )
        if self.rgb is not None:
            mesh.vertex_colors = open3d.utility.Vector3dVector(self.rgb / 255)
        return mesh


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
