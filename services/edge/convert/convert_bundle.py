"""Convert the files of a bundle to a format for other programs.

For a worker `python -m capture2vr.edge.convert` does it, on a desk `capture2vr convert`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.stl import export_stl
from trimesh.visual import ColorVisuals

from capture2vr.edge.arrays import Floats
from capture2vr.edge.convert.camera_files import colmap_zip, transforms_zip
from capture2vr.edge.convert.capture_points import CapturePoints
from capture2vr.edge.convert.join_tiles import join_tiles
from capture2vr.edge.convert.read_glb import StoredLevel, read_glb
from capture2vr.edge.convert.tileset_zip import tileset_zip
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.glb_buffer import with_extras
from capture2vr.edge.export.obj import to_obj_zip
from capture2vr.edge.export.ply import ply_bytes, stored_origin
from capture2vr.edge.export.usdz import to_phone_usdz
from capture2vr.edge.export.z_up import z_up
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.splats.splat_glb import to_splat_glb
from capture2vr.edge.splats.spz import from_spz, to_spz
from capture2vr.edge.splats.surface_splats import cover_with_splats
from capture2vr.edge.texture.nearest_colour import transfer_colours
from capture2vr.order.download_formats import CAMERAS, FINEST, MESH, POINTS, SPLATS, TILESET

_MM = 1000.0  # per metre


@dataclass(frozen=True, slots=True)
class BundleFolder:
    """A bundle's files in a folder, by their plain names, with its manifest.

    files: their names, where the folder may have others, which are not the bundle's; None: all are
    """

    folder: Path
    manifest: Mapping[str, Any]
    files: frozenset[str] | None = None

    def read(self, file: str) -> bytes:
        """Read a file. Raises FileNotFoundError."""
        return (self.folder / file).read_bytes()

    def has(self, file: str) -> bool:
        return (self.files is None or file in self.files) and (self.folder / file).is_file()

    @property
    def to_asset(self) -> Floats:
        """Transform (4,4) from the frame of the capture's file, in which the full mesh is, to the asset frame."""
        matrix: Floats = np.array(self.manifest["capture_to_asset"], np.float64).reshape(4, 4)
        offset = self.manifest.get("capture_offset")
        if offset is not None:
            matrix[:3, 3] -= matrix[:3, :3] @ np.array(offset)
        return matrix


def convert(bundle: BundleFolder, format_name: str, key: str) -> bytes:
    """Convert a bundle to a format of `capture2vr.order.download_formats`; key: name of the files in a zip.

    Raises ValueError where a file of the bundle is not what it should be, FileNotFoundError where one is missing.
    """
    return _WRITERS[format_name](bundle, key)


def _glb(bundle: BundleFolder, key: str) -> bytes:
    level = _finest(bundle)
    return _placed(bundle, to_glb(level.mesh, "float", unlit=level.unlit))


def _placed(bundle: BundleFolder, glb: bytes) -> bytes:
    """Return a .glb whose extras say where the object of a survey stands: at the inverse of capture_to_asset, (4,4) row
    by row, times a place in the file, plus capture_offset, in the coordinate reference system capture_crs."""
    known = {name: bundle.manifest.get(name) for name in ("capture_offset", "capture_crs")}
    extras = {name: value for name, value in known.items() if value is not None}
    return with_extras(glb, {**extras, "capture_to_asset": bundle.manifest["capture_to_asset"]}) if extras else glb


def _glb_meshopt(bundle: BundleFolder, key: str) -> bytes:
    data = bundle.read(FINEST)
    level = read_glb(data)
    return _placed(bundle, data if level.is_packed else to_glb(level.mesh, "meshopt", unlit=level.unlit))


def _obj(bundle: BundleFolder, key: str) -> bytes:
    return to_obj_zip(_finest(bundle).mesh, key)


def _ply(bundle: BundleFolder, key: str) -> bytes:
    return ply_bytes(_upright(_every_triangle(bundle)))


