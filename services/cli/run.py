"""`capture2vr run`: the whole pipeline in one process, results in a folder."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from services.cli.errors import NO_KEY, BadInput, plain, sentence
from services.cli.progress import StageBar, console, warn
from services.edge.errors import EdgeError
from services.edge.pipeline import Progress, reconstruct
from services.edge.preset import Preset, load_preset
from services.storage.archives import ArchiveError, is_zip, unpack
from services.storage.bundle import Bundle
from services.storage.catalogue import valid_key
from services.storage.local import LocalStore
from services.storage.publish import Asset, publish


def run_capture(source: Path, out: Path, *, preset: str, resolution: int, isolate: bool, key: str) -> None:
    """Reconstruct `source` into `out`. Raises BadInput; `out` is only touched once there is a result."""
    key = key or key_from(source)
    if not valid_key(key):
        raise BadInput(NO_KEY.format(key))
    _check_writable(out)
    try:
        chosen = load_preset(preset)
        chosen = replace(chosen, resolution=resolution or chosen.resolution)
        with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
            _reconstruct_into(out, opened(source, Path(scratch)), chosen, isolate, key, label=plain(source.stem))
    except (EdgeError, ArchiveError) as error:
        raise BadInput(_told(error, source)) from error


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


def _reconstruct_into(out: Path, folder: Path, preset: Preset, isolate: bool, key: str, label: str) -> None:
    from services.edge.capture import read_capture

    with StageBar() as bar:

        def show(progress: Progress) -> None:
            bar.show(progress.stage, progress.fraction, progress.message)

        bar.show("VALIDATING", 0.0)
        capture = read_capture(folder)
        for step in reconstruct(capture, preset, isolate=isolate, label=label, watch=show):
            if isinstance(step, Bundle):
                report = _write(out, step, key)
            else:
                show(step)
        bar.show("DONE", 1.0)
    _print_result(out, report)


def _write(out: Path, bundle: Bundle, key: str) -> dict[str, Any]:
    """Write the files a person looks at, and beside them the bundle as it would stand on a store."""
    out.mkdir(parents=True, exist_ok=True)
    for name, content in bundle.files.items():
        (out / name).write_bytes(content)
    shutil.rmtree(out / "bundle", ignore_errors=True)
    asset: Asset = publish(bundle, LocalStore(out / "bundle"), key=key)
    report = {
        **bundle.manifest,
        "key": key,
        "state": bundle.state,
        "version": asset.version,
        "bytes": {name: len(content) for name, content in bundle.files.items()},
    }
    (out / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    return report


def _print_result(out: Path, report: dict[str, Any]) -> None:
    quality, seconds = report["quality"], report["seconds"]
    size = " × ".join(f"{side:.3g}" for side in report["size_m"])
    lods = ", ".join(f"{lod['triangles']:,}" for lod in report["lods"])
    console.print(
        f"{report['points']:,} points → {quality['triangles']:,} triangles in {quality['components']:,} pieces, "
        f"{quality['non_manifold_edges']:,} non-manifold edges; {size} m ({report['scale_confidence']})"
    )
    console.print(f"LODs {lods} triangles; {sum(seconds.values()):.1f} s in all")
    for warning in report["warnings"]:
        warn(warning)
    console.print(f"look at {out / 'preview.png'}; figures in {out / 'report.json'}")


def _told(error: EdgeError | ArchiveError, source: Path) -> str:
    file = f"{source.name}/{error.file}" if error.file and error.file != source.name else source.name
    return sentence(error.message, file=file, hints=error.hints)
