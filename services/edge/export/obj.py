"""Write a mesh as Wavefront OBJ with its material and texture, in one zip."""

from __future__ import annotations

from io import BytesIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np
import trimesh
from trimesh.exchange.obj import export_obj

import capture2vr
from capture2vr.edge.export.shading import Shaded, shaded
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh

_DIGITS = 6  # of a metre: a micrometre
_MATERIAL = "newmtl captured\nKa 0 0 0\nKd {0} {0} {0}\nKs 0 0 0\nillum 1\n"
_NEUTRAL = 0.8  # sRGB grey that shows shading both ways, of a mesh without colours


def to_obj_zip(subject: Mesh | TexturedMesh, name: str) -> bytes:
    """Encode a mesh in the asset frame (metres, Y up) as a zip of NAME.obj, NAME.mtl and, with a texture, NAME.jpg.

    Vertex colours follow the positions, as MeshLab and Blender read them. Equal meshes give equal bytes.
    """
    text = _geometry(shaded(subject))
    head = f"# capture2vr {capture2vr.__version__}: metres, Y up\nmtllib {name}.mtl\no {name}\nusemtl captured\n"
    grey = isinstance(subject, Mesh) and subject.rgb is None
    material = _MATERIAL.format(_NEUTRAL if grey else 1)
    files = {f"{name}.obj": (head + text).encode(), f"{name}.mtl": material.encode()}
    if isinstance(subject, TexturedMesh):
        files[f"{name}.mtl"] += f"map_Kd {name}.jpg\n".encode()
        files[f"{name}.jpg"] = subject.jpeg
    return zip_bytes(files)


def _geometry(surface: Shaded) -> str:
    """Positions with their colours, texture coordinates, normals and faces, as OBJ's lines."""
    visual = None
    if surface.uv is not None:
        upward = np.stack([surface.uv[:, 0], 1 - surface.uv[:, 1]], axis=1)  # v of OBJ runs up
        visual = trimesh.visual.TextureVisuals(uv=upward)  # type: ignore[no-untyped-call]
    mesh = trimesh.Trimesh(
        surface.mesh.vertices,
        surface.mesh.faces,
        vertex_normals=surface.normals,
        vertex_colors=surface.mesh.rgb,
        visual=visual,
        process=False,
    )
    text: str = export_obj(mesh, include_normals=True, digits=_DIGITS, header=None)  # type: ignore[no-untyped-call]
    # trimesh names a material of its own, whose picture it would compress a second time.
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(("mtllib ", "usemtl ")))


def zip_bytes(files: dict[str, bytes]) -> bytes:
    """Zip files; equal contents give equal bytes. JPEG is stored as it is."""
    out = BytesIO()
    with ZipFile(out, "w") as package:
        for name, content in files.items():
            entry = ZipInfo(name)  # its date is 1980
            entry.create_system = 0  # the same on every machine
            entry.compress_type = ZIP_STORED if name.endswith(".jpg") else ZIP_DEFLATED
            package.writestr(entry, content)
    return out.getvalue()
