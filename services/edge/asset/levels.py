"""Levels of detail of an asset: simplify the mesh, add textures, write the files and render the preview images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from capture2vr.edge.arrays import Floats, Tick, part_of
from capture2vr.edge.asset.manifest import AssetSubject
from capture2vr.edge.asset.target import Target
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.export.usdz import to_phone_usdz
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.simplify import lods
from capture2vr.edge.origin import PROPOSED, nearest_origin
from capture2vr.edge.parallel import in_threads, shared_ticks
from capture2vr.edge.render.contact_sheet import render_sheet
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.thumbnail import thumbnail, turning_preview
from capture2vr.edge.texture.bake_normals import FullShape, bake_normals
from capture2vr.edge.texture.bake_photos import PhotoProjection
from capture2vr.edge.texture.light_of_photos import with_light_of_photos
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from capture2vr.edge.texture.texture_mesh import Palette, texture_levels

_EXPOSURE_SHARE = 0.2  # of the time goes into matching the photos' exposures
_NORMALS_BEGIN = 0.9  # of the time, after which normal maps are baked
_FEWER = 2  # times fewer triangles than the full mesh, from which on a level gets a normal map


def in_asset_frame(full: Mesh, to_asset: Floats) -> Mesh:
    """Move a mesh from the capture frame to the asset frame."""
    return replace(full, vertices=full.vertices @ to_asset[:3, :3].T + to_asset[:3, 3])


def build_levels(full: Mesh, to_asset: Floats, subject: AssetSubject, tick: Tick) -> tuple[Mesh, ...]:
    """Simplify a mesh in the capture frame to its levels of detail in the asset frame, finest first."""
    budgets = subject.target.lod_faces or subject.preset.lod_faces
    whole = in_asset_frame(full, to_asset)
    levels = lods(replace(whole, origin=None), budgets, binding=bool(subject.target.lod_faces), tick=tick)
    return tuple(replace(each, origin=nearest_origin(whole.vertices, whole.origin, each.vertices)) for each in levels)


def add_textures(
    levels: Sequence[Mesh],
    full: Mesh,
    to_asset: Floats,
    subject: AssetSubject,
    encode: EncodeKtx2 | None,
    tick: Tick,
) -> tuple[tuple[Mesh | TexturedMesh, ...], tuple[str, ...]]:
    """Give textures to the levels that gain by them; also return a warning for each level that could get none.

    full    the mesh that they are levels of detail of, in the capture frame
    encode  encoder of KTX2 textures; must be given where the target wants KTX2
    Raises Ktx2Error where the target wants KTX2 and a texture cannot be encoded.
    """
    target, points = subject.target, subject.colours
    if points.rgb is None or not target.texture_px:
        return tuple(levels), ()
    kept = None if points.origin is None else points.origin == PROPOSED
    xyz = points.xyz @ to_asset[:3, :3].T + to_asset[:3, 3]
    known = ColouredPoints.of(xyz, points.rgb, points.inferred, kept)
    palette = Palette(known)
    if points.texture_views:
        posed = [posed_picture(view, to_asset) for view in points.texture_views]
        pictures = PhotoProjection(levels[0], posed, known, part_of(tick, 0, _EXPOSURE_SHARE))
        palette = with_light_of_photos(Palette(known, pictures, pictures.pixel), levels[0])

    def fits(made: TexturedMesh) -> bool:
        return not target.last_bytes or len(pack_glb(made, target)) <= target.last_bytes

    rest = part_of(tick, _EXPOSURE_SHARE if points.texture_views else 0.0, _NORMALS_BEGIN)
    encode = encode if target.ktx2 else None
    made, warnings = texture_levels(levels, palette, most_px=target.texture_px, fits=fits, encode=encode, tick=rest)
    return _add_normal_maps(made, full, to_asset, target, fits, part_of(tick, _NORMALS_BEGIN, 1)), warnings


def _add_normal_maps(
    levels: Sequence[Mesh | TexturedMesh],
    full: Mesh,
    to_asset: Floats,
    target: Target,
    fits: Callable[[TexturedMesh], bool],
    tick: Tick,
) -> tuple[Mesh | TexturedMesh, ...]:
    """Give normal maps to textured levels of much fewer triangles than the full mesh; to the last one if it fits."""
    if not target.normal_px:
        return tuple(levels)
    shape = FullShape(in_asset_frame(full, to_asset))
    made: list[Mesh | TexturedMesh] = []
    for number, level in enumerate(levels):
        made.append(level)
        if isinstance(level, TexturedMesh) and _FEWER * len(level.mesh.faces) <= shape.faces:
            done = part_of(tick, number / len(levels), (number + 1) / len(levels))
            mapped = replace(
                level, normals=bake_normals(level, shape, side=min(level.side, target.normal_px), tick=done)
            )
            if number < len(levels) - 1 or fits(mapped):
                made[-1] = mapped
    return tuple(made)


def pack_glb(asset: Mesh | TexturedMesh, target: Target) -> bytes:
    """Write a level as .glb, packed as the target wants it."""
    return to_glb(asset, target.packing, unlit=target.unlit)


def preview_images(
    levels: Sequence[Mesh | TexturedMesh], *, last: bool, brief: bool = False, mark: str = "", tick: Tick
) -> dict[str, bytes]:
    """Render the preview images, by file name: contact sheet and thumbnail. For the job's last bundle also the turning
    preview and the USDZ file for iOS, which take two seconds. The middle level is fine enough for the small images, and
    for the contact sheet of a bundle that is brief, of half the side: rendering it takes half a second less. mark: a
    word across the foot of all of them; "": none"""
    middle = levels[len(levels) // 2]
    drawn, turned = shared_ticks(tick, 2)
    makers: dict[str, Callable[[], bytes]] = {
        "preview.png": partial(
            render_sheet, middle if brief else levels[0], size=256 if brief else 512, mark=mark, tick=drawn
        ),
        "thumbnail.webp": partial(thumbnail, middle, mark=mark),
    }
    if last:
        makers |= {
            "turning.webp": partial(turning_preview, middle, mark=mark, tick=turned),
            "asset.usdz": partial(to_phone_usdz, middle),
        }
    return dict(zip(makers, in_threads(lambda make: make(), list(makers.values())), strict=True))