def _stl(bundle: BundleFolder, key: str) -> bytes:
    mesh = _upright(_every_triangle(bundle))
    data: bytes = export_stl(trimesh.Trimesh(mesh.vertices * _MM, mesh.faces, process=False))
    return data


def _every_triangle(bundle: BundleFolder) -> Mesh:
    """The full mesh, of a scene in tiles all of them, in the asset frame."""
    return join_tiles(bundle.read, partial(_full, bundle)) if bundle.has(TILESET) else _full(bundle)


def _upright(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=z_up(mesh.vertices))


def _usdz(bundle: BundleFolder, key: str) -> bytes:
    """The bundle's own file, which is of a level that phones can show; a preview has none yet."""
    return bundle.read("asset.usdz") if bundle.has("asset.usdz") else to_phone_usdz(_finest(bundle).mesh)


def _splats_spz(bundle: BundleFolder, key: str) -> bytes:
    return bundle.read(SPLATS) if bundle.has(SPLATS) else to_spz(cover_with_splats(_finest(bundle).mesh))


def _splats_glb(bundle: BundleFolder, key: str) -> bytes:
    """Of the bundle's own splats, which are trained, or of such that cover the mesh."""
    trained = bundle.has(SPLATS)
    return to_splat_glb(from_spz(bundle.read(SPLATS)) if trained else cover_with_splats(_finest(bundle).mesh))


def _points_ply(bundle: BundleFolder, key: str) -> bytes:
    return CapturePoints.read(bundle.read(POINTS)).ply()


def _points_laz(bundle: BundleFolder, key: str) -> bytes:
    return bundle.read(POINTS)


def _colmap(bundle: BundleFolder, key: str) -> bytes:
    return colmap_zip(bundle.read(CAMERAS), bundle.read(POINTS))


def _transforms(bundle: BundleFolder, key: str) -> bytes:
    return transforms_zip(bundle.read(CAMERAS), bundle.read(POINTS))


def _3d_tiles(bundle: BundleFolder, key: str) -> bytes:
    return tileset_zip(bundle.read)


_WRITERS: Mapping[str, Callable[[BundleFolder, str], bytes]] = {
    "glb": _glb,
    "glb-meshopt": _glb_meshopt,
    "obj": _obj,
    "ply": _ply,
    "stl": _stl,
    "usdz": _usdz,
    "splats-spz": _splats_spz,
    "splats-glb": _splats_glb,
    "points-ply": _points_ply,
    "points-laz": _points_laz,
    "colmap": _colmap,
    "transforms": _transforms,
    "3d-tiles": _3d_tiles,
}


def _finest(bundle: BundleFolder) -> StoredLevel:
    """The finest level. One with a KTX2 texture, which these formats cannot have, gets the full mesh's colours."""
    level = read_glb(bundle.read(FINEST))
    if not level.ktx2 or isinstance(level.mesh, TexturedMesh):
        return level
    full = _full(bundle)
    coloured = level.mesh if full.rgb is None else transfer_colours(level.mesh, full.vertices, full.rgb)
    return replace(level, mesh=coloured)


def _full(bundle: BundleFolder) -> Mesh:
    """The full mesh, of a scene in tiles the coarse whole, in the asset frame. Raises ValueError."""
    with (bundle.folder / MESH).open("rb") as file:
        found = trimesh.load(file, file_type="ply", process=False)
    if not isinstance(found, trimesh.Trimesh) or len(found.faces) == 0:
        raise ValueError(f"{MESH} has no triangles")
    colours = found.visual if isinstance(found.visual, ColorVisuals) and found.visual.kind == "vertex" else None
    rgb = None if colours is None else np.asarray(colours.vertex_colors, np.uint8)[:, :3]
    to_asset = bundle.to_asset
    vertices = np.asarray(found.vertices, np.float64) @ to_asset[:3, :3].T + to_asset[:3, 3]
    return Mesh(vertices, np.asarray(found.faces, np.int64), rgb, stored_origin(found))
