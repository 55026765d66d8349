"""The whole reconstruction on one page: capture (→ depth) → points → field → mesh → bundle.

Every stage is a plain function of the stage before it. `reconstruct` yields `Progress` on the way, and a `Bundle`
whenever there is something to publish: first the preview from the local field, without textures, because making them
from photos takes longer than the mesh; then the preview with textures, or, where the preset trains a field, the refined
bundle under the same key, made by the same functions from another DistanceFn. Held-out points, given to neither field,
compare the two; where the trained field is worse, or fails, `PreviewKept` is yielded instead.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from capture2vr.edge.asset.assemble import ColouredLevels
from capture2vr.edge.asset.manifest import AssetSubject, MeasuredSurface
from capture2vr.edge.asset.target import require_encoder, target_of
from capture2vr.edge.asset_maker import AssetMaker
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.capture_to_points import PREVIEW_SHARE, PreparedPoints, prepare, preview_share
from capture2vr.edge.certificate import QualityVerdict, compare
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.generated.to_points import generator_of
from capture2vr.edge.job_resources import CPU_ALONE, JobResources
from capture2vr.edge.local_fit import LocalFit, SplitPoints, fit_local, split_points
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.preset import AUTOMATIC, Preset
from capture2vr.edge.progress import Bar, Clock, Progress, Watch, ignore_progress
from capture2vr.edge.tiled_bundle import tiled_bundle
from capture2vr.edge.tiles.scene import TILE_STARTS
from capture2vr.edge.training import FieldTraining, train
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.order.option_table import Fill
from capture2vr.sentences.sentence import in_row, say
from capture2vr.storage.bundle import Bundle

# Fraction of its pass at which each stage begins. In the preview's pass the local field is there at once; in the
# refined one's the training takes most of the time.
PREVIEW_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.2, "TEXTURING": 0.67, "PACKING": 0.81, "PUBLISHING": 0.93}
# The same where the preview is published once more, with textures from photos.
TEXTURED_STARTS = {"TEXTURING": 0.0, "PACKING": 0.8, "PUBLISHING": 0.95}
REFINED_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.80, "TEXTURING": 0.90, "PACKING": 0.97, "PUBLISHING": 0.99}
# The same of a preset that trains splats, which take most of the time.
SPLATS_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.10, "TEXTURING": 0.20, "PACKING": 0.98, "PUBLISHING": 0.99}
PREVIEW_FINEST = 192  # most cells of a preview that a refined bundle follows: it must be there within seconds


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
    options: JobOptions = DEFAULT_OPTIONS,
    resources: JobResources = CPU_ALONE,
    *,
    hold_out: int | None = None,
    watch: Watch = ignore_progress,
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Reconstruct a capture: yield its bundles, the preview first, and the progress in between.

    preset    takes the place of the one that `options` name
    options   of the job; what its recipe says of cut, fill, preset and target is with the caller
    hold_out  number of photos that the result is not made from, but compared with; None: a few of 16 or more

    Raises EdgeError GENERATOR_ABSENT, GENERATOR_UNAVAILABLE and GENERATOR_FAILED where the preset asks a generator;
    CaptureError where the capture cannot give a surface; EdgeError EDITS_NOTHING_LEFT where too few points
    remain, EDITS_UNKNOWN_PHOTO where a lasso is in a photo that there is not; Cancelled when `watch` does; EdgeError
    TARGET_UNKNOWN, and KTX2_UNAVAILABLE at once where the target wants KTX2 and `resources` have no encoder; after a
    preview and before a refined bundle EdgeError BUDGET_UNREACHABLE where one costs more than the target allows, and
    KTX2_FAILED where a texture cannot be encoded.
    Any other failure after the preview is not raised, but yields `PreviewKept`. A caller that stops early should close
    the generator.
    """
    require_encoder(target_of(options.target), has_encoder=resources.encode is not None)
    bar = Bar(watch)
    refines = preset.refines or preset.name == AUTOMATIC
    prepared = yield from prepare(
        capture,
        bar,
        options,
        refines=refines,
        device=resources.device,
        hold_out=hold_out,
        models=resources.models,
        generator=generator_of(preset, resources.generator),
    )
    share = preview_share(prepared.source.kind)
    yield from bundles(prepared, preset, bar, options, resources, share=share)


def bundles(
    prepared: PreparedPoints,
    preset: Preset,
    bar: Bar,
    options: JobOptions = DEFAULT_OPTIONS,
    resources: JobResources = CPU_ALONE,
    *,
    share: float = PREVIEW_SHARE,
    refuse: RefuseTraining = lambda preset, points: "",
) -> Generator[Progress | Bundle | PreviewKept, None, None]:
    """Fit a field to points and yield its bundles: the second half of `reconstruct`, on the rest of the bar.

    share   fraction of the whole bar at which the preview ends, where a training follows
    refuse  asked once the preset and the number of points are known, before anything is fitted
    """
    clock = Clock()
    clock.seconds.update(prepared.seconds)
    with clock("POINT_CLOUD"):
        split = split_points(prepared.points, preset, resources.device)
    preset = split.preset
    refusal = refuse(preset, len(split.fitted)) if preset.refines else ""
    refines = preset.refines and not refusal
    bar.set_range(PREVIEW_STARTS, bar.reached, share if refines else 1.0)
    local = yield from fit_local(split, clock, bar)
    subject = _subject_of(prepared, split, local, options)
    maker = AssetMaker(subject, clock, bar, resources)
    preview = yield from _preview(maker, local, refines=refines)
    if refusal:
        yield PreviewKept(_kept_warning(refusal), None, dict(clock.seconds))
    if refines and preset.fit:
        bar.set_range(SPLATS_STARTS if preset.splat_steps else REFINED_STARTS, share, 1.0)
        yield from _refined(maker, _training_of(maker, local, preset.fit), preview)
    if refines and preset.tiled:
        bar.set_range(TILE_STARTS, share, 1.0)
        yield from tiled_bundle(maker, local.distance, preview.levels.to_asset, preview.quality)


