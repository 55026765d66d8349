"""The refined bundle of a large scene, which is meshed tile by tile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.asset.manifest import MeasuredSurface
from capture2vr.edge.asset_maker import AssetMaker
from capture2vr.edge.certificate import certify
from capture2vr.edge.export.tileset import TILESET_FILE
from capture2vr.edge.geodesy.place_on_earth import asset_to_earth
from capture2vr.edge.mesh.fill_gaps import FilledMesh
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.nouns import UnitFrame
from capture2vr.edge.progress import Progress
from capture2vr.edge.tiles.folder import tiles_folder
from capture2vr.edge.tiles.scene import LargeScene, TiledScene, reconstruct_tiles
from capture2vr.storage.bundle import Bundle, FilesOnDisk


def tiled_bundle(
    maker: AssetMaker, distance: DistanceFn, to_asset: Floats, before: Mapping[str, Any]
) -> Iterator[Progress | Bundle]:
    """Mesh a large scene tile by tile, and yield its bundle: the levels of detail of the whole, and all tiles.

    distance  the preview's field, which certifies the whole
    to_asset  (4,4) from the capture frame to the asset frame; before: the preview's quality figures
    """
    subject, resources = maker.subject, maker.resources
    with ExitStack() as kept:
        checkpoint = resources.checkpoint
        folder = tiles_folder(checkpoint) if checkpoint else Path(kept.enter_context(TemporaryDirectory()))
        large = LargeScene(subject.colours, to_asset, subject.preset, subject.target)
        scene = yield from reconstruct_tiles(large, folder, maker.clock, maker.bar, resources)
        scene = replace(scene, to_earth=asset_to_earth(subject.points.crs, subject.points.offset, to_asset))
        whole = _whole_scene(scene, to_asset, subject.unit)
        cells = round(float(np.ptp(scene.mesh.vertices, axis=0).max()) / scene.grid.cell)
        made = MeasuredSurface(FilledMesh.unfilled(whole), cells, certify(distance, whole, subject.evidence))
        quality = {**made.quality(subject.preset, maker.clock.seconds), "preview": before}
        # What the preview was thinned to is no matter here.
        points = replace(subject.points, warnings=subject.colours.warnings)
        maker = replace(maker, subject=replace(subject, points=points))
        levels = yield from maker.levels(made, to_asset)
        for step in maker.bundle(made, levels, "refined", quality, last=True):
            yield _with_tiles(step, scene) if isinstance(step, Bundle) else step


def _whole_scene(scene: TiledScene, to_asset: Floats, unit: UnitFrame) -> Mesh:
    """The coarsest mesh of a tiled scene, in the unit frame."""
    from_asset = np.linalg.inv(to_asset)
    vertices = unit.to_unit(scene.mesh.vertices @ from_asset[:3, :3].T + from_asset[:3, 3])
    return Mesh(vertices, scene.mesh.faces)


def _with_tiles(bundle: Bundle, scene: TiledScene) -> Bundle:
    """Add a scene's tiles, which stay on disk, to the bundle of the whole."""
    files = FilesOnDisk({**bundle.files, TILESET_FILE: scene.document}, scene.files)
    return replace(bundle, files=files, manifest={**bundle.manifest, "points": scene.points, "tileset": scene.manifest})
