"""Find the files that an earlier `run` or `pull` has written to a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from services.storage.bundle import sha256_of

MANIFEST, REPORT = "manifest.json", "report.json"
"""What `pull` and `run` write beside their files: it lists them."""


def listed_files(document: dict[str, Any]) -> list[str]:
    """Return the names of a bundle's files that a manifest or a report lists. Raises KeyError, TypeError."""
    if "bytes" in document:  # of `run`
        return [Path(str(name)).name for name in document["bytes"]]
    return [Path(str(each["file"])).name for each in document["files"]]


def files_of_run(out: Path) -> list[Path]:
    """Return the files in `out` that the report of an earlier run lists."""
    try:
        report = json.loads((out / REPORT).read_bytes())
        names = listed_files(report) if "certificates" in report else []
    except (OSError, ValueError, KeyError, TypeError):  # no report, or not one of ours
        return []
    return [out / name for name in names if (out / name).is_file()]


def files_of_pull(out: Path) -> list[Path]:
    """Return the files in `out` that the manifest of an earlier pull lists, and that are unchanged since."""
    try:
        records = json.loads((out / MANIFEST).read_bytes())["files"]
        files = {out / Path(str(each["file"])).name: str(each["sha256"]) for each in records}
    except (OSError, ValueError, KeyError, TypeError):  # no manifest, or not one of ours
        return []
    return [path for path, sha256 in files.items() if path.is_file() and sha256_of(path) == sha256]
