"""What has been measured, one record a line in a JSON file that is committed: a full run takes hours."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import capture2vr

_EDGE = Path(__file__).parents[2] / "services" / "edge"
# What decides over a mesh of the product; the literature never sees anchors, patches or the noise estimate, so cells of
# hours stay valid when those change.
_PRODUCT = ("field", "mesh", "points", "presets", "pipeline.py", "preset.py")
_SHARED = tuple(f"field/{name}.py" for name in ("compute", "config", "schedule", "step"))
_LITERATURE = ("paper_field", *_SHARED, "mesh", "points/unit.py", "presets/literature")


@dataclass(frozen=True, slots=True)
class Record:
    """A measured cell.

    row       label of the row; `method` is the column
    settings  everything that was chosen: how the points were drawn, steps, batch, cells, seed, device
    version   of the code that made it
    figures   the measured ones, or {"failed": why}
    """

    row: str
    method: str
    settings: dict[str, Any]
    version: str
    figures: dict[str, Any]

    @property
    def key(self) -> tuple[str, str, str]:
        """A record takes the place of the one with its key."""
        return self.row, self.method, fingerprint(self.settings)


def record_of(row: str, method: str, settings: dict[str, Any], figures: dict[str, Any]) -> Record:
    """The record of what a cell answered, which names the version of its code unless it died."""
    version = figures.get("version", code_version(method))
    return Record(row, method, settings, version, {key: value for key, value in figures.items() if key != "version"})


def fingerprint(settings: dict[str, Any]) -> str:
    """Twelve hexadecimal digits that change with any setting."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:12]


def code_version(method: str) -> str:
    """The product's version and a digest of the sources that decide over that method's mesh."""
    published = (_EDGE / "presets" / "literature" / f"{method}.toml").exists()
    return f"{capture2vr.__version__}+{_digest(_LITERATURE if published else _PRODUCT)}"


@cache
def _digest(sources: tuple[str, ...]) -> str:
    digest = hashlib.sha256()
    for source in sources:
        path = _EDGE / source
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix in (".py", ".toml"):
                digest.update(file.read_bytes())
    return digest.hexdigest()[:8]


class Records:
    """The records of a file. `add` writes at once, and merges with what others have written meanwhile."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def all(self) -> dict[tuple[str, str, str], Record]:
        """By key, in the order of the file."""
        if not self._path.exists():
            return {}
        records = (Record(**each) for each in json.loads(self._path.read_text())["records"])
        return {record.key: record for record in records}

    def add(self, record: Record) -> None:
        """Put the record in its place."""
        with self._locked():
            records = {**self.all(), record.key: record}
            lines = ",\n".join(json.dumps(_as_json(each), ensure_ascii=False) for each in records.values())
            # A crash between the two leaves the old file whole.
            half = self._path.with_suffix(".tmp")
            half.write_text(f'{{"records": [\n{lines}\n]}}\n')
            half.replace(self._path)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        # The folder itself is locked: a lock beside the file would have to be cleared away, and this ends with us.
        folder = os.open(self._path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)


def _as_json(record: Record) -> dict[str, Any]:
    return {
        "row": record.row,
        "method": record.method,
        "settings": record.settings,
        "version": record.version,
        "figures": record.figures,
    }
