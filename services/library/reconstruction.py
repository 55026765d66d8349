"""`Reconstruction`: what `reconstruct` returns, from the bundles that the pipeline has made."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture2vr.edge.convert.read_glb import read_glb
from capture2vr.edge.export.ply import stored_origin
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.errors import BadInput
from capture2vr.library.pipeline_call import MadeBundles

if TYPE_CHECKING:
    import open3d
    import trimesh

_MESH, _MANIFEST = "mesh.ply", "manifest.json"


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """A reconstructed capture.

    preview      mesh of the field that is there without training; frame and units of the capture
    refined      mesh of the trained field or of tiles, in the same frame; None where nothing was trained, or the
                 preview was better: `warnings` say so
    levels       GLB files of the levels of detail, finest first: metres, Y up, on the floor at the origin
    textures     JPEG base colour of each level that has one; () where colours are at the vertices
    certificate  quality figures of the mesh, such as `held_out_mean` and `stray_area` (docs/presets.md), in parts of
                 the capture's longest side; with a `verdict` where a refined mesh was compared with the preview
    warnings     sentences for people: photos left out, points dropped, an unknown scale
    manifest     everything else that is known: size_m, scale_confidence, capture_to_asset (4,4) row by row, seconds,
                 of a survey capture_offset and capture_crs
    files        all files by name: lod0.glb …, mesh.ply, preview.png, asset.usdz, …
    """

    preview: Mesh
    refined: Mesh | None
    levels: tuple[bytes, ...]
    textures: tuple[bytes, ...]
    certificate: Mapping[str, Any]
    warnings: tuple[str, ...]
    manifest: Mapping[str, Any]
    files: Mapping[str, bytes]

    @property
    def mesh(self) -> Mesh:
        """The best mesh: the refined one, else the preview."""
        return self.refined or self.preview

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write all files, and manifest.json, to a folder, which is made if need be; return it.

        Files of the same names are replaced. Raises OSError, and BadInput where the folder is a file.

        >>> sorted(each.name for each in made.save(folder / "out").glob("*.glb"))
        ['lod0.glb', 'lod1.glb', 'lod2.glb']
        """
        folder = Path(folder)
        if folder.exists() and not folder.is_dir():
            raise BadInput(f"{folder} is a file: name a folder")
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        (folder / _MANIFEST).write_text(json.dumps(dict(self.manifest), indent=2) + "\n")
        return folder

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert the best mesh to one of trimesh, as `Mesh.to_trimesh` does.

        >>> made.to_trimesh().is_watertight
        True
        """
        return self.mesh.to_trimesh()

    def to_open3d(self) -> open3d.geometry.TriangleMesh:
        """Convert the best mesh to one of Open3D, as `Mesh.to_open3d` does.

        >>> made.to_open3d().compute_vertex_normals()  # doctest: +SKIP
        """
        return self.mesh.to_open3d()


def reconstruction_of(made: MadeBundles) -> Reconstruction:
    """Convert the bundles that the pipeline made."""
    last = made.last
    levels = tuple(last.files[level["file"]] for level in last.manifest["lods"])
    kept = made.kept
    warnings = (*last.manifest["warnings"], *((kept.warning,) if kept else ()))
    quality = last.manifest["quality"]
    return Reconstruction(
        preview=_read_ply(made.preview.files[_MESH]),
        refined=_read_ply(last.files[_MESH]) if last.state == "refined" else None,
        levels=levels,
        textures=tuple(filter(None, map(_texture, levels))),
        certificate=dict(kept.quality if kept and kept.quality else quality),
        warnings=warnings,
        manifest=last.manifest,
        files=last.files,
    )


def _texture(glb: bytes) -> bytes:
    """Return the base colour of a level; b"" where it has none, or one that only graphics cards read."""
    mesh = read_glb(glb).mesh
    return mesh.jpeg if isinstance(mesh, TexturedMesh) else b""


def _read_ply(content: bytes) -> Mesh:
    """Read a mesh that `ply_bytes` wrote."""
    import trimesh
    from trimesh.visual import ColorVisuals

    read = trimesh.load_mesh(BytesIO(content), file_type="ply", process=False)
    visual, rgb = read.visual, None
    if isinstance(visual, ColorVisuals) and visual.kind == "vertex":
        rgb = np.asarray(visual.vertex_colors, np.uint8)[:, :3]
    return Mesh(np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64), rgb, stored_origin(read))
