"""Make a download of a published asset: fetch the files that it is made from, convert them in a process, store it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from capture2vr.edge.arrays import Tick
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.errors import EdgeError
from capture2vr.order.download_formats import MESH
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import content_name
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload, find_download, store_download
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.reader import AssetFile, parse_manifest
from capture2vr.storage.store import Store

_MOST_BYTES = 512 << 20  # of the files that it is made from: a mesh of 20 million triangles
_MOST_SECONDS = 300.0


def make_download(store: Store, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
    """Return the download from the tenant's store, where it was made before, or make it. scratch: an empty folder.

    Raises EdgeError DOWNLOAD_* and STORE_UNAVAILABLE, and what `tick` raises.
    """
    try:
        if found := find_download(store, order):
            return found
        name = f"assets/{order.key}/{content_name('manifest.json', order.manifest)}"
        manifest = store.get(name)
        files = parse_manifest(manifest, name)
        folder = scratch / "bundle"
        folder.mkdir()
        (folder / "manifest.json").write_bytes(manifest)
        for file in _inputs(order, files, json.loads(manifest)):
            store.fetch(file.name, folder / file.file)
            tick(0.0)
        made = _convert(order, folder, scratch, tick)
        return store_download(store, order, made, {file.sha256: file.name for file in files})
    except (FileNotFoundError, CatalogueFault) as error:
        message = say("file_made", format=order.format.name)
        hints = (say("publish_asset_again_restore_file"),)
        raise EdgeError("DOWNLOAD_SOURCE_MISSING", message, hints=hints) from error
    except OSError as error:
        raise EdgeError("STORE_UNAVAILABLE", say("store_does_not_answer"), retryable=True) from error


def _inputs(order: DownloadOrder, files: Sequence[AssetFile], manifest: dict[str, Any]) -> list[AssetFile]:
    """Return the files that the format is made from. Raises EdgeError where there are too few, or they are too large.

    A level of detail with a KTX2 texture, which only graphics cards read, gets its colours from the full mesh.
    """
    by_file = {file.file: file for file in files}
    wanted = {file for file in by_file if order.format.takes(file)}
    if str(manifest.get("target", "")).endswith("-ktx2"):
        wanted.add(MESH)
    if missing := [file for file in order.format.needs if file not in by_file]:
        raise EdgeError("DOWNLOAD_IMPOSSIBLE", say("asset_has_no_made", what=missing[0], format=order.format.name))
    inputs = [by_file[file] for file in sorted(wanted & by_file.keys())]
    if (total := sum(file.size for file in inputs)) > _MOST_BYTES:
        most = say("most_can_be_converted", most=_MOST_BYTES, format=order.format.name)
        raise _too_large(say("asset_files_have_bytes", total=total, most=most))
    return inputs


def _convert(order: DownloadOrder, folder: Path, scratch: Path, tick: Tick) -> Path:
    """Convert the bundle in a process of its own, and return the file."""
    out, log = scratch / "made", scratch / "log"
    arguments: list[str | Path] = [folder, order.format.name, order.key, out]
    command = python_command("-m", "capture2vr.edge.convert", *arguments)
    try:
        run_child(command, "the conversion", log, tick, most_seconds=_MOST_SECONDS)
    except ChildError as error:
        if error.too_slow or "MemoryError" in str(error):
            what = "time" if error.too_slow else "memory"
            raise _too_large(say("asset_needs_too_much", what=what, format=order.format.name)) from error
        raise RuntimeError(say("could_not_be_converted", key=order.key, format=order.format.name, why=error)) from error
    return out


def _too_large(message: str) -> EdgeError:
    return EdgeError("DOWNLOAD_TOO_LARGE", message, hints=(say("download_another_format_asset_own"),))
