"""`capture2vr run`: the whole pipeline in one process, results in a folder."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

from services.cli.assets import check_collection
from services.cli.errors import NO_KEY, BadInput, plain, sentence
from services.cli.progress import StageBar, console, warn
from services.cli.report import page
from services.edge.capture.nouns import Capture
from services.edge.errors import EdgeError
from services.edge.mesh.nouns import Mesh
from services.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes
from services.edge.target import Target, target_of, wants_ktx2
from services.storage.archives import ArchiveError, is_zip, unpack
from services.storage.bundle import Bundle
from services.storage.catalogue import DEFAULT_COLLECTION, valid_key
from services.storage.local import LocalStore
from services.storage.publish import Asset, publish

_PICTURE = "preview.png"  # its name in a bundle of either state
_OF_AN_EARLIER_RUN = ("bundle", "preview", "refined.png")


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked of the pipeline besides a preset.

    key        asset key; "": from the capture's name
    collection what the bundle's catalogue is called
    isolate    cut the thing from its surroundings; None: where photos were taken around one thing
    longest_m  metres between the farthest points of the thing, or None
    target     device class whose budget the levels must keep within; "": none
    reference  a mesh of the same thing that the result is measured against, or None
    """

    key: str = ""
    collection: str = DEFAULT_COLLECTION
    isolate: bool | None = None
    longest_m: float | None = None
    target: str = ""
    reference: Path | None = None


DEFAULTS = Wanted()


def run_capture(source: Path, out: Path, wanted: Wanted, *, preset: str, device: str, resolution: int) -> None:
    """Reconstruct `source` into `out` with a preset by name. Raises BadInput."""
    try:
        chosen = load_preset(preset)
    except EdgeError as error:
        raise BadInput(sentence(error.message, hints=error.hints)) from error
    chosen = replace(chosen, resolution=resolution or chosen.resolution)
    run_preset(source, out, chosen, wanted, device=device)


def run_preset(source: Path, out: Path, preset: Preset, wanted: Wanted = DEFAULTS, *, device: str = "auto") -> None:
    """Reconstruct `source` into `out`, which is only touched once there is a result. Raises BadInput.

    Killed while it trained and begun again with the same arguments, it goes on from `out`/fit.checkpoint.
    """
    key = wanted.key or key_from(source)
    if not valid_key(key):
        raise BadInput(NO_KEY.format(key))
    check_collection(wanted.collection)
    _check_writable(out)
    reference = _surface_of(wanted.reference) if wanted.reference else None
    try:
        with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
            results = Results(out, key, wanted.collection, reference)
            _reconstruct_into(results, opened(source, Path(scratch)), preset, device, wanted, plain(source.stem))
    except (EdgeError, ArchiveError) as error:
        raise BadInput(_told(error, source)) from error


def _surface_of(path: Path) -> Mesh:
    """The reference in a file. Raises BadInput."""
    try:
        with path.open("rb") as stream:
            mesh = _mesh_of(stream, path.suffix.lstrip(".").lower())
    except Exception as error:  # readers of a dozen formats raise what they like
        raise BadInput(f"{path} cannot be read as a mesh: {error}") from error
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise BadInput(f"{path} is no surface: it has {len(mesh.faces)} faces; name a mesh with --reference")
    return mesh


def _mesh_of(stream: IO[bytes], kind: str) -> Mesh:
    import trimesh

    loaded = trimesh.load_mesh(stream, file_type=kind, process=False)
    return Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64))


def key_from(source: Path) -> str:
    """An asset key from a file's name: "My shirt.ply" -> "My-shirt"."""
    stem = source.resolve().stem if source.is_file() else source.resolve().name
    return re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip("._-")[:100] or "capture"


def _check_writable(out: Path) -> None:
    """Find out before the work, not after it."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise BadInput(f"{there} is a file; name a folder with -o")
    if not os.access(there, os.W_OK):
        raise BadInput(f"{there} cannot be written to; name another folder with -o")


def opened(source: Path, scratch: Path) -> Path:
    """The capture's folder or file: an archive is unpacked into `scratch` first."""
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    if not source.is_file() and not source.is_dir():
        raise BadInput(f"{source} is neither a file nor a folder")  # reading a pipe or a device may never end
    # Record3D's archive is read as it is; another file's name promises an archive whatever its bytes are.
    if source.is_file() and source.suffix.lower() != ".r3d" and (source.suffix.lower() == ".zip" or is_zip(source)):
        unpack(source, scratch / "capture")
        return scratch / "capture"
    return source


def _reconstruct_into(results: Results, folder: Path, preset: Preset, device: str, wanted: Wanted, label: str) -> None:
    from services.edge.capture import read_capture
    from services.edge.pipeline import PreviewKept, reconstruct
    from services.edge.progress import Progress

    target = _target(wanted.target)
    with StageBar() as bar:

        def show(progress: Progress) -> None:
            bar.show(progress.stage, progress.fraction, progress.message, progress.losses)

        bar.show("VALIDATING", 0.0)
        capture = read_capture(folder)
        place = _room_for(preset, capture, device)
        steps = reconstruct(
            capture,
            preset,
            device=place,
            checkpoint=results.checkpoint,
            isolate=wanted.isolate,
            longest_m=wanted.longest_m,
            label=label,
            target=target,
            watch=show,
        )
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
    _print_result(results.out, results.report)


def _target(name: str) -> Target:
    """By name; the encoder of KTX2 is where a worker would look for it. Raises EdgeError, and BadInput."""
    from services.edge.mesh.ktx2 import Ktx2Encoder
    from services.edge.settings import EdgeSettings

    if not wants_ktx2(name):
        return target_of(name)
    try:
        folder = EdgeSettings().ktx2
    except ValueError as error:
        raise BadInput(str(error)) from error
    return target_of(name, Ktx2Encoder.at(folder) if folder else None)


