"""Look up the colours of points on a glTF's triangles, and where its surface is: elsewhere its alpha cuts it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.colour_profile import rgb_of
from capture2vr.edge.capture.files import translate_errors
from capture2vr.edge.capture.images import check_header
from capture2vr.edge.clouds.gltf import GltfFile
from capture2vr.edge.clouds.gltf_scene import Primitive
from capture2vr.edge.clouds.sample_surface import SampledSurface
from capture2vr.edge.clouds.surface_colours import TexturePixels, texels_at
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.sentences.sentence import say

_TRANSFORM = "KHR_texture_transform"
_GLOSS = "KHR_materials_pbrSpecularGlossiness"
_CLAMP, _MIRROR = 33071, 33648  # wrap modes of samplers; any other repeats
_LEAST = {"MASK": 0.5, "BLEND": 0.02}  # alpha of what is there, by the alphaMode; a car's windows have .04


class _Picture:
    """A picture that is decoded when it is looked at: by then all pictures were counted."""

    def __init__(self, image: Any, name: str) -> None:
        self._image, self._name = image, name

    @cached_property
    def rgb(self) -> Bytes:
        with translate_errors(self._name, "picture"):
            return rgb_of(self._image)

    @property
    def has_alpha(self) -> bool:
        return bool(self._image.has_transparency_data)

    @cached_property
    def alpha(self) -> Bytes:
        with translate_errors(self._name, "picture"):
            return np.asarray(self._image.convert("RGBA"))[..., 3]


@dataclass(frozen=True, slots=True)
class _Texture:
    """A picture, its set of texture coordinates, how those are changed, and how it repeats along u and v."""

    picture: _Picture
    coordinates: int
    transform: Mapping[str, Any]
    wraps: tuple[int, int]

    def uv(self, primitive: Primitive) -> Floats | None:
        """Return the coordinates (V,2) of a primitive's vertices; None where it has none.

        KHR_texture_transform scales, then rotates, then moves them: counter-clockwise where v runs down, as in the
        picture. The extension's GLSL turns the other way, its example and the viewers do not.
        """
        given = primitive.attribute(f"TEXCOORD_{self.coordinates}")
        if given is None or not self.transform:
            return given
        scale = np.asarray(self.transform.get("scale", (1, 1)), np.float64).reshape(2)
        offset = np.asarray(self.transform.get("offset", (0, 0)), np.float64).reshape(2)
        turn = float(self.transform.get("rotation", 0))
        c, s = np.cos(turn), np.sin(turn)
        with np.errstate(over="ignore", invalid="ignore"):
            moved: Floats = (given[:, :2] * scale) @ np.array([[c, -s], [s, c]]) + offset
        return moved


@dataclass(frozen=True, slots=True)
class _Sheet:
    """A texture at the coordinates (V,2) of a primitive's vertices."""

    texture: _Texture
    uv: Floats

    def look_up(self, pixels: Bytes, corners: Ints, weights: Floats) -> Bytes:
        """Return the nearest texels of points on triangles of these corners (N,3), with barycentric weights (N,3)."""
        with np.errstate(over="ignore", invalid="ignore"):
            uv = np.nan_to_num(np.einsum("nc,ncd->nd", weights, self.uv[corners]))
        x, y = (_wrapped(along, wrap) for along, wrap in zip(uv.T, self.texture.wraps, strict=True))
        return texels_at(pixels, x, y)


@dataclass(frozen=True, slots=True)
class _Shading:
    """The colours of a primitive's triangles: texture times factor times vertex colours, as linear light.

    light: (V,3 or 4) of the vertices, with alpha or without; mask: what has the alpha; least: alpha of what is there
    """

    faces: Ints
    factor: Floats
    light: Floats | None
    paint: _Sheet | None
    mask: _Sheet | None
    least: float

    def colour_at(self, triangle: Ints, weights: Floats) -> Bytes:
        """Return the colours (N,3) of points; the triangles of several instances come one after another."""
        corners = self.faces[triangle % len(self.faces)]
        shade = np.tile(self.factor[:3], (len(corners), 1))
        if self.light is not None:
            shade *= np.einsum("nc,ncd->nd", weights, self.light[corners, :3])
        if self.paint is not None:
            shade *= to_linear(self.paint.look_up(self.paint.texture.picture.rgb, corners, weights))
        return to_srgb(shade)

    @property
    def is_cut(self) -> bool:
        """Whether the surface may be cut out anywhere."""
        has_light = self.light is not None and self.light.shape[1] > 3
        return self.factor[3] < self.least or (self.least > 0 and (has_light or self.mask is not None))

    def is_there(self, triangle: Ints, weights: Floats) -> NDArray[np.bool_]:
        """Return whether the surface is there at points, and not cut out by its alpha."""
        corners = self.faces[triangle % len(self.faces)]
        alpha = np.full(len(corners), self.factor[3])
        if self.light is not None and self.light.shape[1] > 3:
            alpha *= np.einsum("nc,nc->n", weights, self.light[corners, 3])
        if self.mask is not None:
            alpha *= self.mask.look_up(self.mask.texture.picture.alpha, corners, weights) / 255
        return alpha >= self.least


