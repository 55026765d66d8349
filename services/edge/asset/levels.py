"""The levels of detail of a subject in the asset frame, with the colours that its capture knows, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from services.edge.arrays import Floats, Tick
from services.edge.asset import Subject
from services.edge.mesh import Mesh, Textured, lods, render_sheet, to_glb
from services.edge.mesh.bake_pictures import Pictures, PosedPicture
from services.edge.mesh.band import part_of
from services.edge.mesh.colour import ColouredPoints
from services.edge.mesh.glb import best_packing
from services.edge.mesh.texture import Palette, with_pictures
from services.edge.mesh.thumbnail import thumbnail, turning
from services.edge.mesh.usdz import to_usdz
from services.edge.points.nouns import Shot
from services.edge.target import Target

_LEVELLED = 0.2  # of the time: bringing photos to one brightness


def levels_of(full: Mesh, to_asset: Floats, subject: Subject, tick: Tick) -> tuple[Mesh, ...]:
    """The LODs in the asset frame, finest first."""
    vertices = full.vertices @ to_asset[:3, :3].T + to_asset[:3, 3]
    budgets = subject.target.lod_faces or subject.preset.lod_faces
    return lods(replace(full, vertices=vertices), budgets, binding=bool(subject.target.lod_faces), tick=tick)


def textured(
    levels: Sequence[Mesh], to_asset: Floats, subject: Subject, tick: Tick
) -> tuple[tuple[Mesh | Textured, ...], tuple[str, ...]]:
    """The levels, those with textures that show more so, and a warning for each that could get none.

    Raises Ktx2Error where the target wants KTX2 and none comes of a texture.
    """
    target, points = subject.target, subject.colours
    if points.rgb is None or not target.texture_px:
        return tuple(levels), ()
    known = ColouredPoints.of(points.xyz @ to_asset[:3, :3].T + to_asset[:3, 3], points.rgb)
    palette = Palette(known)
    if points.shots:
        posed = [_posed(shot, to_asset) for shot in points.shots]
        pictures = Pictures(levels[0], posed, known, part_of(tick, 0, _LEVELLED))
        palette = Palette(known, pictures, pictures.pixel)

    def fits(made: Textured) -> bool:
        return not target.last_bytes or len(packed(made, target)) <= target.last_bytes

    start = _LEVELLED if points.shots else 0.0
    behind = part_of(tick, start, 1)
    return with_pictures(levels, palette, most_px=target.texture_px, fits=fits, encode=target.ktx2, tick=behind)


def packed(asset: Mesh | Textured, target: Target) -> bytes:
    """The .glb of a level for a target."""
    return to_glb(asset, target.packing or best_packing(), unlit=target.unlit)


def pictures_of(levels: Sequence[Mesh | Textured], *, last: bool, tick: Tick) -> dict[str, bytes]:
    """Files by name: the sheet of the finest level, and the thumbnail; of the last bundle of a job also the turning
    preview and the file for iOS, which take two seconds. The middle level is enough for all that is small."""
    middle = levels[len(levels) // 2]
    files = {"preview.png": render_sheet(levels[0], tick=part_of(tick, 0, 0.6)), "thumbnail.webp": thumbnail(middle)}
    if last:
        files["turning.webp"] = turning(middle, tick=part_of(tick, 0.6, 1))
        files["asset.usdz"] = to_usdz(middle)
    return files


def _posed(shot: Shot, to_asset: Floats) -> PosedPicture:
    camera = shot.intrinsics
    return PosedPicture(
        to_camera=np.linalg.inv(to_asset @ shot.camera_to_world),
        focal=np.array([camera.fx / camera.width, camera.fy / camera.height]),
        middle=np.array([(camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height]),
        load_rgb=shot.load_rgb,
        load_depth=shot.load_depth_m,
    )
