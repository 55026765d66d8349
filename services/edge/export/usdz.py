"""Write a mesh as .usdz, which iOS opens in Quick Look: a USDA text file and its texture in an uncompressed zip.

By the package's specification the scene comes first, and every file begins at a multiple of 64 bytes. Quick Look does
not show vertex colours, so those of a `Mesh` become a texture.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np

import capture2vr
from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.export.colour_atlas import MOST_FACES, face_picture
from capture2vr.edge.export.shading import Shaded, shaded
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.simplify import simplify
from capture2vr.sentences.sentence import say

_SCENE, _PICTURE = "asset.usda", "colour.jpg"
_ALIGNMENT = 64  # bytes: programs map the files into memory as they lie
_FILLER = 0x1986  # kind of the zip's extra field that pads to the alignment: one that zip programs ignore
_DECIMALS = 4  # of positions in metres: a scan is less exact than 0.1 mm; small objects get ten thousand steps
_MOST_DECIMALS = 40  # a millionth of the smallest 32-bit float
_NORMAL_DECIMALS = 3  # 0.06°: finer than the 8 bits of a GLB
_UV_DECIMALS = 4  # a fifth of a texel of a texture of 2048²
_LARGEST = 3e38  # largest 32-bit float, which readers turn the text into
_NEUTRAL = " = (0.6, 0.6, 0.6)"  # linear light grey that shows shading both ways: a mesh without colours
_ROUGHNESS = 0.9  # as in the GLB: captured light already holds the real highlights


def to_phone_usdz(level: Mesh | TexturedMesh) -> bytes:
    """Encode a level of detail as `to_usdz` does; one with too many faces for a colour atlas is simplified first."""
    return to_usdz(simplify(level, MOST_FACES, binding=True) if isinstance(level, Mesh) else level)


def to_usdz(subject: Mesh | TexturedMesh) -> bytes:
    """Encode a mesh in the asset frame (metres, Y up) as .usdz; equal meshes give equal bytes.

    Degenerate triangles are left out. Meant for a level that phones can show (LOD1). Raises ValueError where no
    triangle with area is left, where a coordinate is not a 32-bit float, and where a coloured `Mesh` has too many faces
    for a colour atlas.
    """
    surface = _round_positions(shaded(_require_finite(subject)))
    colour = _base_colour(subject, surface)
    files = {_SCENE: _scene(surface, colour).encode("ascii")}
    if colour:
        files[_PICTURE] = colour.jpeg
    return _package(files)


@dataclass(frozen=True, slots=True)
class _BaseColour:
    """Texture of the base colour, with its texture coordinates.

    uv (n,2) float64 as in `TexturedMesh`: of each vertex, or of each corner of each face ("faceVarying").
    """

    jpeg: bytes
    uv: Floats
    interpolation: str


def _base_colour(subject: Mesh | TexturedMesh, surface: Shaded) -> _BaseColour | None:
    """The mesh's texture, or a colour atlas of its vertex colours; None where it has neither."""
    if isinstance(subject, TexturedMesh) and surface.uv is not None:
        return _BaseColour(subject.jpeg, surface.uv, "vertex")
    if surface.mesh.rgb is None:
        return None
    atlas = face_picture(surface.mesh)
    return _BaseColour(atlas.jpeg, atlas.uv.reshape(-1, 2), "faceVarying")


def _require_finite(subject: Mesh | TexturedMesh) -> Mesh | TexturedMesh:
    mesh = subject.mesh if isinstance(subject, TexturedMesh) else subject
    if not np.abs(mesh.vertices).max(initial=0.0) < _LARGEST:  # true for NaN too
        raise ValueError("a coordinate of the mesh is not a 32-bit float: it is not finite, or above 3e38")
    return subject


