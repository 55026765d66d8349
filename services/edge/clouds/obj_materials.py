"""Read Wavefront MTL files, and look up the colours of an OBJ: of textures, vertices and materials.

A texture's name may follow options (`map_Kd -s 2 2 -clamp on wood.jpg`), and is often a path of the machine that wrote
the file: a file of that name is then looked for in the capture. Nothing outside the capture is opened.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.colour_profile import rgb_of
from capture2vr.edge.capture.exr import EXR_MAGIC, decode_exr_colours, exr_size
from capture2vr.edge.capture.files import Folder, read_text, translate_errors
from capture2vr.edge.capture.images import check_header, check_pixels, header_size, read_bytes
from capture2vr.edge.clouds.surface_colours import nearest_texels, vertex_colours

_OPTION = re.compile(
    r"-(?:[ost]|mm)(?P<values>(?:\s+[-+]?[.\d][-+.\deE]*){1,3})\s+(?=\S)"
    r"|-(?:blendu|blendv|bm|boost|cc|clamp|imfchan|texres|type)\s+\S+\s+(?=\S)",
    re.IGNORECASE,
)
"""An option of a texture, with the space behind it: at least its name must follow."""


_REMARK = re.compile(r"\s#(?:\s.*)?$", re.DOTALL)


def without_remark(text: str) -> str:
    """Return what a line says, without the remark behind it: of "Material #25" the number is a part of the name."""
    return _REMARK.sub("", text.strip()).strip()


@dataclass(frozen=True, slots=True)
class Material:
    """A material of an MTL file.

    diffuse        RGB, linear or not as its writer meant it, 0 to 1; None: the file does not say
    texture        name of the diffuse texture's file in the capture, or None
    absent         the texture as the file names it, where the capture has no such file; else ""
    scale, offset  of texture coordinates: a texel is looked up at scale · uv + offset
    """

    diffuse: tuple[float, float, float] | None = None
    texture: str | None = None
    absent: str = ""
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


def read_mtl(folder: Folder, file: str, used: Collection[str]) -> dict[str, Material]:
    """Read those materials of an MTL file that are used, by their names; each texture is looked up once.

    Raises CAPTURE_UNREADABLE for a texture outside the capture that is not in the capture either.
    """
    materials: dict[str, Material] = {}
    textures: dict[str, str] = {}  # what is written behind a material's last `map_Kd`
    name = None
    for line in read_text(folder.path(file), file).splitlines():
        words = line.split(None, 1)
        if len(words) < 2:
            continue
        key, rest = words[0].lower(), without_remark(words[1])
        if key == "newmtl":
            name = rest if rest in used else None
            if name is not None:
                materials[name] = Material()
                textures.pop(name, None)
        elif name is not None and key == "kd" and (diffuse := _colour(rest)) is not None:
            materials[name] = replace(materials[name], diffuse=diffuse)
        elif name is not None and key == "map_kd":
            textures[name] = rest
    return materials | {name: _textured(materials[name], rest, folder, file) for name, rest in textures.items()}


def _textured(material: Material, rest: str, folder: Folder, file: str) -> Material:
    """Return the material with the texture that is named after `map_Kd` and its options."""
    scale, offset = material.scale, material.offset
    at = 0  # not the rest of the text again and again: a line of a million options would be copied as often
    while (option := _OPTION.match(rest, at)) is not None:
        at = option.end()
        values = (option["values"] or "").split()
        if option[0].startswith(("-s", "-S")):
            scale = _pair(values, 1.0)
        elif option[0].startswith(("-o", "-O")):
            offset = _pair(values, 0.0)
    written = rest[at:]
    found = folder.find(written, by=file)
    return replace(material, texture=found, absent="" if found else written, scale=scale, offset=offset)


def _pair(values: list[str], default: float) -> tuple[float, float]:
    u, v = (*(float(value) for value in values), default, default)[:2]
    return u, v


def _colour(rest: str) -> tuple[float, float, float] | None:
    """Read `r g b`, or `r` for a grey; None for a spectrum or nonsense."""
    words = rest.split(None, 3)
    numbers = [number for word in words[:3] if (number := _number(word)) is not None]
    if len(numbers) == 3:
        return numbers[0], numbers[1], numbers[2]
    return (numbers[0],) * 3 if len(numbers) == 1 and len(words) == 1 else None


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


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


def texture_size(folder: Folder, name: str) -> tuple[int, int]:
    """Return a texture's (width, height) from its header, (1, 1) where only its decoder can tell.

    Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE."""
    data = read_bytes(folder.path(name), name)
    if data.startswith(EXR_MAGIC):
        return exr_size(data, name)
    check_header(data, name)
    return header_size(data) or (1, 1)


def _diffuse(material: Material) -> Bytes:
    """RGB of a material's colour; white where it has a texture, whose coordinates are missing, or no colour."""
    if material.texture or material.diffuse is None:
        return np.full(3, 255, np.uint8)
    rgb: Bytes = np.rint(255 * np.clip(np.nan_to_num(np.array(material.diffuse)), 0, 1)).astype(np.uint8)
    return rgb


def _decode(folder: Folder, name: str) -> Bytes:
    """Decode a texture to (H,W,3) uint8."""
    from PIL import Image

    data = read_bytes(folder.path(name), name)
    if data.startswith(EXR_MAGIC):
        return decode_exr_colours(data, name)
    with translate_errors(name, "picture"), Image.open(BytesIO(data)) as image:
        check_pixels(image.size, name)
        return rgb_of(image)
