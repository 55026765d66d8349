"""The formats in which a finished asset can be downloaded for other programs: names, words for people, and what each
is made from. The gateway lists them, the worker makes them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatchcase

WRITERS = 2
"""Version of all that writes these formats. Raised when a file comes out different: files that were made before are
then made again."""

MESH, FINEST, POINTS, CAMERAS = "mesh.ply", "lod0.glb", "points.laz", "cameras.json"
"""Files of a bundle: the full mesh, the finest level of detail, points of the capture, the cameras of its photos."""
SPLATS = "splats.spz"
"""File of a bundle with splats that were trained on its photos; without it splats cover the finest level as it is."""
TILESET = "tileset.json"
"""File of a bundle that is a scene in tiles: it names them. All other files are then of the coarse whole."""
TILES = "tile-*.glb"
"""Files of such a bundle: its tiles."""


@dataclass(frozen=True, slots=True)
class DownloadFormat:
    """A format of downloads.

    name    in the API and on the command line; title, about: in words for people
    ending  of a file's name, behind the asset's key
    needs   files of the bundle that it is made from: without one of them the asset cannot have the format
    uses    files of the bundle that help where they are there; a * stands for any letters
    """

    name: str
    title: str
    about: str
    ending: str
    needs: tuple[str, ...]
    uses: tuple[str, ...] = ()

    def takes(self, file: str) -> bool:
        """Return whether a file of a bundle is one that the format is made from."""
        return any(fnmatchcase(file, pattern) for pattern in (*self.needs, *self.uses))

    def file_name(self, key: str, version: int | None = None) -> str:
        """Return the name of an asset's file in this format. version: of an earlier version, which the name tells"""
        return f"{key}-v{version}{self.ending}" if version else key + self.ending


FORMATS = {
    each.name: each
    for each in (
        DownloadFormat(
            "3d-tiles",
            "3D Tiles",
            "The whole scene, all tiles in full detail, for Cesium: a zip of tileset.json and GLB. "
            "PLY and STL have all of it too, the other formats its coarse whole. Metres, Z up.",
            "-3d-tiles.zip",
            (TILESET,),
            (TILES,),
        ),
        DownloadFormat(
            "glb", "GLB", "For nearly every 3D program: mesh and texture in one file. Metres, Y up.", ".glb", (FINEST,)
        ),
        DownloadFormat(
            "glb-meshopt",
            "GLB, compressed",
            "For web pages and game engines with a meshopt decoder: a quarter of the bytes. Metres, Y up.",
            "-meshopt.glb",
            (FINEST,),
        ),
        DownloadFormat(
            "obj",
            "OBJ with texture",
            "For older 3D programs: a zip of OBJ, MTL and JPEG. Metres, Y up.",
            "-obj.zip",
            (FINEST,),
        ),
        DownloadFormat(
            "ply",
            "PLY mesh",
            "For MeshLab, CloudCompare and scripts: every triangle, colours at the vertices. Metres, Z up.",
            ".ply",
            (MESH,),
            (TILESET, TILES),
        ),
        DownloadFormat(
            "stl",
            "STL",
            "For 3D printing: every triangle, no colours. Millimetres, Z up, as slicers expect.",
            ".stl",
            (MESH,),
            (TILESET, TILES),
        ),
        DownloadFormat(
            "usdz",
            "USDZ",
            "For iPhone, iPad and Mac: opens in Quick Look. Metres, Y up.",
            ".usdz",
            (FINEST,),
            ("asset.usdz",),
        ),
        DownloadFormat(
            "splats-spz",
            "Splats, SPZ",
            "Gaussian splats that cover the mesh, for splat viewers. Metres, Y up.",
            ".spz",
            (FINEST,),
            (SPLATS,),
        ),
        DownloadFormat(
            "splats-glb",
            "Splats, GLB",
            "The same as glTF with KHR_gaussian_splatting; other programs show points. Metres, Y up.",
            "-splats.glb",
            (FINEST,),
            (SPLATS,),
        ),
        DownloadFormat(
            "points-ply",
            "Points, PLY",
            "The captured points, for CloudCompare, MeshLab and scripts. Metres, Z up.",
            "-points.ply",
            (POINTS,),
        ),
        DownloadFormat(
            "points-laz",
            "Points, LAZ",
            "The captured points, compressed, for surveying and GIS programs. Metres, Z up.",
            "-points.laz",
            (POINTS,),
        ),
        DownloadFormat(
            "colmap",
            "Cameras, COLMAP",
            "Where each photo was taken from, for Gaussian splatting and other trainers: a zip of text. Metres, Z up.",
            "-colmap.zip",
            (CAMERAS, POINTS),
        ),
        DownloadFormat(
            "transforms",
            "Cameras, transforms.json",
            "The same for nerfstudio: put your photos into images/. Metres, Z up.",
            "-transforms.zip",
            (CAMERAS, POINTS),
        ),
    )
}
"""All formats by name, in the order in which people are shown them."""


def formats_of(files: Collection[str]) -> list[DownloadFormat]:
    """Return the formats that an asset can have whose bundle has these files."""
    return [each for each in FORMATS.values() if all(file in files for file in each.needs)]
