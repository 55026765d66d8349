"""`capture2vr convert`: the results of `run` or `pull` in a folder, in the format of another program."""

from __future__ import annotations

import json
from pathlib import Path

from capture2vr.cli.errors import BadInput
from capture2vr.cli.local.earlier_results import MANIFEST, REPORT, SOURCE, listed_files
from capture2vr.cli.progress import console
from capture2vr.edge.convert.convert_bundle import BundleFolder, convert
from capture2vr.order.download_formats import FORMATS, formats_of
from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.catalogue.entry import valid_key


def convert_folder(folder: Path, format_name: str, out: Path | None) -> Path:
    """Convert the results in a folder; return the file. out: None: beside them. Raises BadInput.

    The capture and the results are never replaced: with a key such as "mesh" the file would have the name of one.
    """
    bundle, key, names = _open(folder)
    possible = [each.name for each in formats_of([path.name for path in folder.iterdir() if bundle.has(path.name)])]
    if format_name not in possible:
        reason = "cannot be made from what is there" if format_name in FORMATS else "is no format"
        raise BadInput(f"{folder}: {format_name} {reason}; it can be one of: {', '.join(possible) or 'none'}")
    path = out or folder / FORMATS[format_name].file_name(key)
    _check_target(path, folder, names)
    try:
        made = convert(bundle, format_name, key)
    except ValueError as error:
        raise BadInput(f"{folder}: {error}") from error
    with atomic_write(path) as part:
        part.write_bytes(made)
    console.print(f"{path}: {len(made):,} bytes", markup=False)
    return path


def _check_target(path: Path, folder: Path, names: frozenset[str]) -> None:
    """Raises BadInput where a file cannot be written, or would replace the capture or one of the results."""
    if path.resolve() in {(folder / name).resolve() for name in (*names, MANIFEST, REPORT)}:
        raise BadInput(f"{path} is the capture or one of the results, and would be lost: name another file with -o")
    if path.is_dir() or not path.parent.is_dir():
        raise BadInput(f"{path} cannot be written: name a file with -o, in a folder that exists")


def _open(folder: Path) -> tuple[BundleFolder, str, frozenset[str]]:
    """Return the bundle in a folder that was written last, its asset key, and the names of its files and capture.

    Raises BadInput.
    """
    written = [folder / name for name in (MANIFEST, REPORT) if (folder / name).is_file()]
    manifest = max(written, key=lambda path: path.stat().st_mtime_ns, default=None)
    if manifest is None:
        raise BadInput(f"{folder} has no {MANIFEST} or {REPORT}: name a folder that `run` or `pull` has written")
    try:
        document = json.loads(manifest.read_bytes())
        files, key = frozenset(listed_files(document)), str(document["key"])
        if not valid_key(key):  # it becomes a file's name
            raise ValueError(key)
        return BundleFolder(folder, document, files), key, files | {str(document.get(SOURCE) or REPORT)}
    except (ValueError, KeyError, TypeError):
        raise BadInput(f"{manifest} is damaged: not the JSON that run and pull write; run or pull again") from None
