"""Write Gaussian splats as .glb with the extension KHR_gaussian_splatting, as ratified: scales are linear.

Programs that do not know the extension show a cloud of coloured points.
"""

from __future__ import annotations

from typing import Any

from capture2vr.edge.export.glb_buffer import Buffer, glb_bytes, glb_document
from capture2vr.edge.export.glb_colour import TRUE, rgba16
from capture2vr.edge.splats.surface_splats import Splats

_EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _USHORT = 5126, 5123  # component types, by OpenGL's numbers
_POINTS = 0  # mode of a primitive
_HARMONIC = 0.28209479177387814  # of degree 0


def to_splat_glb(splats: Splats) -> bytes:
    """Encode splats as .glb: metres, Y up, colours in sRGB as a display shows them."""
    buffer = Buffer()
    harmonics = (splats.rgb / 255 - 0.5) / _HARMONIC
    attributes = {
        "POSITION": buffer.add(splats.xyz.astype("<f4"), "VEC3", _FLOAT, bounds=True),
        "COLOR_0": buffer.add(rgba16(splats.rgb, TRUE), "VEC4", _USHORT, normalized=True),
        f"{_EXTENSION}:ROTATION": buffer.add(splats.rotation.astype("<f4"), "VEC4", _FLOAT),
        f"{_EXTENSION}:SCALE": buffer.add(splats.scale.astype("<f4"), "VEC3", _FLOAT),
        f"{_EXTENSION}:OPACITY": buffer.add(splats.opacity.astype("<f4")[:, None], "SCALAR", _FLOAT),
        f"{_EXTENSION}:SH_DEGREE_0_COEF_0": buffer.add(harmonics.astype("<f4"), "VEC3", _FLOAT),
    }
    kernel = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive: dict[str, Any] = {"attributes": attributes, "mode": _POINTS, "extensions": {_EXTENSION: kernel}}
    document = glb_document(primitive, {"mesh": 0}) | buffer.tables() | {"extensionsUsed": [_EXTENSION]}
    return glb_bytes(document, bytes(buffer.data))
