"""The whole reconstruction on one page: capture (→ depth) → points → field → mesh → bundle.

Every stage is a plain function of the stage before it. `reconstruct` yields `Progress` on the way, and a `Bundle`
whenever there is something to publish: first the preview from the local field, without textures, because making them
from photos takes longer than the mesh; then the preview with textures, or, where the preset trains a field, the refined
bundle under the same key, made by the same functions from another DistanceFn. Held-out points, given to neither field,
compare the two; where the trained field is worse, or fails, `PreviewKept` is yielded instead.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats, part_of
from capture2vr.edge.asset.assemble import assemble_bundle, colour_levels
from capture2vr.edge.asset.manifest import AssetSubject, MeasuredSurface
from capture2vr.edge.asset.photo_check import (
    check_surface_with_photos,
    drop_false_pieces,
    fill_gaps_with_photos,
    trim_rims_with_photos,
)
from capture2vr.edge.asset.target import NO_TARGET, Target, require_encoder
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.capture_to_points import PREVIEW_SHARE, PreparedPoints, prepare, preview_share
from capture2vr.edge.certificate import Evidence, certify, compare, hold_out
from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.export.tileset import TILESET_FILE
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.extract_published import extract_published
from capture2vr.edge.mesh.fill_gaps import Fill, FilledMesh
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spacing import auto_resolution
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.points.downsample import downsample_points
from capture2vr.edge.points.nouns import Cut, Points
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.preset import AUTOMATIC, Extraction, Preset, load_preset
from capture2vr.edge.preset_choice import choose, traits_of
from capture2vr.edge.progress import Bar, Clock, Progress, Watch, ignore_progress
from capture2vr.edge.tiles.folder import tiles_folder
from capture2vr.edge.tiles.scene import TILE_STARTS, TiledScene, reconstruct_tiles
from capture2vr.edge.training import FieldTraining, train
from capture2vr.order.asset_names import UNNAMED, AssetNames
from capture2vr.order.edits import NO_EDITS, Edits
from capture2vr.order.photo_box import PhotoBox
from capture2vr.storage.bundle import Bundle, FilesOnDisk

# Fraction of its pass at which each stage begins. In the preview's pass the local field is there at once; in the
# refined one's the training takes most of the time.
PREVIEW_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.2, "TEXTURING": 0.67, "PACKING": 0.81, "PUBLISHING": 0.93}
# The same where the preview is published once more, with textures from photos.
TEXTURED_STARTS = {"TEXTURING": 0.0, "PACKING": 0.8, "PUBLISHING": 0.95}
REFINED_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.80, "TEXTURING": 0.90, "PACKING": 0.97, "PUBLISHING": 0.99}
# The same of a preset that trains splats, which take most of the time.
SPLATS_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.10, "TEXTURING": 0.20, "PACKING": 0.98, "PUBLISHING": 0.99}
PREVIEW_FINEST = 192  # most cells of a preview that a refined bundle follows: it must be there within seconds
EXTRACT_SHARE = 0.4  # of the EXTRACTING stage's time is extraction, the rest is cleaning


RefuseTraining = Callable[[Preset, int], str]
"""Why a preset's training on that many points must not begin, such as too little memory; "" where it may."""


@dataclass(frozen=True, slots=True)
class PreviewKept:
    """The preview remains the result, because the trained field was worse or failed; `warning` says why.

    quality  the figures of the rejected surface, with the verdict; None where there was no surface
    """

    warning: str
    quality: Mapping[str, Any] | None
    seconds: Mapping[str, float]