class GltfMaterials:
    """Gives the primitives of a glTF their colours. Every picture is opened once, however many textures list it."""

    def __init__(self, gltf: GltfFile) -> None:
        self._gltf, self._pixels = gltf, TexturePixels(gltf.file)
        self._pictures: dict[object, _Picture | None] = {}

    def surface(self, primitive: Primitive) -> SampledSurface:
        """Return the surface of a primitive, with colours where it has a material or vertex colours.

        Raises IMAGE_TOO_LARGE, CAPTURE_TOO_LARGE and CAPTURE_UNREADABLE.
        """
        vertices, faces = primitive.vertices, primitive.placed_faces
        light = _vertex_light(primitive)
        if light is None and "material" not in primitive.tree:
            return SampledSurface(vertices, faces)
        material = self._gltf.entry("materials", primitive.tree["material"]) if "material" in primitive.tree else {}
        factor, paint, mask = self._base(material)
        mode = material.get("alphaMode", "OPAQUE")
        least = _LEAST.get(mode, 0.0) if mode != "MASK" else float(material.get("alphaCutoff", _LEAST[mode]))
        masked = mask is not None and least > 0 and mask.picture.has_alpha
        shading = _Shading(
            primitive.faces,
            factor,
            light,
            _sheet(paint, primitive),
            _sheet(mask, primitive) if masked else None,
            least,
        )
        return SampledSurface(vertices, faces, shading.colour_at, shading.is_there if shading.is_cut else None)

    def point_light(self, primitive: Primitive) -> Floats | None:
        """Return the light (N,3) of a primitive of points with vertex colours, None of another one."""
        light = _vertex_light(primitive)
        if light is None or "material" not in primitive.tree:
            return None if light is None else light[:, :3]
        factor, _, _ = self._base(self._gltf.entry("materials", primitive.tree["material"]))
        return light[:, :3] * factor[:3]

    def _base(self, material: Mapping[str, Any]) -> tuple[Floats, _Texture | None, _Texture | None]:
        """Return a material's factor (4,) of linear light, its texture of colours, and that of alpha.

        Of an older material (specular and glossiness) that is the diffuse colour; of one that is black and shines by
        itself, the colour that it shines in.
        """
        gloss = material.get("extensions", {}).get(_GLOSS)
        given = material.get("pbrMetallicRoughness", {}) if gloss is None else gloss
        factor = np.ones(4)
        rgba = given.get("baseColorFactor" if gloss is None else "diffuseFactor", ())
        factor[: len(rgba)] = rgba
        base = self._texture(given.get("baseColorTexture" if gloss is None else "diffuseTexture"))
        shines = material.get("emissiveFactor", ())
        if any(shines) and not any(factor[:3]):
            factor[:3] = shines
            return factor, self._texture(material.get("emissiveTexture")), base
        return factor, base, base

    def _texture(self, given: Mapping[str, Any] | None) -> _Texture | None:
        """Return a texture that a material names; None without one, or without its picture."""
        if given is None:
            return None
        listed = self._gltf.entry("textures", given["index"])
        source = listed.get("extensions", {}).get("EXT_texture_webp", {}).get("source", listed.get("source"))
        picture = None if source is None else self._picture(self._gltf.entry("images", source))
        if picture is None:
            return None
        sampler = self._gltf.entry("samplers", listed["sampler"]) if "sampler" in listed else {}
        transform = given.get("extensions", {}).get(_TRANSFORM, {})
        coordinates = int(transform.get("texCoord", given.get("texCoord", 0)))
        return _Texture(picture, coordinates, transform, (sampler.get("wrapS", 0), sampler.get("wrapT", 0)))

    def _picture(self, image: Mapping[str, Any]) -> _Picture | None:
        from PIL import Image

        key = image.get("bufferView", image.get("uri"))
        if key not in self._pictures:
            self._pictures[key] = None
            data = self._gltf.content(image["uri"]) if "uri" in image else bytes(self._gltf.view(key))
            if data is not None:
                name = self._gltf.file if "uri" not in image or key.startswith("data:") else key
                check_header(data, name)
                with translate_errors(name, "picture"):
                    opened = Image.open(BytesIO(data))
                self._pixels.add(opened.size)
                self._pictures[key] = _Picture(opened, name)
        return self._pictures[key]


def _vertex_light(primitive: Primitive) -> Floats | None:
    """Return linear light (V,3 or 4) in [0,1] of COLOR_0, whose integers are always fractions; None without any."""
    light = primitive.attribute("COLOR_0", fractions=True)
    if light is None:
        return None
    if light.shape[1] < 3:
        raise ValueError(say("vertex_colours_have_fewer_than"))
    return np.clip(np.nan_to_num(light), 0, 1)


def _sheet(texture: _Texture | None, primitive: Primitive) -> _Sheet | None:
    """Lay a texture on a primitive; None without one, or without texture coordinates."""
    uv = None if texture is None else texture.uv(primitive)
    return None if texture is None or uv is None else _Sheet(texture, uv[:, :2])


def _wrapped(along: Floats, wrap: int) -> Floats:
    """Return the places in [0,1] of a picture that coordinates along one of its sides mean."""
    if wrap == _CLAMP:
        return np.clip(along, 0, 1)
    return 1 - np.abs(along % 2 - 1) if wrap == _MIRROR else along % 1
