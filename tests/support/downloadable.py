"""Bundles as the pipeline writes them, small: what downloads are made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from capture2vr.edge.convert.convert_bundle import BundleFolder
from capture2vr.edge.export.glb import Packing, to_glb
from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.storage.bundle import Bundle
from tests.support import surfaces
from tests.support.photos.painted import quarters

TO_ASSET = np.array([[0.0, 2, 0, 0.5], [-2, 0, 0, 1], [0, 0, 2, -0.25], [0, 0, 0, 1]])
"""From the capture frame to the asset frame: a quarter turn about Z, twice as large, and moved."""
SHEET = surfaces.patch(lambda u, v: [u, 0.3 * v, 0.2 * np.sin(5 * u) * np.cos(4 * v)], 12, 8)
"""An open surface in the asset frame, of three different sides."""
SLATE = surfaces.patch(lambda u, v: [u, 0.3 * v, 0.0 * u], 3, 2)
"""Another one, of fewer triangles."""


def textured(mesh: Mesh = SHEET) -> TexturedMesh:
    """The mesh with the four quarters of a picture projected along Z, on one chart."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    across = (mesh.vertices - low)[:, :2] / (high - low)[:2]
    return TexturedMesh(mesh, np.stack([across[:, 0], 1 - across[:, 1]], axis=1), quarters(), 64)


def coloured(mesh: Mesh = SHEET) -> Mesh:
    """The mesh with red where X is small and blue where it is large."""
    share = np.ptp(mesh.vertices[:, :1], axis=0)
    red = 255 * (1 - (mesh.vertices[:, 0] - mesh.vertices[:, 0].min()) / share)
    return replace(mesh, rgb=np.stack([red, 0 * red + 40, 255 - red], axis=1).astype(np.uint8))


def in_capture_frame(mesh: Mesh) -> Mesh:
    """A mesh of the asset frame as the capture had it."""
    inverse = np.linalg.inv(TO_ASSET)
    return replace(mesh, vertices=mesh.vertices @ inverse[:3, :3].T + inverse[:3, 3])


def downloadable(finest: Mesh | TexturedMesh | None = None, packing: Packing = "meshopt", **files: bytes) -> Bundle:
    """A bundle of one level of detail and the full mesh; `files` by name with _ for the dot."""
    full = ply_bytes(in_capture_frame(coloured()))
    made = {"lod0.glb": to_glb(finest or textured(), packing), "mesh.ply": full}
    made |= {name.replace("_", "."): content for name, content in files.items()}
    manifest = {
        "lods": [{"file": "lod0.glb", "level": 0, "triangles": len(SHEET.faces), "vertices": len(SHEET.vertices)}],
        "capture_to_asset": TO_ASSET.ravel().tolist(),
        "target": "",
        "label": "Sheet",
        "quality": {},
    }
    return Bundle(state="refined", files=made, manifest=manifest, last=True)


def written(bundle: Bundle, folder: Path) -> BundleFolder:
    """A bundle's files in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in bundle.files.items():
        (folder / name).write_bytes(content)
    return BundleFolder(folder, bundle.manifest)
