"""`capture2vr run`: reconstruct a capture in this process, and write the results to a folder."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from capture2vr.cli.local.reference_mesh import read_reference
from capture2vr.cli.local.results import Results, print_result
from capture2vr.cli.printable import printable
from capture2vr.cli.progress import StageBar, console
from capture2vr.client.earlier_results import check_capture, folder_of_others
from capture2vr.client.names import check_collection, check_key
from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.asset.target import Target, require_encoder, target_of
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import EncodeKtx2, Ktx2Encoder
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes
from capture2vr.errors import BadInput, sentence
from capture2vr.library.source import open_source
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.process.archives import ArchiveError
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run on this machine.

    job        as of a job at a gateway
    key        asset key; "": made from the capture's name
    reference  a mesh of the same object to measure the result's error, or None
    device     device for training: cpu, cuda, cuda:1, or auto
    resolution grid cells along the longest side; 0: as in the preset
    """

    job: JobOptions = DEFAULT_OPTIONS
    key: str = ""
    reference: Path | None = None
    device: str = "auto"
    resolution: int = 0


DEFAULTS = RunOptions()


def run_capture(
    source: Path, out: Path, options: RunOptions = DEFAULTS, *, engine: OpenEngine | None = None, tick: Tick = no_tick
) -> None:
    """Reconstruct `source` into the folder `out`. Raises BadInput.

    engine  works at the tiles of a large scene; None: this process
    """
    run_preset(source, out, preset_of(options), options, engine=engine, tick=tick)


def preset_of(options: RunOptions) -> Preset:
    """Return the preset that the options name, or their recipe. Raises BadInput where there is none of the name."""
    try:
        preset = load_preset(options.job.completed().preset)
    except EdgeError as error:
        raise BadInput(sentence(error.message, hints=error.hints)) from error
    return replace(preset, resolution=options.resolution or preset.resolution)


def run_preset(
    source: Path,
    out: Path,
    preset: Preset,
    options: RunOptions = DEFAULTS,
    *,
    engine: OpenEngine | None = None,
    tick: Tick = no_tick,
) -> None:
    """Reconstruct `source` into the folder `out`, which stays unchanged until there is a result. Raises BadInput.

    If it is killed during training, a run with the same arguments resumes from `out`/fit.checkpoint; one that makes
    tiles, from `out`/fit.tiles.
    """
    key = options.key or key_from(source)
    check_key(key)
    collection = options.job.collection or DEFAULT_COLLECTION
    check_collection(collection)
    check_writable(out)
    check_place(out, source)
    reference = read_reference(options.reference) if options.reference else None
    try:
        with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
            results = Results(out, key, collection, reference, capture=source)
            capture = open_source(source, Path(scratch))
            job = replace(options.job, cut=options.job.cut or options.job.edits.cut or "auto", preset=preset.name)
            job = replace(job.completed(), names=AssetNames(printable(source.stem)))
            resources = JobResources(
                options.device,
                results.checkpoint,
                engine=engine,
                models=_models(options.device),
                generator=_generator(),
            )
            _reconstruct_into(results, capture, preset, job, resources, tick)
    except (EdgeError, ArchiveError) as error:
        raise BadInput(_error_sentence(error, source)) from error


def key_from(source: Path) -> str:
    """Make an asset key from a file's name: "My shirt.ply" -> "My-shirt"."""
    stem = source.resolve().stem if source.is_file() else source.resolve().name
    return re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip("._-")[:100] or "capture"


def check_writable(out: Path) -> None:
    """Raises BadInput where `out` cannot be written; called before the work begins."""
    existing = next(path for path in (out, *out.absolute().parents) if path.exists() or path.is_symlink())
    if not existing.is_dir():
        what = "is a file" if existing.exists() else "is a link to something that is not there"
        raise BadInput(f"{existing} {what}; name a folder with -o")
    if not os.access(existing, os.W_OK):
        raise BadInput(f"{existing} is not writable; name another folder with -o")


