"""The whole method on one page: capture (→ depth) → points → field → mesh → bundle.

Every stage is a plain function of the stage before it. `reconstruct` yields `Progress` on the way and a `Bundle`
whenever there is something worth publishing: first the preview of the local field, then, where the preset trains, the
refined one under the same key, made by the same functions from another DistanceFn. Points that neither field has seen
judge both; a trained field that they find worse, or that fails, yields `PreviewKept` instead of its bundle.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from services.edge.arrays import Bools, DistanceFn, Floats, Tick
from services.edge.asset import Subject, Surface, asset_frame, manifest_of
from services.edge.capture.nouns import Capture
from services.edge.certificate import Evidence, certify, compare, hold_out
from services.edge.choose import choose, traits_of
from services.edge.errors import EdgeError
from services.edge.field.denoise import denoise
from services.edge.field.folds import noise_of
from services.edge.field.local import local_field
from services.edge.mesh import Mesh, carry_colours, clean, extract, lods, ply_bytes, render_sheet, to_glb
from services.edge.mesh.band import part_of
from services.edge.mesh.spacing import auto_resolution
from services.edge.photos import to_depth
from services.edge.points import Points, at_most, to_points, unit_frame, with_longest
from services.edge.preset import AUTOMATIC, Preset, load_preset
from services.edge.progress import Bar, Clock, Progress, Watch, unwatched
from services.edge.training import Training, train
from services.storage.bundle import Bundle, State

# Where each stage begins on the bar, from the seconds of a 10,000-point cloud and of an RGB-D room on two cores.
STAGE_STARTS = {
    "VALIDATING": 0.0,
    "POINT_CLOUD": 0.05,
    "FITTING": 0.25,
    "EXTRACTING": 0.40,
    "TEXTURING": 0.75,
    "PACKING": 0.80,
    "PUBLISHING": 0.95,
}
# The same of photos, which have to become depth images first: that takes longer than all the rest.
PHOTO_STARTS = {"VALIDATING": 0.0, "ALIGNING": 0.01} | {
    stage: 0.6 + 0.4 * start for stage, start in STAGE_STARTS.items() if stage != "VALIDATING"
}
# The same of the second pass, whose training takes most of its time.
REFINED_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.80, "TEXTURING": 0.92, "PACKING": 0.94, "PUBLISHING": 0.99}
PREVIEW_SHARE = 0.15  # of the bar, where a second pass follows
PHOTO_PREVIEW_SHARE = 0.6  # the same of photos
PREVIEW_FINEST = 192  # cells of a preview that is followed: it is to be there within seconds
EXTRACT_SHARE = 0.4  # of the stage's time: extraction, the rest is cleaning


@dataclass(frozen=True, slots=True)
class PreviewKept:
    """The training brought nothing better: the preview stays what it is, and `warning` says why.

    quality  the figures of the refused surface, with the verdict; None where there was no surface
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
    isolate: bool | None = None,
    longest_m: float | None = None,
    label: str = "",
    watch: Watch = unwatched,
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Turn a capture into bundles, the preview first.

    device      where a field is trained: "cpu", "cuda:0"
    checkpoint  file that the training writes and goes on from; removing it is the caller's business
    isolate     removes the supporting plane and clutter; None: where photos were taken around one thing
    longest_m   the greatest distance between two points of the thing, metres, where the person knows it
    label       the human name kept in the manifest

    Raises CaptureError where the capture cannot give a surface, Cancelled when `watch` does; what fails behind the
    preview is no error but `PreviewKept`. Whoever stops iterating should close the generator: it may be training.
    """
    clock = Clock()
    bar = Bar(watch)
    starts, share = (PHOTO_STARTS, PHOTO_PREVIEW_SHARE) if capture.kind == "photos" else (STAGE_STARTS, PREVIEW_SHARE)
    bar.covers(starts, 0.0, share if preset.fit or preset.name == AUTOMATIC else 1.0)

    measured_capture = capture
    if capture.kind == "photos":
        yield bar.starts("ALIGNING", f"{len(capture.photos)} photos")
        with clock("ALIGNING"):
            measured_capture = to_depth(capture, tick=bar.inside("ALIGNING"))
            capture = replace(capture, verdicts=measured_capture.verdicts)

    yield bar.starts("POINT_CLOUD", f"reading {capture.format}")
    with clock("POINT_CLOUD"):
        if capture.kind == "image":
            from services.edge.guess.to_points import to_points as guessed_points  # loads torch

            points = guessed_points(capture, tick=bar.inside("POINT_CLOUD"))
        else:
            points = to_points(measured_capture, isolate=isolate, tick=bar.inside("POINT_CLOUD"))
        points = with_longest(points, longest_m) if longest_m else points
        del measured_capture  # depth images of photos are a gigabyte that no later stage wants
        preset, because = _settled(preset, points, device)
        held = hold_out(len(points), sets=2 if preset.fit and preset.fit.patience else 1)
        shown = at_most(_part(points, held == 0), preset.most_points)
    bar.covers(starts, 0.0, share if preset.fit else 1.0)

    yield bar.starts("FITTING", f"{len(shown):,} points" + (f", preset {preset.name}: {because}" if because else ""))
    with clock("FITTING"):
        unit = unit_frame(shown.xyz)
        measured = unit.to_unit(shown.xyz)
        noise = noise_of(measured, tick=bar.inside("FITTING"))
        xyz_unit = denoise(measured, noise, tick=bar.inside("FITTING"))
        distance = local_field(xyz_unit, tick=bar.inside("FITTING"))
    evidence = Evidence.of(xyz_unit, unit.to_unit(points.xyz[held == 1]))
    subject = Subject(capture, preset, because, label, shown, unit, xyz_unit, evidence)

    finest = min(preset.finest, PREVIEW_FINEST) if preset.fit else preset.finest
    preview = yield from _surface(distance, xyz_unit, subject, finest, clock, bar)
    quality = preview.quality(preset, clock.seconds)
    yield from _bundle(preview.mesh_unit, subject, "preview", quality, (), clock, bar)
    if preset.fit:
        bar.covers(REFINED_STARTS, share, 1.0)
        seen, weighed = (xyz_unit, None) if preset.denoised else (measured, noise)
        watched = unit.to_unit(points.xyz[held == 2])
        config = preset.fit if len(watched) else replace(preset.fit, patience=0)  # too few to spare any
        training = Training(seen, weighed, config, device, distance, xyz_unit, watched, checkpoint)
        yield from _refinement(training, subject, preview, quality, clock, bar)


def _refinement(
    training: Training, subject: Subject, preview: Surface, before: Mapping[str, Any], clock: Clock, bar: Bar
) -> Iterator[Progress | Bundle | PreviewKept]:
    """Train, mesh and judge. Whatever goes wrong with that, the preview has been published."""
    try:
        trained = yield from train(training, clock, bar)
        made = yield from _surface(trained.distance, trained.near, subject, subject.preset.finest, clock, bar)
    except EdgeError as error:
        yield PreviewKept(_kept(error.message, error.hints), None, dict(clock.seconds))
        return
    except MemoryError:
        yield PreviewKept(_kept("the memory does not hold it", ("name a coarser preset",)), None, dict(clock.seconds))
        return
    made = replace(made, steps=trained.steps, losses=trained.losses, device=trained.device)
    verdict = compare(preview.certificate, made.certificate)
    quality = {
        **made.quality(subject.preset, clock.seconds),
        "verdict": verdict.outcome,
        "because": verdict.because,
        "preview": before,
    }
    if verdict.outcome == "worse":
        yield PreviewKept(_kept(verdict.because, trained.warnings), quality, dict(clock.seconds))
        return
    warnings = trained.warnings
    if verdict.outcome == "even":
        warnings += (f"training shows no gain over the preview: {verdict.because}",)
    yield from _bundle(made.mesh_unit, subject, "refined", quality, warnings, clock, bar)


def _surface(
    distance: DistanceFn, near: Floats, subject: Subject, finest: int, clock: Clock, bar: Bar
) -> Generator[Progress, None, Surface]:
    """Mesh a field whose surface lies near the points (N,3), and measure it."""
    resolution = subject.preset.resolution or auto_resolution(
        near, high=finest, cells_per_spacing=subject.preset.cells_per_spacing
    )
    yield bar.starts("EXTRACTING", f"{resolution} cells along the longest side")
    with clock("EXTRACTING"):
        tick = bar.inside("EXTRACTING")
        raw = extract(distance, near, resolution=resolution, tick=part_of(tick, 0, EXTRACT_SHARE))
        mesh_unit = clean(raw, near, tick=part_of(tick, EXTRACT_SHARE, 1))
        del raw
        if len(mesh_unit.faces) == 0:
            raise EdgeError(
                "EXTRACTION_EMPTY",
                f"no surface was found among {len(near):,} points at {resolution} cells",
                hints=("capture the thing from closer and from more sides",),
            )
        return Surface(mesh_unit, resolution, certify(distance, mesh_unit, subject.evidence))


def _bundle(
    mesh_unit: Mesh,
    subject: Subject,
    state: State,
    quality: Mapping[str, Any],
    warnings: tuple[str, ...],
    clock: Clock,
    bar: Bar,
) -> Iterator[Progress | Bundle]:
    """Colour a mesh and pack it with its levels of detail, its picture and its manifest."""
    points = subject.points
    yield bar.starts("TEXTURING", f"{len(mesh_unit.faces):,} triangles")
    with clock("TEXTURING"):
        if points.rgb is not None:
            mesh_unit = carry_colours(mesh_unit, subject.xyz_unit, points.rgb)
    yield bar.starts("PACKING", "levels of detail")
    with clock("PACKING"):
        full = replace(mesh_unit, vertices=subject.unit.to_world(mesh_unit.vertices))
        to_asset = asset_frame(full.vertices, points)
        tick = bar.inside("PACKING")
        levels = _levels(full, to_asset, subject.preset, part_of(tick, 0, 0.4))
        files = {f"lod{level}.glb": to_glb(mesh) for level, mesh in enumerate(levels)}
        files["preview.png"] = render_sheet(levels[0], tick=part_of(tick, 0.5, 0.9))
        files["mesh.ply"] = ply_bytes(full)
    manifest = manifest_of(
        subject, quality=quality, levels=levels, to_asset=to_asset, seconds=clock.seconds, warnings=warnings
    )
    # The last word before the store: a job cancelled by now must publish nothing.
    yield bar.starts("PUBLISHING", f"publishing the {state}")
    yield Bundle(state=state, files=files, manifest=manifest)


def _levels(full: Mesh, to_asset: Floats, preset: Preset, tick: Tick) -> tuple[Mesh, ...]:
    """The LODs in the asset frame, finest first."""
    vertices = full.vertices @ to_asset[:3, :3].T + to_asset[:3, 3]
    return lods(replace(full, vertices=vertices), preset.lod_faces, tick=tick)


def _settled(preset: Preset, points: Points, device: str) -> tuple[Preset, str]:
    """The preset to use, and why where it was left to the points; a resolution that was asked for stays."""
    if preset.name != AUTOMATIC:
        return preset, ""
    choice = choose(traits_of(points, gpu=device != "cpu"))
    return replace(load_preset(choice.preset), resolution=preset.resolution), choice.because


def _part(points: Points, which: Bools) -> Points:
    rgb = None if points.rgb is None else points.rgb[which]
    return replace(points, xyz=points.xyz[which], rgb=rgb, confidence=points.confidence[which])


def _kept(why: str, hints: tuple[str, ...] = ()) -> str:
    return f"the preview was kept: {why}" + (f" ({'; '.join(hints)})" if hints else "")
