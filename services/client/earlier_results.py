"""Find, and remove, the files that an earlier `run` or `pull` has written to a folder."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from capture2vr.errors import BadInput
from capture2vr.storage.bundle import sha256_of

MANIFEST, REPORT = "manifest.json", "report.json"
"""What `pull` and `run` write beside their files: it lists them."""

BUNDLE, PREVIEW, PICTURES = "bundle", "preview", "pictures"
"""Folders of a run's results, and where its report lists the pictures that are not part of the bundle."""

SOURCE = "source"
"""Where a run's report has the name of its capture, if that lies beside the results; else ""."""

_REFINED_PICTURE = "refined.png"
_DATABASE = "gateway.db"


def listed_files(document: dict[str, Any]) -> list[str]:
    """Return the names of a bundle's files that a manifest or a report lists. Raises KeyError, TypeError."""
    if "bytes" in document:  # of `run`
        return [Path(str(name)).name for name in document["bytes"]]
    return [Path(str(each["file"])).name for each in document["files"]]


def is_run(out: Path) -> bool:
    """Return whether an earlier run has written to the folder."""
    return _report(out) is not None


def folder_of_others(out: Path) -> Path | None:
    """Find a folder in `out` that a run would overwrite and that no run has made; None if all is clear."""
    # A run that was killed early leaves a store without a report.
    is_store = (out / BUNDLE / ".meta").is_dir()
    names = () if is_run(out) else (PREVIEW,) if is_store else (BUNDLE, PREVIEW)
    return next((out / name for name in names if (out / name).exists()), None)


def check_capture(capture: Path) -> None:
    """Raises BadInput where a folder inside of the capture's has results of a run, or a gateway's data.

    Their meshes would be taken for the capture.
    """
    for path in sorted(capture.rglob("*")) if capture.is_dir() else ():
        is_ours = path.name == _DATABASE or (path.name == REPORT and is_run(path.parent))
        if is_ours and path.parent != capture:
            raise BadInput(f"{path.parent} lies in the capture and was made by capture2vr: move it to another folder")


def files_of_run(out: Path) -> list[Path]:
    """Return the files in `out` that the report of an earlier run lists."""
    report = _report(out)
    if report is None:
        return []
    try:
        names = [*listed_files(report), *(Path(str(name)).name for name in report.get(PICTURES) or ())]
    except (KeyError, TypeError):
        return []
    return [out / name for name in (*names, _REFINED_PICTURE) if (out / name).is_file()]


def files_of_both(out: Path) -> list[Path]:
    """Return the files in `out` of an earlier run and of an earlier pull, which `remove_earlier` removes."""
    pulled = files_of_pull(out)
    return [*files_of_run(out), *pulled, *([out / MANIFEST] if pulled else [])]


def remove_earlier(out: Path) -> None:
    """Remove what an earlier run or pull has written to `out`, and nothing else. Raises OSError."""
    for path in files_of_both(out):
        with suppress(FileNotFoundError):  # listed by both
            path.unlink()
    for name in (BUNDLE, PREVIEW) if folder_of_others(out) is None else ():
        shutil.rmtree(out / name, ignore_errors=True)


def names_of_both(out: Path) -> set[str]:
    """Return the names of the files in `out` that an earlier run or pull says it has written, changed since or not."""
    names = {path.name for path in files_of_run(out)}
    try:
        return {*names, MANIFEST, *listed_files(json.loads((out / MANIFEST).read_bytes()))}
    except (OSError, ValueError, KeyError, TypeError):  # no manifest, or not one of ours
        return names


def files_of_pull(out: Path) -> list[Path]:
    """Return the files in `out` that the manifest of an earlier pull lists, and that are unchanged since."""
    try:
        records = json.loads((out / MANIFEST).read_bytes())["files"]
        files = {out / Path(str(each["file"])).name: str(each["sha256"]) for each in records}
    except (OSError, ValueError, KeyError, TypeError):  # no manifest, or not one of ours
        return []
    return [path for path, sha256 in files.items() if path.is_file() and sha256_of(path) == sha256]


def _report(out: Path) -> dict[str, Any] | None:
    """Return the report of an earlier run; None where there is none, or it is not one of ours."""
    try:
        report = json.loads((out / REPORT).read_bytes())
    except (OSError, ValueError):
        return None
    return report if isinstance(report, dict) and "certificates" in report else None
