"""The capture's points in other formats: PLY, COLMAP's text."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints, pick
from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.origin import told

_GREY = 128  # sRGB, of points without colours where a format must have some


@dataclass(frozen=True, slots=True)
class CapturePoints:
    """Points as the bundle has them: xyz (N,3) metres, Z up; rgb (N,3) uint8 sRGB or None; origin (N,) uint8, as
    `edge/origin.py`, or None where all are measured."""

    xyz: Floats
    rgb: Bytes | None
    origin: Bytes | None = None

    @classmethod
    def read(cls, laz: bytes) -> CapturePoints:
        """Read the bundle's file. Raises ValueError."""
        import laspy

        try:
            las = laspy.read(BytesIO(laz))
        except Exception as error:  # laspy and its decoder raise many kinds
            raise ValueError(f"the points cannot be read: {error}") from error
        rgb = None
        if "red" in las.point_format.dimension_names:
            rgb = (np.stack([las.red, las.green, las.blue], axis=1) >> 8).astype(np.uint8)
        return cls(np.asarray(las.xyz, np.float64), rgb, told(np.asarray(las.user_data, np.uint8)))

    def at_most(self, count: int) -> CapturePoints:
        """Return every n-th point: the bundle's are in the order of a grid, so they stay evenly spread."""
        step = -(-len(self.xyz) // count)
        every: Ints = np.arange(0, len(self.xyz), step)
        return CapturePoints(self.xyz[every], pick(self.rgb, every), pick(self.origin, every))

    def ply(self) -> bytes:
        """Encode as binary PLY without triangles."""
        nothing: Ints = np.zeros((0, 3), np.int64)
        return ply_bytes(Mesh(self.xyz, nothing, self.rgb, self.origin))

    def colmap_text(self) -> str:
        """Format the points as COLMAP's points3D.txt: id, position, colour and error per line, without tracks."""
        rgb = np.full((len(self.xyz), 3), _GREY, np.uint8) if self.rgb is None else self.rgb
        numbered = np.arange(1, len(self.xyz) + 1)
        rows = np.column_stack([numbered, self.xyz, rgb]).ravel().tolist()
        return "%d %.6f %.6f %.6f %d %d %d 0\n" * len(self.xyz) % tuple(rows)