def _round_positions(surface: Shaded) -> Shaded:
    """Round positions to the decimals that are written, and drop faces that then have no area, with their vertices."""
    mesh = surface.mesh
    vertices = _round(mesh.vertices, _decimals(mesh.vertices))
    faces = mesh.faces[np.linalg.norm(face_normals(vertices, mesh.faces), axis=1) > 0]
    if len(faces) == 0:
        raise ValueError(say("none_triangles_has_area_nothing", count=len(mesh.faces)))
    used, corners = np.unique(faces, return_inverse=True)
    return replace(surface, mesh=replace(mesh, vertices=vertices)).with_vertices(used, corners.reshape(-1, 3))


def _decimals(vertices: Floats) -> int:
    """Decimals of positions: 4, and more for an object smaller than 1 m."""
    longest = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    wanted = np.ceil(_DECIMALS - np.log10(max(longest, 1e-300)))
    return int(np.clip(wanted, _DECIMALS, _MOST_DECIMALS))


def _round(numbers: Floats, decimals: int) -> Floats:
    rounded: Floats = np.round(numbers, decimals) + 0.0  # turns -0.0 into 0.0
    return rounded


def _scene(surface: Shaded, colour: _BaseColour | None) -> str:
    """The scene as USDA text."""
    mesh = surface.mesh
    extent = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    return f"""#usda 1.0
(
    customLayerData = {{
        string creator = "capture2vr {capture2vr.__version__}"
    }}
    defaultPrim = "Asset"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Asset" (
    kind = "component"
)
{{
    def Mesh "Surface" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        uniform token subdivisionScheme = "none"
        rel material:binding = </Asset/Material>
        float3[] extent = [{_tuples(extent)}]
        int[] faceVertexCounts = [{",".join("3" * len(mesh.faces))}]
        int[] faceVertexIndices = [{_integers(mesh.faces)}]
        point3f[] points = [{_tuples(mesh.vertices)}]
        normal3f[] normals = [{_tuples(_round(surface.normals, _NORMAL_DECIMALS))}] (
            interpolation = "vertex"
        )
{_texture_coordinates(colour) if colour else ""}    }}

    def Material "Material"
    {{
        token outputs:surface.connect = </Asset/Material/Shader.outputs:surface>

        def Shader "Shader"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor{_FROM_PICTURE if colour else _NEUTRAL}
            float inputs:metallic = 0
            float inputs:roughness = {_ROUGHNESS}
            token outputs:surface
        }}
{_TEXTURE if colour else ""}    }}
}}
"""


_FROM_PICTURE = ".connect = </Asset/Material/Picture.outputs:rgb>"
_TEXTURE = f"""
        def Shader "Picture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{_PICTURE}@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </Asset/Material/Place.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }}

        def Shader "Place"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
"""


def _texture_coordinates(colour: _BaseColour) -> str:
    upward = _round(np.stack([colour.uv[:, 0], 1 - colour.uv[:, 1]], axis=1), _UV_DECIMALS)  # v of USD runs up
    return f"""        texCoord2f[] primvars:st = [{_tuples(upward)}] (
            interpolation = "{colour.interpolation}"
        )
"""


def _tuples(rows: Floats) -> str:
    """Format rows (n,k) as "(1,2,3),(4,5,6)", with a single format string: a million numbers in half a second."""
    one = "(" + ",".join(["%.9g"] * rows.shape[1]) + ")"
    return ",".join([one] * len(rows)) % tuple(rows.ravel().tolist())


def _integers(numbers: Ints) -> str:
    return ",".join(map(str, numbers.ravel().tolist()))


def _package(files: Mapping[str, bytes]) -> bytes:
    """Zip files without compression, each aligned to _ALIGNMENT."""
    out = BytesIO()
    with ZipFile(out, "w", ZIP_STORED) as package:
        for name, content in files.items():
            entry = ZipInfo(name)  # its date is 1980, so that equal content gives equal bytes
            entry.create_system = 0  # the same on every machine
            begins = out.tell() + 30 + len(name) + 4  # the entry's header, its name, the filler's header
            filler = -begins % _ALIGNMENT
            entry.extra = struct.pack("<HH", _FILLER, filler) + b"\0" * filler
            package.writestr(entry, content)
    return out.getvalue()
