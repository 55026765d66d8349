"""`capture2vr run`: reconstruct a capture in this process, and write the results to a folder."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

from capture2vr.cli.errors import BadInput, printable, sentence
from capture2vr.cli.key_names import check_collection, check_key
from capture2vr.cli.local.earlier_results import (
    BUNDLE,
    PICTURES,
    PREVIEW,
    SOURCE,
    check_capture,
    files_of_both,
    folder_of_others,
    remove_earlier,
)
from capture2vr.cli.local.report import report_page
from capture2vr.cli.progress import StageBar, console, warn
from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.asset.target import Target, require_encoder, target_of
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import EncodeKtx2, Ktx2Encoder
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.process.archives import ArchiveError, is_zip, unpack
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.catalogue.publish import PublishedAsset, publish
from capture2vr.storage.local import LocalStore

_PICTURE = "preview.png"  # name of the picture in bundles of both states
_READ_AS_IT_IS = (".r3d", ".usdz", ".3mf")
"""Archives that are a file to whoever reads captures: Record3D's, and models, which it names as not readable."""


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
    reference = _read_reference(options.reference) if options.reference else None
    try:
        with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
            results = Results(out, key, collection, reference, capture=source)
            capture = open_source(source, Path(scratch))
            job = replace(options.job, cut=options.job.cut or options.job.edits.cut or "auto", preset=preset.name)
            job = replace(job.completed(), names=AssetNames(printable(source.stem)))
            resources = JobResources(options.device, results.checkpoint, engine=engine)
            _reconstruct_into(results, capture, preset, job, resources, tick)
    except (EdgeError, ArchiveError) as error:
        raise BadInput(_error_sentence(error, source)) from error


def _read_reference(path: Path) -> Mesh:
    """Read the reference mesh from a file. Raises BadInput."""
    try:
        mesh = _read_mesh_file(path)
    except Exception as error:  # the readers of a dozen formats raise any exception
        raise BadInput(f"{path} cannot be read as a mesh: {error}; name a mesh file with --reference") from error
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise BadInput(
            f"{path} has {len(mesh.faces)} faces, or coordinates that are not finite; name a mesh with --reference"
        )
    return mesh


def _read_mesh_file(path: Path) -> Mesh:
    from capture2vr.edge.capture.files import Folder
    from capture2vr.edge.clouds.obj import read_obj

    if path.suffix.lower() == ".obj":  # trimesh takes relative indices for those of the whole file
        found = read_obj(Folder(path.parent, (path.name,)), path.name)
        return Mesh(found.vertices.xyz, np.zeros((0, 3), np.int64) if found.surface is None else found.surface.faces)
    with path.open("rb") as stream:
        return _read_mesh(stream, path.suffix.lstrip(".").lower())


def _read_mesh(stream: IO[bytes], kind: str) -> Mesh:
    import trimesh

    loaded = trimesh.load_mesh(stream, file_type=kind, process=False)
    return Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64))


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


def open_source(source: Path, scratch: Path) -> Path:
    """Return the capture's folder or file, unpacking an archive into `scratch`. Raises BadInput, ArchiveError."""
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    if not source.is_file() and not source.is_dir():
        raise BadInput(f"{source} is neither a file nor a folder")  # reading a pipe or a device may never end
    # A file named .zip must be an archive: if not, unpack() says so.
    suffix = source.suffix.lower()
    if source.is_file() and suffix not in _READ_AS_IT_IS and (suffix == ".zip" or is_zip(source)):
        unpack(source, scratch / "capture")
        return scratch / "capture"
    return source


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
        capture = read_capture(folder)
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
    _print_result(results.out, results.report)


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


