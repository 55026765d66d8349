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

from services.edge.arrays import Bools, DistanceFn, Floats
from services.edge.asset import Subject, Surface
from services.edge.bundled import bundled
from services.edge.capture.nouns import Capture
from services.edge.certificate import Evidence, certify, compare, hold_out
from services.edge.choose import choose, traits_of
from services.edge.errors import EdgeError
from services.edge.field.denoise import denoise
from services.edge.field.folds import noise_of
from services.edge.field.local import local_field
from services.edge.mesh import clean, extract
from services.edge.mesh.band import part_of
from services.edge.mesh.spacing import auto_resolution
from services.edge.points import Points, at_most, unit_frame
from services.edge.prepare import PREVIEW_SHARE, prepare, preview_share
from services.edge.prepared import Prepared
from services.edge.preset import AUTOMATIC, Preset, load_preset
from services.edge.progress import Bar, Clock, Progress, Watch, unwatched
from services.edge.target import NO_TARGET, Target
from services.edge.training import Training, train
from services.storage.bundle import Bundle

# Where each stage of a pass begins on its part of the bar: the preview's, whose local field is there at once, and the
# refined one's, whose training takes most of its time.
PREVIEW_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.2, "TEXTURING": 0.67, "PACKING": 0.81, "PUBLISHING": 0.93}
REFINED_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.80, "TEXTURING": 0.90, "PACKING": 0.97, "PUBLISHING": 0.99}
PREVIEW_FINEST = 192  # cells of a preview that is followed: it is to be there within seconds
EXTRACT_SHARE = 0.4  # of the stage's time: extraction, the rest is cleaning


@dataclass(frozen=True, slots=True)
class PreviewKept:
    """The training brought nothing better: the preview's surface stays what it is, and `warning` says why.

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
    target: Target = NO_TARGET,
    watch: Watch = unwatched,
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Turn a capture into bundles, the preview first.

    device      where photos are compared and a field is trained: "cpu", "cuda:0"
    checkpoint  file that the training writes and goes on from; removing it is the caller's business
    isolate     removes the supporting plane and clutter; None: where photos were taken around one thing
    longest_m   the greatest distance between two points of the thing, metres, where the person knows it
    label       the human name kept in the manifest
    target      the device class whose budget the bundles must keep within

    Raises CaptureError where the capture cannot give a surface, Cancelled when `watch` does, EdgeError
    BUDGET_UNREACHABLE behind a preview and before a refined bundle that costs more than `target` allows, and so
    KTX2_FAILED where it wants KTX2 and none can be made; what else fails behind the preview is no error but
    `PreviewKept`. Whoever stops iterating should close the generator.
    """
    bar = Bar(watch)
    refines = preset.fit is not None or preset.name == AUTOMATIC
    prepared = yield from prepare(capture, bar, refines=refines, device=device, isolate=isolate, longest_m=longest_m)
    share = preview_share(prepared.source.kind)
    yield from bundles(
        prepared, preset, bar, share=share, device=device, checkpoint=checkpoint, label=label, target=target
    )


def bundles(
    prepared: Prepared,
    preset: Preset,
    bar: Bar,
    *,
    share: float = PREVIEW_SHARE,
    device: str = "cpu",
    checkpoint: Path | None = None,
    label: str = "",
    target: Target = NO_TARGET,
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Fit a field to points and turn it into bundles: the second half of `reconstruct`, on what the bar has left.

    share  of the whole bar up to the preview, where a second pass follows
    """
    points, clock = prepared.points, Clock()
    clock.seconds.update(prepared.seconds)
    with clock("POINT_CLOUD"):
        preset, because = _settled(preset, points, device)
        held = hold_out(len(points), sets=2 if preset.fit and preset.fit.patience else 1)
        shown = at_most(_part(points, held == 0), preset.most_points)
    share = share if preset.fit else 1.0
    bar.covers(PREVIEW_STARTS, bar.reached, share)

    yield bar.starts("FITTING", f"{len(shown):,} points" + (f", preset {preset.name}: {because}" if because else ""))
    with clock("FITTING"):
        unit = unit_frame(shown.xyz)
        measured = unit.to_unit(shown.xyz)
        noise = noise_of(measured, tick=bar.inside("FITTING"))
        xyz_unit = denoise(measured, noise, tick=bar.inside("FITTING"))
        distance = local_field(xyz_unit, tick=bar.inside("FITTING"))
    evidence = Evidence.of(xyz_unit, unit.to_unit(points.xyz[held == 1]))
    subject = Subject(prepared.source, preset, because, label, target, shown, points, unit, xyz_unit, evidence)

    finest = min(preset.finest, PREVIEW_FINEST) if preset.fit else preset.finest
    preview = yield from _surface(distance, xyz_unit, subject, finest, clock, bar)
    quality = preview.quality(preset, clock.seconds)
    yield from bundled(preview.mesh_unit, subject, "preview", quality, (), clock, bar, last=preset.fit is None)
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

    def kept(why: str, quality: Mapping[str, Any] | None = None) -> Iterator[Progress | Bundle | PreviewKept]:
        """As nothing better follows, the preview once more, with all that the last bundle has."""
        yield from bundled(preview.mesh_unit, subject, "preview", before, (), clock, bar, last=True)
        yield PreviewKept(why, quality, dict(clock.seconds))

    try:
        trained = yield from train(training, clock, bar)
        made = yield from _surface(trained.distance, trained.near, subject, subject.preset.finest, clock, bar)
    except EdgeError as error:
        yield from kept(_kept(error.message, error.hints))
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
        yield from kept(_kept(verdict.because, trained.warnings), quality)
        return
    warnings = trained.warnings
    if verdict.outcome == "even":
        warnings += (f"training shows no gain over the preview: {verdict.because}",)
    yield from bundled(made.mesh_unit, subject, "refined", quality, warnings, clock, bar, last=True)


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
