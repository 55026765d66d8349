"""The one place where the library calls the pipeline: converts its callers' keywords, and keeps the bundles."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.pipeline import PreviewKept
from capture2vr.edge.pipeline import reconstruct as run
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset
from capture2vr.edge.progress import Progress
from capture2vr.errors import BadInput
from capture2vr.order.job_fields import JobFields, ReconstructionFields, options_of
from capture2vr.storage.bundle import Bundle


@dataclass(frozen=True, slots=True)
class MadeBundles:
    """What the pipeline made: the preview, the last bundle, which may be the preview, and why that was kept, if so."""

    preview: Bundle
    last: Bundle
    kept: PreviewKept | None


def run_pipeline(
    capture: Capture,
    preset: str,
    fields: ReconstructionFields,
    *,
    resolution: int,
    device: str,
    generator: str,
    models: str | Path,
    watch: Callable[[Progress], None],
) -> MadeBundles:
    """Reconstruct a capture. resolution: cells along the longest side, 0: as the preset has it; generator: address of
    the one that the preset generate asks, "": none; models: folder of learned models, "": none

    Raises EdgeError, CaptureError, and BadInput for a keyword's value that does not fit.
    """
    said = options_of(cast(JobFields, fields))  # the fields that only a gateway knows are left out
    said = replace(said, preset="" if preset == AUTOMATIC else preset)
    chosen = load_preset(said.completed().preset)
    chosen = replace(chosen, resolution=resolution or chosen.resolution)
    options = replace(said, cut=said.cut or said.edits.cut or "auto", preset=chosen.name).completed()
    computes_on = _device(chosen, device)
    folder = ModelFolder(Path(models), computes_on) if models else None
    resources = JobResources(computes_on, generator=_generator(generator), models=folder)
    steps = run(capture, chosen, options, resources, watch=watch)
    bundles: list[Bundle] = []
    kept = None
    with closing(steps):
        for step in steps:
            match step:
                case Bundle():
                    # Tiles lie in a folder that is removed with the generator.
                    bundles.append(replace(step, files=dict(step.files)))
                case PreviewKept():
                    kept = step
                case Progress():
                    watch(step)
    preview = next(each for each in reversed(bundles) if each.state == "preview")
    return MadeBundles(preview, bundles[-1], kept)


def _generator(address: str) -> GeneratorServer | None:
    try:
        return GeneratorServer.at(address)
    except ValueError as error:
        raise BadInput(f"generator {error}") from None


def _device(preset: Preset, name: str) -> str:
    """Find the device to train on; PyTorch is not loaded where nothing is trained."""
    from capture2vr.edge.field.device import find_device

    return find_device(name).name if preset.fit or preset.name == AUTOMATIC else "cpu"