class Results:
    """Writes the results to a folder for the user: the best mesh at the top level, the store's layout in `bundle/`.

    When there is a refined mesh, the files of the preview are moved to `preview/`; the pictures of both stay on top.
    """

    def __init__(
        self,
        out: Path,
        key: str,
        collection: str = DEFAULT_COLLECTION,
        reference: Mesh | None = None,
        *,
        capture: Path | None = None,
    ) -> None:
        self.out = out
        self._capture = capture
        self._collection = collection
        self._reference = reference
        self.checkpoint = out / "fit.checkpoint"
        self.report: dict[str, Any] = {}
        self._key = key
        self._job = uuid.uuid4().hex  # one id for both bundles, as a job's preview and refined version have
        self._pictures: dict[str, bytes] = {}
        self._compared: dict[str, bytes] = {}

    def write(self, bundle: Bundle) -> None:
        """Write a bundle's files and update the report. Raises BadInput where the capture would be overwritten."""
        self._spare_capture(bundle)
        if bundle.state == "preview":
            remove_earlier(self.out)
        else:
            self._move_preview()
        self.out.mkdir(parents=True, exist_ok=True)
        self._pictures[bundle.state] = bundle.files[_PICTURE]
        for name, content in bundle.files.items():
            (self.out / (f"{bundle.state}.png" if name == _PICTURE else name)).write_bytes(content)
        self._compared = dict(bundle.private)
        for name, content in bundle.private.items():
            (self.out / name).write_bytes(content)
        store = LocalStore(self.out / BUNDLE)
        asset: PublishedAsset = publish(bundle, store, key=self._key, job=self._job, collection=self._collection)
        quality = bundle.manifest["quality"]
        self._write_report(
            {
                **bundle.manifest,
                "key": self._key,
                "state": bundle.state,
                "version": asset.version,
                "bytes": {name: len(content) for name, content in bundle.files.items()},
                PICTURES: sorted(bundle.private),
                SOURCE: self._source,
                "reference": self._measure_distance(bundle.files["mesh.ply"]),
            },
            quality,
        )

    @property
    def _source(self) -> str:
        """The name of the capture if it lies beside the results; else ""."""
        found = self._capture
        return found.name if found and found.resolve().parent == self.out.resolve() else ""

    def _spare_capture(self, bundle: Bundle) -> None:
        """Raises BadInput where one of the results has the capture's name, in the capture's folder."""
        names = (*bundle.files, *bundle.private, f"{bundle.state}.png")
        replaced = (*(self.out / name for name in names), *files_of_both(self.out))
        if self._capture and any(path.exists() and path.samefile(self._capture) for path in replaced):
            raise BadInput(f"{self._capture} would be replaced by the result of that name: name another folder with -o")

    def keep_preview(self, warning: str, quality: Mapping[str, Any] | None, seconds: Mapping[str, float]) -> None:
        """Update the report of a run whose training gave no better mesh, with the rejected mesh's quality figures."""
        refused = quality or {}
        report = {**self.report, "seconds": seconds, "warnings": [*self.report["warnings"], warning]}
        self._write_report(report, {**refused, "preview": self.report["quality"]})

    def _write_report(self, report: dict[str, Any], quality: Mapping[str, Any]) -> None:
        preview = quality.get("preview", quality)
        refined = {key: value for key, value in quality.items() if key != "preview"}
        self.report = {
            **report,
            "verdict": quality.get("verdict", ""),
            "because": quality.get("because", ""),
            "certificates": {"preview": preview, "refined": refined if "verdict" in quality else None},
        }
        (self.out / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        (self.out / "report.html").write_text(
            report_page(self.report, self._pictures, self._compared), encoding="utf-8"
        )

    def _measure_distance(self, ply: bytes) -> dict[str, float] | None:
        """Measure the mesh's distances to the reference; None without one."""
        from capture2vr.edge.mesh.align_to_reference import overlay

        return asdict(overlay(_read_mesh(BytesIO(ply), "ply"), self._reference)) if self._reference else None

    def _move_preview(self) -> None:
        (self.out / PREVIEW).mkdir()
        for name in self.report["bytes"]:
            if name != _PICTURE:
                (self.out / name).rename(self.out / PREVIEW / name)


def _print_result(out: Path, report: dict[str, Any]) -> None:
    quality, seconds = report["quality"], report["seconds"]
    size = " × ".join(f"{side:.3g}" for side in report["size_m"])
    lods = ", ".join(f"{lod['triangles']:,}" for lod in report["lods"])
    console.print(
        f"{report['points']:,} points → {quality['triangles']:,} triangles in {quality['components']:,} pieces, "
        f"{quality['non_manifold_edges']:,} non-manifold edges; {size} m (scale {report['scale_confidence']})"
    )
    console.print(f"LODs {lods} triangles; {sum(seconds.values()):.1f} s in all")
    if tileset := report.get("tileset"):
        console.print(f"{tileset['tiles']:,} tiles of {tileset['triangles']:,} triangles together: {tileset['file']}")
    if report["preset_because"]:
        console.print(f"preset {report['preset']}: {report['preset_because']}")
    if report["verdict"] == "better":
        console.print(f"the refined mesh is better than the preview: {report['because']}")
    if found := report["reference"]:
        console.print(
            f"distance to the reference, after alignment: median {found['median']:.3%} of its size, 90th percentile "
            f"{found['p90']:.3%}; {found['complete']:.1%} of the reference is within 1 %"
        )
    for warning in report["warnings"]:
        warn(warning)
    console.print(f"report: {out / 'report.html'}; all figures: {out / 'report.json'}")


def _error_sentence(error: EdgeError | ArchiveError, source: Path) -> str:
    file = f"{source.name}/{error.file}" if error.file and error.file != source.name else source.name
    return sentence(error.message, file=file, hints=error.hints)
