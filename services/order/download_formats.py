"""The formats in which a finished asset can be downloaded for other programs: names, words for people, and what each
is made from. The gateway lists them, the worker makes them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatchcase

from capture2vr.sentences.sentence import say

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
            say("format_tiles_3d_title"),
            say("format_tiles_3d_about"),
            "-3d-tiles.zip",
            (TILESET,),
            (TILES,),
        ),
        DownloadFormat("glb", say("format_glb_title"), say("format_glb_about"), ".glb", (FINEST,)),
        DownloadFormat(
            "glb-meshopt",
            say("format_glb_meshopt_title"),
            say("format_glb_meshopt_about"),
            "-meshopt.glb",
            (FINEST,),
        ),
        DownloadFormat(
            "obj",
            say("format_obj_title"),
            say("format_obj_about"),
            "-obj.zip",
            (FINEST,),
        ),
        DownloadFormat(
            "ply",
            say("format_ply_title"),
            say("format_ply_about"),
            ".ply",
            (MESH,),
            (TILESET, TILES),
        ),
        DownloadFormat(
            "stl",
            say("format_stl_title"),
            say("format_stl_about"),
            ".stl",
            (MESH,),
            (TILESET, TILES),
        ),
        DownloadFormat(
            "usdz",
            say("format_usdz_title"),
            say("format_usdz_about"),
            ".usdz",
            (FINEST,),
            ("asset.usdz",),
        ),
        DownloadFormat(
            "splats-spz",
            say("format_splats_spz_title"),
            say("format_splats_spz_about"),
            ".spz",
            (FINEST,),
            (SPLATS,),
        ),
        DownloadFormat(
            "splats-glb",
            say("format_splats_glb_title"),
            say("format_splats_glb_about"),
            "-splats.glb",
            (FINEST,),
            (SPLATS,),
        ),
        DownloadFormat(
            "points-ply",
            say("format_points_ply_title"),
            say("format_points_ply_about"),
            "-points.ply",
            (POINTS,),
        ),
        DownloadFormat(
            "points-laz",
            say("format_points_laz_title"),
            say("format_points_laz_about"),
            "-points.laz",
            (POINTS,),
        ),
        DownloadFormat(
            "colmap",
            say("format_colmap_title"),
            say("format_colmap_about"),
            "-colmap.zip",
            (CAMERAS, POINTS),
        ),
        DownloadFormat(
            "transforms",
            say("format_transforms_title"),
            say("format_transforms_about"),
            "-transforms.zip",
            (CAMERAS, POINTS),
        ),
    )
}
"""All formats by name, in the order in which people are shown them."""


def formats_of(files: Collection[str]) -> list[DownloadFormat]:
    """Return the formats that an asset can have whose bundle has these files."""
    return [each for each in FORMATS.values() if all(file in files for file in each.needs)]
