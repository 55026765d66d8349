"""Write a mesh as binary glTF 2.0: one mesh, one primitive, one double-sided material, hence one draw call.

Written here rather than by trimesh, whose exporter leaves vertex colours in sRGB, which glTF reads as linear light (the
asset then looks washed out), and stores them in 8 bits, which bands in the shadows once they are linear.

Two packings of the same mesh:
    float    positions and normals as 32-bit floats: for programs that support no extension
    meshopt  a quarter of the bytes or less: whole numbers on a grid of at most 0.1 mm and normals of 8 bits
             (KHR_mesh_quantization), ordered and compressed (EXT_meshopt_compression)
A texture is embedded as JPEG, or as KTX2 where there is one (KHR_texture_basisu), a normal map as JPEG.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.export import meshopt
from capture2vr.edge.export.glb_buffer import Buffer, CompressedBuffer, glb_bytes, glb_document
from capture2vr.edge.export.glb_colour import SHORT, TRUE, rgba16
from capture2vr.edge.export.shading import Shaded, shaded, with_tangents
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.sentences.sentence import say

Packing = Literal["float", "meshopt"]

ORIGIN = "_ORIGIN"
"""Vertex attribute of a mesh not all of which was measured: 0 measured, 1 proposed, 2 filled, as `edge/origin.py`."""

KTX2 = "image/ktx2"
"""Media type of a KTX2 image; all others are JPEG."""

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125  # component types, by OpenGL's numbers
_LINEAR, _TRILINEAR, _CLAMP = 9729, 9987, 33071  # a sampler's filters, the second with mips, and its edge
_UNLIT, _BASISU = "KHR_materials_unlit", "KHR_texture_basisu"
_NEUTRAL = 0.6  # linear base colour without captured colours: light grey that shows shading both ways
_ROUGHNESS = 0.9  # cloth, wood, skin: hardly a highlight, as captured light already holds the real ones
_STEP_M = 1e-4  # of the grid of positions: less than a scan can tell
_BITS = (12, 16)  # fewest and most of a position


def to_glb(
    asset: Mesh | TexturedMesh, packing: Packing = "float", *, unlit: bool = False, common_step_m: float = 0.0
) -> bytes:
    """Encode a mesh in the asset frame (metres, Y up) as .glb, with vertex colours or with its texture.

    unlit          whether colours are shown as they were captured, whatever the light of the scene
                   (KHR_materials_unlit)
    common_step_m  step of the grid that positions are rounded to, or of a power of two times it where the mesh is too
                   large: that of all tiles of a scene, so that neighbours still meet at the vertices of their border;
                   0: the mesh has a grid of its own

    Degenerate triangles and unused vertices are left out. Raises ValueError where no triangle with area is left.
    """
    drawn = _kept(_Drawn.of(asset, unlit))
    return _floats(drawn) if packing == "float" else _compressed(drawn, common_step_m)


@dataclass(frozen=True, slots=True)
class _Drawn:
    """What goes into the file: a surface, and its texture and normal map where it has them.

    ktx2  whether the texture is KTX2 rather than JPEG
    """

    surface: Shaded
    picture: bytes | None
    normals: bytes | None
    ktx2: bool
    unlit: bool

    @classmethod
    def of(cls, asset: Mesh | TexturedMesh, unlit: bool) -> _Drawn:
        if isinstance(asset, Mesh):
            return cls(shaded(asset), None, None, False, unlit)
        surface = with_tangents(shaded(asset)) if asset.normals else shaded(asset)
        return cls(surface, asset.ktx2 or asset.jpeg, asset.normals, asset.ktx2 is not None, unlit)

    @property
    def mesh(self) -> Mesh:
        return self.surface.mesh

    def with_vertices(self, which: Bools | Ints, faces: Ints) -> _Drawn:
        """Select vertices, in this order, with faces over them."""
        return replace(self, surface=self.surface.with_vertices(which, faces))

    def with_positions(self, vertices: NDArray[Any]) -> _Drawn:
        """Return a copy of the surface with other vertex positions."""
        return replace(self, surface=replace(self.surface, mesh=replace(self.mesh, vertices=vertices)))


def _kept(drawn: _Drawn) -> _Drawn:
    """Round positions to float32, and drop faces that then have no area."""
    return _drawable(drawn.with_positions(drawn.mesh.vertices.astype("<f4")))


def _floats(drawn: _Drawn) -> bytes:
    buffer = Buffer()
    attributes = {
        "POSITION": buffer.add(drawn.mesh.vertices, "VEC3", _FLOAT, bounds=True),
        "NORMAL": buffer.add(drawn.surface.normals.astype("<f4"), "VEC3", _FLOAT),
    }
    if drawn.surface.uv is not None:
        attributes["TEXCOORD_0"] = buffer.add(drawn.surface.uv.astype("<f4"), "VEC2", _FLOAT)
    if drawn.surface.tangents is not None:
        attributes["TANGENT"] = buffer.add(drawn.surface.tangents.astype("<f4"), "VEC4", _FLOAT)
    return _file(drawn, TRUE, buffer, attributes, {"mesh": 0})


def _compressed(drawn: _Drawn, common_step_m: float) -> bytes:
    vertices = drawn.mesh.vertices.astype(np.float64)
    grid = _Grid.common(vertices, common_step_m) if common_step_m else _Grid.of(vertices)
    drawn = _drawable(drawn.with_positions(grid.whole(drawn.mesh.vertices)))
    faces, was = meshopt.sent_order(drawn.mesh.faces)
    drawn = drawn.with_vertices(was, faces)
    buffer = CompressedBuffer()
    attributes = {
        "POSITION": buffer.add(_padded(drawn.mesh.vertices, np.uint16), "VEC3", _USHORT, bounds=True),
        "NORMAL": buffer.add_normals(drawn.surface.normals),
    }
    if drawn.surface.uv is not None:
        whole = np.rint(drawn.surface.uv * 65535).astype("<u2")
        attributes["TEXCOORD_0"] = buffer.add(whole, "VEC2", _USHORT, normalized=True)
    if drawn.surface.tangents is not None:
        attributes["TANGENT"] = buffer.add_tangents(drawn.surface.tangents)
    return _file(drawn, SHORT, buffer, attributes, {"mesh": 0, **grid.node()})


def _file(
    drawn: _Drawn, light: NDArray[np.uint16], buffer: Buffer, attributes: dict[str, int], node: dict[str, Any]
) -> bytes:
    """Write the file from its buffer. light (256,): the linear light of every sRGB byte."""
    mesh = drawn.mesh
    if mesh.rgb is not None:
        attributes["COLOR_0"] = buffer.add(rgba16(mesh.rgb, light), "VEC4", _USHORT, normalized=True)
    if mesh.origin is not None:
        attributes[ORIGIN] = buffer.add_bytes(mesh.origin)
    # 65535 itself is the primitive restart value and may not be an index.
    kind, component = (np.uint16, _USHORT) if len(mesh.vertices) <= 65535 else (np.uint32, _UINT)
    indices = buffer.add_indices(mesh.faces.astype(kind).ravel(), component)
    files = [buffer.add_file(each) for each in (drawn.picture, drawn.normals) if each is not None]
    pictured = _pictures(files, ktx2=drawn.ktx2) if files else {}
    primitive = {"attributes": attributes, "indices": indices, "material": 0}
    document = glb_document(primitive, node) | {"materials": [_material(drawn)]} | pictured | buffer.tables()
    needed = ["KHR_mesh_quantization"] * ("scale" in node) + buffer.extensions + [_BASISU] * drawn.ktx2
    used = needed + [_UNLIT] * drawn.unlit
    document |= ({"extensionsUsed": used} if used else {}) | ({"extensionsRequired": needed} if needed else {})
    return glb_bytes(document, bytes(buffer.data))


def _material(drawn: _Drawn) -> dict[str, Any]:
    base = _NEUTRAL if drawn.mesh.rgb is None and drawn.picture is None else 1.0
    surface: dict[str, Any] = {"baseColorFactor": [base, base, base, 1.0]}
    if drawn.picture is not None:
        surface["baseColorTexture"] = {"index": 0}
    surface |= {"metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    unlit: dict[str, Any] = {"extensions": {_UNLIT: {}}} if drawn.unlit else {}
    bumps: dict[str, Any] = {} if drawn.normals is None else {"normalTexture": {"index": 1}}
    return {"doubleSided": True, "pbrMetallicRoughness": surface} | bumps | unlit


def _pictures(views: list[int], *, ktx2: bool) -> dict[str, Any]:
    """The textures in buffer views, base colour first: with mips, and not repeated, since charts touch their edges."""
    sampler = {"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}
    kinds = [KTX2 if ktx2 and number == 0 else "image/jpeg" for number in range(len(views))]
    sources: list[dict[str, Any]] = [
        {"extensions": {_BASISU: {"source": number}}} if kind == KTX2 else {"source": number}
        for number, kind in enumerate(kinds)
    ]
    return {
        "images": [{"bufferView": view, "mimeType": kind} for view, kind in zip(views, kinds, strict=True)],
        "samplers": [sampler],
        "textures": [{"sampler": 0, **source} for source in sources],
    }


@dataclass(frozen=True, slots=True)
class _Grid:
    """Quantisation grid of positions: xyz = step · (least + whole), with one step for all axes, so that normals stay.

    least  (3,) whole numbers: the grid goes through the origin
    """

    least: Floats
    step: float

    @classmethod
    def of(cls, vertices: Floats) -> _Grid:
        """The coarsest grid whose step is at most 0.1 mm, with 2^12 to 2^16 places along the longest side."""
        side = float(np.ptp(vertices, axis=0).max())
        fewest, most = _BITS
        bits = next((bits for bits in range(fewest, most) if side / _places(bits) <= _STEP_M), most)
        return cls._through(vertices, max(side / _places(bits), 1e-30))

    @classmethod
    def common(cls, vertices: Floats, step: float) -> _Grid:
        """The grid of that step for all meshes of up to 65,533 steps, and of 2, 4, 8 … times the step for larger ones.

        Of two such grids, the finer one has all places of the other.
        """
        needed = float(np.ptp(vertices, axis=0).max()) / _places(_BITS[1])
        return cls._through(vertices, step * 2.0 ** max(0, math.ceil(math.log2(max(needed, 1e-30) / step))))

    @classmethod
    def _through(cls, vertices: Floats, step: float) -> _Grid:
        return cls(np.floor(vertices.min(axis=0) / step), step)

    def whole(self, vertices: Floats) -> NDArray[np.int64]:
        """Places (V,3), 0 to 65535. A position comes out the same from all grids of its step."""
        places: NDArray[np.int64] = (np.rint(vertices / self.step) - self.least).clip(0, 65535).astype(np.int64)
        return places

    def node(self) -> dict[str, Any]:
        return {"translation": (self.step * self.least).tolist(), "scale": [self.step] * 3}


def _places(bits: int) -> int:
    """Steps along a side that fit into so many bits, with two to spare for rounding at its ends."""
    return (1 << bits) - 3


def _drawable(drawn: _Drawn) -> _Drawn:
    """Drop faces that have no area after rounding, and unused vertices. Raises ValueError where no face is left."""
    mesh = drawn.mesh
    area = np.linalg.norm(face_normals(mesh.vertices.astype(np.float64), mesh.faces), axis=1)
    faces = mesh.faces[area > 0]
    if len(faces) == 0:
        raise ValueError(say("none_triangles_has_area_nothing", count=len(mesh.faces)))
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    return drawn.with_vertices(used, (np.cumsum(used) - 1)[faces])


def _padded(rows: NDArray[Any], kind: type[np.generic]) -> NDArray[Any]:
    """Pad rows (n,3) to (n,4), so that they fill whole 32-bit words; readers ignore the last number."""
    padded = np.zeros((len(rows), 4), kind)
    padded[:, :3] = rows
    return padded