@dataclass(frozen=True, slots=True)
class _Preview:
    """The preview's surface, its levels of detail and its quality figures."""

    surface: MeasuredSurface
    levels: ColouredLevels
    quality: Mapping[str, Any]


def _subject_of(prepared: PreparedPoints, split: SplitPoints, local: LocalFit, options: JobOptions) -> AssetSubject:
    fill: Fill = options.fill or ("unseen" if split.all.texture_views else "none")
    return AssetSubject(
        source=prepared.source,
        preset=split.preset,
        because=split.because,
        names=options.names,
        target=target_of(options.target),
        fill=fill,
        points=split.fitted,
        colours=split.all,
        unit=local.unit,
        xyz_unit=local.xyz_unit,
        evidence=local.evidence,
    )


def _preview(maker: AssetMaker, local: LocalFit, *, refines: bool) -> Generator[Progress | Bundle, None, _Preview]:
    """Mesh the local field and yield the preview's bundle; once more, with textures, where it is the job's last."""
    subject, clock = maker.subject, maker.clock
    finest = min(subject.preset.finest, PREVIEW_FINEST) if refines else subject.preset.finest
    surface = yield from maker.surface(local.distance, local.xyz_unit, finest)
    quality = surface.quality(subject.preset, clock.seconds)
    levels = yield from maker.levels(surface)
    if refines or subject.colours.texture_views:
        yield from maker.bundle(surface, levels, "preview", quality, last=False, brief=not refines)
    if not refines:
        maker.bar.set_range(TEXTURED_STARTS, maker.bar.reached, 1.0)
        yield from maker.bundle(surface, levels, "preview", quality, last=True)
    return _Preview(surface, levels, quality)


def _training_of(maker: AssetMaker, local: LocalFit, config: AnchorConfig | NetworkConfig) -> FieldTraining:
    """The training that follows the preview, on the points that the preset wants for it."""
    subject, resources = maker.subject, maker.resources
    if isinstance(config, NetworkConfig) and not len(local.watched):  # the cloud is too small to hold any out
        config = replace(config, patience=0)
    points, unit, denoised = subject.colours, subject.unit, subject.preset.denoised
    return FieldTraining(
        xyz_unit=local.xyz_unit if denoised else local.measured,
        noise=None if denoised else local.noise,
        config=config,
        device=resources.device,
        base=local.distance,
        smooth=local.xyz_unit,
        watched=local.watched,
        checkpoint=resources.checkpoint,
        metres=None if points.scale_confidence == "unknown" else unit.size * points.metres_per_unit,
    )


def _refined(
    maker: AssetMaker, training: FieldTraining, preview: _Preview
) -> Iterator[Progress | Bundle | PreviewKept]:
    """Train a field, mesh it, and compare it with the preview, which has been published already."""
    try:
        trained = yield from train(training, maker.clock, maker.bar)
        preset = maker.subject.preset
        made = yield from maker.surface(trained.distance, trained.near, preset.finest, preset.extraction)
    except EdgeError as error:
        yield from _keep_preview(maker, preview, _kept_warning(error.message, error.hints))
        return
    except MemoryError:
        why = _kept_warning(say("not_enough_memory_refined"), (say("choose_coarser_preset"),))
        with suppress(MemoryError):  # textures take less than a training, but may take too much too
            yield from _last_preview(maker, preview)
        yield PreviewKept(why, None, dict(maker.clock.seconds))
        return
    made = replace(made, steps=trained.steps, losses=trained.losses, device=trained.device)
    verdict = compare(preview.surface.certificate, made.certificate)
    quality = {
        **made.quality(preset, maker.clock.seconds),
        "verdict": verdict.outcome,
        "because": verdict.because,
        "preview": preview.quality,
    }
    if verdict.outcome == "worse" and not preset.literature:
        yield from _keep_preview(maker, preview, _kept_warning(verdict.because, trained.warnings), quality)
        return
    levels = yield from maker.levels(made)
    warnings = (*trained.warnings, *_verdict_warnings(verdict))
    yield from maker.bundle(made, levels, "refined", quality, warnings=warnings, last=True)


def _verdict_warnings(verdict: QualityVerdict) -> tuple[str, ...]:
    """What a person is told of a refined surface that is published although it is not better."""
    told = {"worse": "method_mesh_worse_than_preview", "even": "training_did_not_improve"}
    return (say(told[verdict.outcome], why=verdict.because),) if verdict.outcome in told else ()


def _keep_preview(
    maker: AssetMaker, preview: _Preview, why: str, quality: Mapping[str, Any] | None = None
) -> Iterator[Progress | Bundle | PreviewKept]:
    """Publish the preview's mesh again as the last bundle; quality: the figures of a rejected surface."""
    yield from _last_preview(maker, preview)
    yield PreviewKept(why, quality, dict(maker.clock.seconds))


def _last_preview(maker: AssetMaker, preview: _Preview) -> Iterator[Progress | Bundle]:
    """The preview as the job's last bundle, with textures, animation and USDZ."""
    return maker.bundle(preview.surface, preview.levels, "preview", preview.quality, last=True)


def _kept_warning(why: str, hints: tuple[str, ...] = ()) -> str:
    """The warning for people that the preview was kept, with the reason and hints."""
    kept = say("preview_kept", why=why)
    return say("with_brackets", what=kept, names=in_row("; ", hints)) if hints else kept