def check_place(out: Path, source: Path) -> None:
    """Raises BadInput where the results would be mixed with the capture's files, or with folders of others."""
    if source.is_dir() and out.resolve() == source.resolve():
        raise BadInput(f"{out} is the capture: name another folder with -o")
    if source.is_dir() and out.resolve().is_relative_to(source.resolve()):
        raise BadInput(f"{out} lies in the capture, and would be read as a part of it: name another folder with -o")
    check_capture(source)
    if other := folder_of_others(out):
        raise BadInput(f"{other} exists and is no result of `capture2vr run`: name another folder with -o")


def _reconstruct_into(
    results: Results, folder: Path, preset: Preset, job: JobOptions, resources: JobResources, tick: Tick
) -> None:
    from capture2vr.edge.pipeline import PreviewKept, reconstruct
    from capture2vr.edge.progress import Progress
    from capture2vr.edge.read_capture import read_capture
    from capture2vr.edge.tiles.folder import tiles_folder

    encode = _encoder(target_of(job.target))
    with StageBar() as bar:

        def show(progress: Progress) -> None:
            bar.show(progress.stage, progress.fraction, progress.message, progress.losses)
            tick(progress.fraction)

        bar.show("VALIDATING", 0.0)
        capture = read_capture(folder, reading=job.reading)
        resources = replace(resources, device=_choose_device(preset, capture, resources.device), encode=encode)
        steps = reconstruct(capture, preset, job, resources, watch=show)
        for step in steps:
            match step:
                case Bundle():
                    results.write(step)
                case PreviewKept():
                    results.keep_preview(step.warning, step.quality, step.seconds)
                case _:
                    show(step)
        bar.show("DONE", 1.0)
    results.checkpoint.unlink(missing_ok=True)
    shutil.rmtree(tiles_folder(results.checkpoint), ignore_errors=True)
    print_result(results.out, results.report)


def _models(device: str) -> ModelFolder | None:
    """Return the learned models of the setting EDGE_MODELS, as a worker does. Raises BadInput for a wrong setting."""
    from capture2vr.cli.local.edge_settings import edge_settings

    folder = edge_settings().models
    return ModelFolder(folder, device) if folder else None


def _generator() -> GeneratorServer | None:
    """Return the generator of the setting EDGE_GENERATOR, as a worker does. Raises BadInput for a wrong setting."""
    from capture2vr.cli.local.edge_settings import edge_settings

    return GeneratorServer.at(edge_settings().generator)


def _encoder(target: Target) -> EncodeKtx2 | None:
    """Return the KTX2 encoder of the setting EDGE_KTX2, as a worker does; None for targets without KTX2.

    Raises EdgeError KTX2_UNAVAILABLE, and BadInput for a wrong setting.
    """
    from capture2vr.cli.local.edge_settings import edge_settings

    if not target.ktx2:
        return None
    folder = edge_settings().ktx2
    require_encoder(target, has_encoder=folder is not None)
    return Ktx2Encoder.at(folder) if folder else None


def _choose_device(preset: Preset, capture: Capture, device_name: str) -> str:
    """Choose the device to train on, and check its memory before the work begins.

    Raises EdgeError DEVICE_ABSENT, MEMORY_EXCEEDED.
    """
    from capture2vr.edge.field.device import find_device
    from capture2vr.edge.worker.memory_budget import machine_bytes

    if not preset.fit and preset.name != AUTOMATIC:
        return "cpu"  # nothing is trained, so no memory of a training is to be checked
    device = find_device(device_name)
    if preset.fit:
        points = len(capture.cloud.xyz) if capture.cloud else preset.most_points
        takes, has = memory_bytes(preset, points, device.name), device.memory_bytes or machine_bytes()
        if takes > has:
            raise EdgeError(
                "MEMORY_EXCEEDED",
                f"preset {preset.name} needs {takes / 1e9:.2f} GB of memory for {points:,} points; "
                f"{device.description} has {has / 1e9:.2f} GB",
                hints=("use another preset; `capture2vr presets` lists the memory that each takes",),
            )
        console.print(f"preset {preset.name} on {device.description}: at most {takes / 1e9:.2f} GB of memory")
    return device.name


def _error_sentence(error: EdgeError | ArchiveError, source: Path) -> str:
    file = f"{source.name}/{error.file}" if error.file and error.file != source.name else source.name
    return sentence(error.message, file=file, hints=error.hints)