def reconstruct(
    capture: Capture,
    preset: Preset,
    *,
    device: str = "cpu",
    checkpoint: Path | None = None,
    cut: Cut = "auto",
    longest_m: float | None = None,
    hold_out: int | None = None,
    box: PhotoBox | None = None,
    edits: Edits = NO_EDITS,
    fill: Fill | None = None,
    names: AssetNames = UNNAMED,
    target: Target = NO_TARGET,
    encode: EncodeKtx2 | None = None,
    engine: OpenEngine | None = None,
    watch: Watch = ignore_progress,
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Reconstruct a capture: yield its bundles, the preview first, and the progress in between.

    device      device that compares photos and trains the field: "cpu", "cuda:0"
    checkpoint  file that the training writes and resumes from; the caller removes it
    cut         what to keep: the object without its surroundings, the scene, or what fits the capture
    longest_m   greatest distance between two points of the object in metres, where it is known
    hold_out    number of photos that the result is not made from, but compared with; None: a few of 16 or more
    box         rectangle of a single photo that the thing lies in; None: what stands out, or is near the middle
    edits       recipe of what to cut away, what is up and the scale; what it says of cut, fill, preset and target is
                with the caller
    fill        which holes of the mesh are filled; None: "unseen" for photos and depth images, "none" for clouds
    names       of the asset, in the manifest
    target      device class whose budget the bundles must meet
    encode      encoder of KTX2 textures, for a target that wants them
    engine      works at the tiles of a large scene; None: this process

    Raises CaptureError where the capture cannot give a surface; EdgeError EDITS_NOTHING_LEFT where too few points
    remain, EDITS_UNKNOWN_PHOTO where a lasso is in a photo that there is not; Cancelled when `watch` does; EdgeError
    KTX2_UNAVAILABLE at once where `target` wants KTX2 and there is no `encode`; after a preview and before a refined
    bundle EdgeError BUDGET_UNREACHABLE where one costs more than `target` allows, and KTX2_FAILED where a texture
    cannot be encoded.
    Any other failure after the preview is not raised, but yields `PreviewKept`. A caller that stops early should close
    the generator.
    """
    require_encoder(target, has_encoder=encode is not None)
    bar = Bar(watch)
    refines = preset.refines or preset.name == AUTOMATIC
    prepared = yield from prepare(
        capture,
        bar,
        refines=refines,
        device=device,
        cut=cut,
        longest_m=longest_m,
        hold_out=hold_out,
        box=box,
        edits=edits,
    )
    share = preview_share(prepared.source.kind)
    yield from bundles(
        prepared,
        preset,
        bar,
        share=share,
        device=device,
        checkpoint=checkpoint,
        fill=fill,
        names=names,
        target=target,
        encode=encode,
        engine=engine,
    )


def bundles(
    prepared: PreparedPoints,
    preset: Preset,
    bar: Bar,
    *,
    share: float = PREVIEW_SHARE,
    device: str = "cpu",
    checkpoint: Path | None = None,
    fill: Fill | None = None,
    names: AssetNames = UNNAMED,
    target: Target = NO_TARGET,
    encode: EncodeKtx2 | None = None,
    engine: OpenEngine | None = None,
    refuse: RefuseTraining = lambda preset, points: "",
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Fit a field to points and yield its bundles: the second half of `reconstruct`, on the rest of the bar.

    share   fraction of the whole bar at which the preview ends, where a training follows
    refuse  asked once the preset and the number of points are known, before anything is fitted
    """
    points, clock = prepared.points, Clock()
    clock.seconds.update(prepared.seconds)
    with clock("POINT_CLOUD"):
        preset, because = _resolve_preset(preset, points, device)
        held_out = hold_out(len(points), sets=2 if _early_stop_steps(preset) else 1)
        inputs = downsample_points(points.subset(held_out == 0), preset.most_points)
    refusal = refuse(preset, len(inputs)) if preset.refines else ""
    config = None if refusal else preset.fit
    refines = preset.refines and not refusal
    share = share if refines else 1.0
    bar.set_range(PREVIEW_STARTS, bar.reached, share)

    yield bar.begin("FITTING", f"{len(inputs):,} points" + (f", preset {preset.name}: {because}" if because else ""))
    with clock("FITTING"):
        unit = unit_frame(inputs.xyz)
        measured = unit.to_unit(inputs.xyz)
        noise = noise_of(measured, tick=bar.tick("FITTING"))
        xyz_unit = denoise(measured, noise, tick=bar.tick("FITTING"))
        distance = local_field(xyz_unit, tick=bar.tick("FITTING"))
    evidence = Evidence.of(xyz_unit, unit.to_unit(points.xyz[held_out == 1]))
    fill = fill or ("unseen" if points.texture_views else "none")
    subject = AssetSubject(
        prepared.source, preset, because, names, target, fill, inputs, points, unit, xyz_unit, evidence
    )

    finest = min(preset.finest, PREVIEW_FINEST) if refines else preset.finest
    preview = yield from _surface(distance, xyz_unit, subject, finest, clock, bar)
    quality = preview.quality(preset, clock.seconds)
    levels = yield from colour_levels(preview, subject, clock, bar)
    pack = partial(assemble_bundle, subject=subject, clock=clock, bar=bar, encode=encode, device=device)
    pack_preview = partial(pack, preview, levels, state="preview", quality=quality)
    if refines or points.texture_views:
        yield from pack_preview(last=False)
    if points.held_out_views:
        preview = _compare_with_photos(preview, subject, clock)
        quality = preview.quality(preset, clock.seconds)
        pack_preview = partial(pack, preview, levels, state="preview", quality=quality)
    if not refines:
        bar.set_range(TEXTURED_STARTS, bar.reached, share)
        yield from pack_preview(last=True)
    if refusal:
        yield PreviewKept(_kept_warning(refusal), None, dict(clock.seconds))
    if config:
        bar.set_range(SPLATS_STARTS if preset.splat_steps else REFINED_STARTS, share, 1.0)
        fitted, fitted_noise = (xyz_unit, None) if preset.denoised else (measured, noise)
        watched = unit.to_unit(points.xyz[held_out == 2])
        if isinstance(config, NetworkConfig) and not len(watched):  # the cloud is too small to hold any out
            config = replace(config, patience=0)
        metres = None if points.scale_confidence == "unknown" else unit.size * points.metres_per_unit
        training = FieldTraining(fitted, fitted_noise, config, device, distance, xyz_unit, watched, checkpoint, metres)
        yield from _refinement(training, subject, preview, quality, pack_preview, pack, clock, bar)
    if refines and preset.tiled:
        bar.set_range(TILE_STARTS, share, 1.0)
        yield from _tiled(distance, subject, levels.to_asset, quality, pack, checkpoint, encode, engine, clock, bar)


def _tiled(
    distance: DistanceFn,
    subject: AssetSubject,
    to_asset: Floats,
    before: Mapping[str, Any],
    pack: Callable[..., Iterator[Progress | Bundle]],
    checkpoint: Path | None,
    encode: EncodeKtx2 | None,
    engine: OpenEngine | None,
    clock: Clock,
    bar: Bar,
) -> Iterator[Progress | Bundle]:
    """Mesh a large scene tile by tile, and yield its bundle: the levels of detail of the whole, and all tiles.

    distance  the preview's field, which certifies the whole; before: the preview's quality figures
    """
    with ExitStack() as kept:
        folder = tiles_folder(checkpoint) if checkpoint else Path(kept.enter_context(TemporaryDirectory()))
        scene = yield from reconstruct_tiles(
            subject.colours, to_asset, subject.preset, subject.target, folder, clock, bar, encode=encode, engine=engine
        )
        from_asset = np.linalg.inv(to_asset)
        vertices = subject.unit.to_unit(scene.mesh.vertices @ from_asset[:3, :3].T + from_asset[:3, 3])
        whole = Mesh(vertices, scene.mesh.faces)
        cells = round(float(np.ptp(scene.mesh.vertices, axis=0).max()) / scene.grid.cell)
        made = MeasuredSurface(FilledMesh.unfilled(whole), cells, certify(distance, whole, subject.evidence))
        quality = {**made.quality(subject.preset, clock.seconds), "preview": before}
        # What the preview was thinned to is no matter here.
        subject = replace(subject, points=replace(subject.points, warnings=subject.colours.warnings))
        levels = yield from colour_levels(made, subject, clock, bar, to_asset)
        pack = partial(pack, subject=subject)
        for step in pack(made, levels, state="refined", quality=quality, last=True):
            yield _with_tiles(step, scene) if isinstance(step, Bundle) else step


def _with_tiles(bundle: Bundle, scene: TiledScene) -> Bundle:
    """Add a scene's tiles, which stay on disk, to the bundle of the whole."""
    files = FilesOnDisk({**bundle.files, TILESET_FILE: scene.document}, scene.files)
    return replace(bundle, files=files, manifest={**bundle.manifest, "points": scene.points, "tileset": scene.manifest})


def _refinement(
    training: FieldTraining,
    subject: AssetSubject,
    preview: MeasuredSurface,
    before: Mapping[str, Any],
    pack_preview: Callable[..., Iterator[Progress | Bundle]],
    pack: Callable[..., Iterator[Progress | Bundle]],
    clock: Clock,
    bar: Bar,
) -> Iterator[Progress | Bundle | PreviewKept]:
    """Train a field, mesh it, and compare it with the preview, which has been published already.

    before  the preview's quality figures
    """

    def keep_preview(why: str, quality: Mapping[str, Any] | None = None) -> Iterator[Progress | Bundle | PreviewKept]:
        """Publish the preview's mesh again as the last bundle, with textures, animation and USDZ."""
        yield from pack_preview(last=True)
        yield PreviewKept(why, quality, dict(clock.seconds))

    try:
        trained = yield from train(training, clock, bar)
        made = yield from _surface(
            trained.distance, trained.near, subject, subject.preset.finest, clock, bar, subject.preset.extraction
        )
    except EdgeError as error:
        yield from keep_preview(_kept_warning(error.message, error.hints))
        return
    except MemoryError:
        why = _kept_warning("there was not enough memory for the refined one", ("choose a coarser preset",))
        with suppress(MemoryError):  # textures take less than a training, but may take too much too
            yield from pack_preview(last=True)
        yield PreviewKept(why, None, dict(clock.seconds))
        return
    made = _compare_with_photos(made, subject, clock)
    made = replace(made, steps=trained.steps, losses=trained.losses, device=trained.device)
    verdict = compare(preview.certificate, made.certificate)
    quality = {
        **made.quality(subject.preset, clock.seconds),
        "verdict": verdict.outcome,
        "because": verdict.because,
        "preview": before,
    }
    if verdict.outcome == "worse" and not subject.preset.literature:
        yield from keep_preview(_kept_warning(verdict.because, trained.warnings), quality)
        return
    warnings = trained.warnings
    if verdict.outcome == "worse":
        warnings += (f"this method's mesh is worse than the preview was: {verdict.because}",)
    if verdict.outcome == "even":
        warnings += (f"training did not improve on the preview: {verdict.because}",)
    levels = yield from colour_levels(made, subject, clock, bar)
    yield from pack(made, levels, state="refined", quality=quality, warnings=warnings, last=True)


def _surface(
    distance: DistanceFn,
    near: Floats,
    subject: AssetSubject,
    finest: int,
    clock: Clock,
    bar: Bar,
    extraction: Extraction = "dual",
) -> Generator[Progress, None, MeasuredSurface]:
    """Extract the mesh of a field whose surface lies near the points (N,3), clean it and measure its quality.

    A mesh of the published extraction stays as it comes.
    """
    resolution = subject.preset.resolution or auto_resolution(
        near, high=finest, cells_per_spacing=subject.preset.cells_per_spacing
    )
    yield bar.begin("EXTRACTING", f"{resolution} cells along the longest side")
    with clock("EXTRACTING"):
        tick = bar.tick("EXTRACTING")
        if extraction == "published":
            mesh_unit = extract_published(distance, near, resolution=resolution, tick=tick)
            _refuse_empty(mesh_unit, near, resolution)
            certificate = certify(distance, mesh_unit, subject.evidence)
            return MeasuredSurface(FilledMesh.unfilled(mesh_unit), resolution, certificate)
        raw = extract(distance, near, resolution=resolution, tick=part_of(tick, 0, EXTRACT_SHARE))
        specks: list[float] = []
        mesh_unit = clean(raw, near, specks=specks, tick=part_of(tick, EXTRACT_SHARE, 1))
        del raw
        _refuse_empty(mesh_unit, near, resolution)
        mesh_unit, pieces = drop_false_pieces(mesh_unit, subject.colours, subject.unit, specks)
        mesh_unit = trim_rims_with_photos(mesh_unit, subject.colours, subject.unit)
        filled = fill_gaps_with_photos(mesh_unit, subject.colours, subject.unit, subject.fill)
        certificate = certify(distance, filled.mesh, subject.evidence, pieces)
        return MeasuredSurface(filled, resolution, certificate)


def _refuse_empty(mesh: Mesh, near: Floats, resolution: int) -> None:
    if len(mesh.faces) == 0:
        raise EdgeError(
            "EXTRACTION_EMPTY",
            f"no surface was found among {len(near):,} points at {resolution} cells",
            hints=("capture the object from closer and from more sides",),
        )


def _compare_with_photos(surface: MeasuredSurface, subject: AssetSubject, clock: Clock) -> MeasuredSurface:
    """Add the comparison with held-out photos, which takes a second: the first bundle is published without it."""
    with clock("EXTRACTING"):
        check = check_surface_with_photos(surface.mesh_unit, subject.colours, subject.unit)
        return replace(surface, check=check, certificate=replace(surface.certificate, photos=check.figures))


def _resolve_preset(preset: Preset, points: Points, device: str) -> tuple[Preset, str]:
    """Return the preset to use, chosen from the points if it is automatic, and the reason; "" for a named one.

    A resolution that was asked for stays.
    """
    if preset.name != AUTOMATIC:
        return preset, ""
    choice = choose(traits_of(points, gpu=device != "cpu"))
    return replace(load_preset(choice.preset), resolution=preset.resolution), choice.because


def _early_stop_steps(preset: Preset) -> int:
    """Steps without a gain on held-out points after which training stops early; 0: it never does."""
    return preset.fit.patience if isinstance(preset.fit, NetworkConfig) else 0


def _kept_warning(why: str, hints: tuple[str, ...] = ()) -> str:
    """The warning for people that the preview was kept, with the reason and hints."""
    return f"the preview was kept: {why}" + (f" ({'; '.join(hints)})" if hints else "")
