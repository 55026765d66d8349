"""A mesh as .usdz, what iOS opens in Quick Look: a plain USDA and its picture in a zip that compresses nothing.

As the specification of the package wants it, the scene comes first and every file begins at a multiple of 64 bytes.
Quick Look shows no colours of vertices, so those of a `Mesh` become a picture too.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np

import services
from services.edge.arrays import Floats, Ints
from services.edge.mesh.blocks import face_picture
from services.edge.mesh.normals import face_normals
from services.edge.mesh.nouns import Mesh, Textured
from services.edge.mesh.shaded import Shaded, shaded

_SCENE, _PICTURE = "asset.usda", "colour.jpg"
_ALIGNMENT = 64  # bytes: programs map the files into memory as they lie
_FILLER = 0x1986  # kind of the extra field before a file: one that no zip program knows
_DECIMALS = 4  # of positions in metres: 0.1 mm is less than a scan can tell; small things get ten thousand steps
_MOST_DECIMALS = 40  # a millionth of the smallest 32-bit float
_NORMAL_DECIMALS = 3  # 0.06°: finer than the 8 bits of a GLB
_UV_DECIMALS = 4  # a fifth of a texel of 2048
_LARGEST = 3e38  # of 32-bit floats, which readers make of the text
_NEUTRAL = " = (0.6, 0.6, 0.6)"  # linear light grey that shows shading both ways: a mesh without colours
_ROUGHNESS = 0.9  # as in the GLB: captured light already holds the real highlights


def to_usdz(subject: Mesh | Textured) -> bytes:
    """A mesh in the asset frame (metres, Y up) as one .usdz file; equal meshes give equal bytes.

    Degenerate triangles are left out. A level for phones is meant (LOD1). Raises ValueError where no triangle with area
    is left, where a coordinate is no 32-bit float, and where a coloured `Mesh` has more faces than a picture holds.
    """
    surface = _rounded(shaded(_checked(subject)))
    look = _look(subject, surface)
    files = {_SCENE: _scene(surface, look).encode("ascii")}
    if look:
        files[_PICTURE] = look.jpeg
    return _package(files)


@dataclass(frozen=True, slots=True)
class _Look:
    """The base colour and where it goes.

    uv (n,2) float64 as in `Textured`: of each vertex, or of each corner of each face ("faceVarying").
    """

    jpeg: bytes
    uv: Floats
    interpolation: str


def _look(subject: Mesh | Textured, surface: Shaded) -> _Look | None:
    if isinstance(subject, Textured) and surface.uv is not None:
        return _Look(subject.jpeg, surface.uv, "vertex")
    if surface.mesh.rgb is None:
        return None
    painted = face_picture(surface.mesh)
    return _Look(painted.jpeg, painted.uv.reshape(-1, 2), "faceVarying")


def _checked(subject: Mesh | Textured) -> Mesh | Textured:
    mesh = subject.mesh if isinstance(subject, Textured) else subject
    if not np.abs(mesh.vertices).max(initial=0.0) < _LARGEST:  # NaN is not less either
        raise ValueError("a coordinate of the mesh is no 32-bit float: not a number, infinite or above 3e38")
    return subject


def _rounded(surface: Shaded) -> Shaded:
    """Only faces that still have an area once coordinates are as short as they are written, and what they use."""
    mesh = surface.mesh
    vertices = _short(mesh.vertices, _decimals(mesh.vertices))
    faces = mesh.faces[np.linalg.norm(face_normals(vertices, mesh.faces), axis=1) > 0]
    if len(faces) == 0:
        raise ValueError(f"none of the {len(mesh.faces)} triangles has an area: there is nothing to show")
    used, corners = np.unique(faces, return_inverse=True)
    rgb = None if mesh.rgb is None else mesh.rgb[used]
    uv = None if surface.uv is None else surface.uv[used]
    return Shaded(Mesh(vertices[used], corners.reshape(-1, 3), rgb), surface.normals[used], uv)


def _decimals(vertices: Floats) -> int:
    longest = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    wanted = np.ceil(_DECIMALS - np.log10(max(longest, 1e-300)))
    return int(np.clip(wanted, _DECIMALS, _MOST_DECIMALS))


def _short(numbers: Floats, decimals: int) -> Floats:
    rounded: Floats = np.round(numbers, decimals) + 0.0  # no minus before a zero
    return rounded


def _scene(surface: Shaded, look: _Look | None) -> str:
    """The stage as USDA."""
    mesh = surface.mesh
    extent = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    return f"""#usda 1.0
(
    customLayerData = {{
        string creator = "capture2vr {services.__version__}"
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
        normal3f[] normals = [{_tuples(_short(surface.normals, _NORMAL_DECIMALS))}] (
            interpolation = "vertex"
        )
{_places(look) if look else ""}    }}

    def Material "Material"
    {{
        token outputs:surface.connect = </Asset/Material/Shader.outputs:surface>

        def Shader "Shader"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor{_FROM_PICTURE if look else _NEUTRAL}
            float inputs:metallic = 0
            float inputs:roughness = {_ROUGHNESS}
            token outputs:surface
        }}
{_TEXTURE if look else ""}    }}
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


def _places(look: _Look) -> str:
    upward = _short(np.stack([look.uv[:, 0], 1 - look.uv[:, 1]], axis=1), _UV_DECIMALS)  # v of USD runs up
    return f"""        texCoord2f[] primvars:st = [{_tuples(upward)}] (
            interpolation = "{look.interpolation}"
        )
"""


def _tuples(rows: Floats) -> str:
    """(n,k) -> "(1,2,3),(4,5,6)". One format for all, filled in at once: a million numbers in half a second."""
    one = "(" + ",".join(["%.9g"] * rows.shape[1]) + ")"
    return ",".join([one] * len(rows)) % tuple(rows.ravel().tolist())


def _integers(numbers: Ints) -> str:
    return ",".join(map(str, numbers.ravel().tolist()))


def _package(files: Mapping[str, bytes]) -> bytes:
    out = BytesIO()
    with ZipFile(out, "w", ZIP_STORED) as package:
        for name, content in files.items():
            entry = ZipInfo(name)  # dated 1980, so that equal content gives equal bytes
            entry.create_system = 0  # nor does the machine that wrote it show
            begins = out.tell() + 30 + len(name) + 4  # the entry's header, its name, the filler's header
            filler = -begins % _ALIGNMENT
            entry.extra = struct.pack("<HH", _FILLER, filler) + b"\0" * filler
            package.writestr(entry, content)
    return out.getvalue()
