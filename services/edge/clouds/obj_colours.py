"""Look up the colours of points on an OBJ's triangles: of textures, vertices and materials."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.colour_profile import rgb_of
from capture2vr.edge.capture.files import Folder, translate_errors
from capture2vr.edge.capture.images import check_pixels, read_bytes
from capture2vr.edge.clouds.mtl import Material
from capture2vr.edge.clouds.surface_colours import nearest_texels, vertex_colours


@dataclass(frozen=True, slots=True)
class ObjColours:
    """The colours of an OBJ's triangles: of the texture, or else of the vertices, or else of the material.

    A material beside vertex colours is a writer's default: it is taken only where all vertices are white.
    """

    folder: Folder
    materials: list[Material]
    material: Ints  # (F,), of each triangle
    uv: Floats  # (T,2)
    uv_faces: Ints  # (F,3)
    faces: Ints  # (F,3)
    rgb: Bytes | None  # (V,3), of the vertices

    @property
    def there(self) -> bool:
        """Whether any vertex, material or texture has colours."""
        return self._painted or any(each.texture or each.diffuse for each in self.materials)

    @property
    def _painted(self) -> bool:
        return self.rgb is not None and bool((self.rgb < 255).any())

    def colour_at(self, triangle: Ints, weights: Floats) -> Bytes:
        """Colours (N,3) uint8 of points in `triangle` (N,) with barycentric `weights` (N,3); white without any."""
        material = self.material[triangle]
        if self.rgb is not None and self._painted:
            rgb = vertex_colours(self.rgb, self.faces)(triangle, weights)
        else:
            rgb = np.stack([_diffuse(each) for each in self.materials])[material]
        mapped = (self.uv_faces[triangle] >= 0).all(axis=1)
        for name in sorted({each.texture for each in self.materials if each.texture}):
            here = [number for number, each in enumerate(self.materials) if each.texture == name]
            at = np.flatnonzero(mapped & np.isin(material, here))
            if len(at):
                uv = np.einsum("nc,ncd->nd", weights[at], self.uv[self.uv_faces[triangle[at]]])
                scale = np.array([each.scale for each in self.materials])[material[at]]
                offset = np.array([each.offset for each in self.materials])[material[at]]
                rgb[at] = nearest_texels(_decode(self.folder, name), uv * scale + offset)
        return rgb


def _diffuse(material: Material) -> Bytes:
    """RGB of a material's colour; white where it has a texture, whose coordinates are missing, or no colour."""
    if material.texture or material.diffuse is None:
        return np.full(3, 255, np.uint8)
    rgb: Bytes = np.rint(255 * np.clip(np.nan_to_num(np.array(material.diffuse)), 0, 1)).astype(np.uint8)
    return rgb


def _decode(folder: Folder, name: str) -> Bytes:
    """Decode a texture to (H,W,3) uint8."""
    from PIL import Image

    with translate_errors(name, "picture"), Image.open(BytesIO(read_bytes(folder.path(name), name))) as image:
        check_pixels(image.size, name)
        return rgb_of(image)
