"""Assemble a bundle from a measured mesh in the unit frame: colours, levels of detail, textures, files and manifest."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from capture2vr.edge.arrays import Floats, Tick, part_of
from capture2vr.edge.asset.capture_files import capture_files
from capture2vr.edge.asset.cut_pictures import pictures_of_cut
from capture2vr.edge.asset.levels import add_textures, build_levels, pack_glb, preview_images
from capture2vr.edge.asset.manifest import AssetSubject, MeasuredSurface, asset_frame, build_manifest
from capture2vr.edge.asset.origin_picture import pictures_of_origin
from capture2vr.edge.asset.photo_check import check_textures_with_photos, figures_with_textures, marked_pictures
from capture2vr.edge.asset.splat_file import splat_file
from capture2vr.edge.asset.target import measure_cost, require_budget
from capture2vr.edge.export.ktx2 import EncodeKtx2, Ktx2Error
from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.job_resources import CPU_ALONE, JobResources
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.edge.texture.nearest_colour import transfer_colours
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, State, publishing

_LODS_SHARE = 0.3  # of the TEXTURING stage's time goes into levels of detail, where they get textures too
_TEXTURES_END = 0.4  # of the same, where splats are trained after the textures


@dataclass(frozen=True, slots=True)
class ColouredLevels:
    """A coloured mesh in the capture frame, and its levels of detail in the asset frame, finest first.

    to_asset  (4,4) from the capture frame to the asset frame
    """

    full: Mesh
    to_asset: Floats
    levels: tuple[Mesh, ...]


@dataclass(frozen=True, slots=True)
class Edition:
    """Which of a job's bundles one is, and what its manifest says besides the mesh.

    last   whether it is the job's last one. Textures, animation, USDZ, points, cameras are made only then; they would
           delay the preview
    brief  whether the next one is to come within seconds: the contact sheet is half as large
    """

    state: State
    quality: Mapping[str, Any]
    last: bool
    warnings: tuple[str, ...] = ()
    brief: bool = False


def colour_levels(
    surface: MeasuredSurface, subject: AssetSubject, clock: Clock, bar: Bar, to_asset: Floats | None = None
) -> Generator[Progress, None, ColouredLevels]:
    """Colour a surface's mesh from the captured points and make its levels of detail: what all its bundles share.

    to_asset  (4,4) from the capture frame to the asset frame; None: the mesh stands on the asset frame's floor
    """
    points, mesh_unit = subject.points, surface.mesh_unit
    yield bar.begin("TEXTURING", say("count_triangles", count=len(mesh_unit.faces)))
    with clock("TEXTURING"):
        if points.rgb is not None:
            mesh_unit = transfer_colours(mesh_unit, subject.xyz_unit, points.rgb)
        vertices, origin = subject.unit.to_world(mesh_unit.vertices), surface.surface.vertex_origin
        full = replace(mesh_unit, vertices=vertices, origin=origin)
        to_asset = asset_frame(full.vertices, points) if to_asset is None else to_asset
        tick = part_of(bar.tick("TEXTURING"), 0, _LODS_SHARE)
        return ColouredLevels(full, to_asset, build_levels(full, to_asset, subject, tick))


def assemble_bundle(
    surface: MeasuredSurface,
    coloured: ColouredLevels,
    edition: Edition,
    subject: AssetSubject,
    clock: Clock,
    bar: Bar,
    resources: JobResources = CPU_ALONE,
) -> Iterator[Progress | Bundle]:
    """Yield the bundle of a surface whose levels of detail are made: files, preview images, manifest.

    resources  the encoder of KTX2 textures for a target that wants them, which `require_encoder` has found there; the
               device that splats are trained on, where the preset wants them

    Raises EdgeError BUDGET_UNREACHABLE and Ktx2Error: before a refined bundle, but after a preview is yielded.
    """
    levels, to_asset = coloured.levels, coloured.to_asset
    state, last = edition.state, edition.last
    assets: Sequence[Mesh | TexturedMesh] = levels
    texture_warnings: tuple[str, ...] = ()
    failed = None
    if last:
        yield bar.begin("TEXTURING", say("textures_levels_detail", count=len(levels)))
        with clock("TEXTURING"):
            end = _TEXTURES_END if subject.preset.splat_steps else 1
            rest = part_of(bar.tick("TEXTURING"), _LODS_SHARE, end)
            assets, texture_warnings, failed = _try_textures(coloured, subject, state, resources.encode, rest)
    splats: dict[str, bytes] = {}
    if last and subject.preset.splat_steps:
        yield bar.advance("TEXTURING", _TEXTURES_END, say("splats_trained_on_photos"))
        with clock("TEXTURING"):
            rest = part_of(bar.tick("TEXTURING"), _TEXTURES_END, 1)
            splats, splat_warnings = splat_file(assets[0], subject, to_asset, resources.device, rest)
            texture_warnings += splat_warnings
    yield bar.begin("PACKING", say("files_preview_images"))
    with clock("PACKING"):
        tick = bar.tick("PACKING")
        files = {f"lod{level}.glb": pack_glb(asset, subject.target) for level, asset in enumerate(assets)}
        costs = [measure_cost(glb) for glb in files.values()]
        files |= preview_images(assets, last=last, brief=edition.brief, mark=_mark_of(subject), tick=tick)
        files |= splats
        files["mesh.ply"] = ply_bytes(coloured.full, offset=subject.points.offset)
        quality, private = edition.quality, dict[str, bytes]()
        if last:
            files |= capture_files(subject.colours, to_asset)
            photos, private = _beside_photos(assets[0], surface, subject, to_asset)
            quality = {**quality, **photos}
            private |= pictures_of_origin(levels[len(levels) // 2])
    manifest = build_manifest(
        subject,
        quality=quality,
        costs=costs,
        finest=levels[0],
        to_asset=to_asset,
        seconds=clock.seconds,
        warnings=(*edition.warnings, *surface.warnings(), *texture_warnings),
        grade=surface.grade,
    )
    if state == "refined":
        require_budget(subject.target, costs)
    # The last report before the bundle goes to the store: it raises Cancelled, and nothing is published then.
    yield bar.begin("PUBLISHING", publishing(state))
    yield Bundle(state=state, files=files, manifest=manifest, private=private, last=last)
    # A preview is published even without its textures and beyond the budget: better than nothing to look at.
    if failed:
        raise failed
    require_budget(subject.target, costs)


def _mark_of(subject: AssetSubject) -> str:
    """The word that the preview images show of what a generator made up; "" of anything else."""
    return subject.source.origin if subject.source.generated else ""


def _beside_photos(
    asset: Mesh | TexturedMesh, surface: MeasuredSurface, subject: AssetSubject, to_asset: Floats
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Compare the finest level with held-out photos: the quality's entry `photos`, and pictures for the owner alone."""
    cut = pictures_of_cut(subject.colours, to_asset)
    if not surface.check.surface:
        return {}, cut
    likeness = check_textures_with_photos(asset, surface.check, subject.colours, to_asset)
    figures = figures_with_textures(surface.check, likeness)
    return {"photos": asdict(figures) if figures else None}, {**marked_pictures(surface.check, likeness), **cut}


def _try_textures(
    coloured: ColouredLevels, subject: AssetSubject, state: State, encode: EncodeKtx2 | None, tick: Tick
) -> tuple[Sequence[Mesh | TexturedMesh], tuple[str, ...], Ktx2Error | None]:
    """Return the levels with textures, warnings, and None. If a preview's textures cannot be encoded as KTX2: the
    levels without textures, and the error."""
    try:
        return *add_textures(coloured.levels, coloured.full, coloured.to_asset, subject, encode, tick), None
    except Ktx2Error as error:
        if state == "refined":
            raise
        return coloured.levels, (), error