def _room_for(preset: Preset, capture: Capture, wanted: str) -> str:
    """The device to train on. Raises EdgeError DEVICE_ABSENT, and MEMORY_EXCEEDED before any work is done."""
    from services.edge.field.device import find_device
    from services.edge.memory import machine_bytes

    if not preset.fit and preset.name != AUTOMATIC:
        return "cpu"  # whose memory is told as the work goes on: nothing is trained
    device = find_device(wanted)
    if preset.fit:
        points = len(capture.cloud.xyz) if capture.cloud else preset.most_points
        takes, has = memory_bytes(preset, points, device.name), device.memory_bytes or machine_bytes()
        if takes > has:
            raise EdgeError(
                "MEMORY_EXCEEDED",
                f"preset {preset.name} takes {takes / 1e9:.2f} GB for {points:,} points; "
                f"{device.description} has {has / 1e9:.2f} GB for it",
                hints=("name another preset; `capture2vr presets` lists what each takes",),
            )
        console.print(f"preset {preset.name} on {device.description}: at most {takes / 1e9:.2f} GB of memory")
    return device.name


class Results:
    """The folder that a person looks at: the best there is on top, and the bundle as it would stand on a store.

    Once there is a refined mesh, the files of the preview stand in `preview/`; the pictures stand side by side.
    """

    def __init__(
        self, out: Path, key: str, collection: str = DEFAULT_COLLECTION, reference: Mesh | None = None
    ) -> None:
        self.out = out
        self._collection = collection
        self._reference = reference
        self.checkpoint = out / "fit.checkpoint"
        self.report: dict[str, Any] = {}
        self._key = key
        self._job = uuid.uuid4().hex  # both bundles are versions of one job
        self._pictures: dict[str, bytes] = {}

    def write(self, bundle: Bundle) -> None:
        """Write a bundle's files and bring the report up to date."""
        if bundle.state == "preview":
            for name in _OF_AN_EARLIER_RUN:
                shutil.rmtree(self.out / name, ignore_errors=True)
                with suppress(FileNotFoundError, IsADirectoryError):
                    (self.out / name).unlink()
        else:
            self._move_preview()
        self.out.mkdir(parents=True, exist_ok=True)
        self._pictures[bundle.state] = bundle.files[_PICTURE]
        for name, content in bundle.files.items():
            (self.out / (f"{bundle.state}.png" if name == _PICTURE else name)).write_bytes(content)
        store = LocalStore(self.out / "bundle")
        asset: Asset = publish(bundle, store, key=self._key, job=self._job, collection=self._collection)
        quality = bundle.manifest["quality"]
        self._tell(
            {
                **bundle.manifest,
                "key": self._key,
                "state": bundle.state,
                "version": asset.version,
                "bytes": {name: len(content) for name, content in bundle.files.items()},
                "reference": self._measured(bundle.files["mesh.ply"]),
            },
            quality,
        )

    def keep_preview(self, warning: str, quality: Mapping[str, Any] | None, seconds: Mapping[str, float]) -> None:
        """No refined mesh came of the training: say so, with the figures of what was refused."""
        refused = quality or {}
        told = {**self.report, "seconds": seconds, "warnings": [*self.report["warnings"], warning]}
        self._tell(told, {**refused, "preview": self.report["quality"]})

    def _tell(self, report: dict[str, Any], quality: Mapping[str, Any]) -> None:
        preview = quality.get("preview", quality)
        refined = {key: value for key, value in quality.items() if key != "preview"}
        self.report = {
            **report,
            "verdict": quality.get("verdict", ""),
            "because": quality.get("because", ""),
            "certificates": {"preview": preview, "refined": refined if "verdict" in quality else None},
        }
        (self.out / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        (self.out / "report.html").write_text(page(self.report, self._pictures), encoding="utf-8")

    def _measured(self, ply: bytes) -> dict[str, float] | None:
        """How far the mesh lies from the reference, where there is one."""
        from services.edge.mesh.registration import overlay

        return asdict(overlay(_mesh_of(BytesIO(ply), "ply"), self._reference)) if self._reference else None

    def _move_preview(self) -> None:
        (self.out / "preview").mkdir()
        for name in self.report["bytes"]:
            if name != _PICTURE:
                (self.out / name).rename(self.out / "preview" / name)


def _print_result(out: Path, report: dict[str, Any]) -> None:
    quality, seconds = report["quality"], report["seconds"]
    size = " × ".join(f"{side:.3g}" for side in report["size_m"])
    lods = ", ".join(f"{lod['triangles']:,}" for lod in report["lods"])
    console.print(
        f"{report['points']:,} points → {quality['triangles']:,} triangles in {quality['components']:,} pieces, "
        f"{quality['non_manifold_edges']:,} non-manifold edges; {size} m (scale {report['scale_confidence']})"
    )
    console.print(f"LODs {lods} triangles; {sum(seconds.values()):.1f} s in all")
    if report["preset_because"]:
        console.print(f"preset {report['preset']}: {report['preset_because']}")
    if report["verdict"] == "better":
        console.print(f"refined better than preview: {report['because']}")
    if found := report["reference"]:
        console.print(
            f"against the reference, laid over it: median {found['median']:.3%} of its size, 90th percentile "
            f"{found['p90']:.3%}; {found['complete']:.1%} of it within 1 %"
        )
    for warning in report["warnings"]:
        warn(warning)
    console.print(f"look at {out / 'report.html'}; figures in {out / 'report.json'}")


def _told(error: EdgeError | ArchiveError, source: Path) -> str:
    file = f"{source.name}/{error.file}" if error.file and error.file != source.name else source.name
    return sentence(error.message, file=file, hints=error.hints)
