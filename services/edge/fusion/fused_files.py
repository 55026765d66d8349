"""Fused points of a large scene on disk, part by part, in a temporary folder that is removed with its last reader."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.record_files import records_in_parts

_RECORD = np.dtype([("xyz", "<f4", (3,)), ("rgb", "u1", (3,)), ("confidence", "<f4")])
_GREY = 128  # sRGB of points that no picture shows, in a scene with pictures
_SEED = 0


@dataclass(slots=True, weakref_slot=True)
class FusedFiles:
    """Writes and reads the points. origin (3,) capture frame, metres, that the files are relative to."""

    origin: Floats
    folder: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="fused-")))
    count: int = 0
    coloured: bool = False

    def __post_init__(self) -> None:
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)

    def append(self, xyz: Floats, rgb: Bytes | None, confidence: Floats) -> None:
        """Append points (N,3), relative to the origin; rgb None where no picture shows any of them."""
        records = np.zeros(len(xyz), _RECORD)
        records["xyz"], records["confidence"], records["rgb"] = xyz, confidence, _GREY if rgb is None else rgb
        self.coloured |= rgb is not None
        with self._path.open("ab") as stream:
            records.tofile(stream)
        self.count += len(records)

    def sample(self, most: int) -> tuple[Floats, Bytes | None, Floats]:
        """Sample at most `most` of the points at random: xyz (N,3) in the capture frame, rgb and confidence (N,)."""
        rng = np.random.default_rng(_SEED)
        chosen = np.zeros(self.count, bool)
        chosen[rng.permutation(self.count)[:most]] = True
        records = np.concatenate([part[chosen[start : start + len(part)]] for start, part in self._parts()])
        rgb = np.ascontiguousarray(records["rgb"]) if self.coloured else None
        return self._placed(records), rgb, np.ascontiguousarray(records["confidence"])

    def whole(self) -> CloudParts:
        """Return all fused points, read from disk in parts. The temporary folder is kept as long as they are in use."""
        return CloudParts(self.count, self._clouds)

    def _clouds(self) -> Iterator[Cloud]:
        for _, part in self._parts():
            yield Cloud(self._placed(part), np.ascontiguousarray(part["rgb"]) if self.coloured else None)

    def _parts(self) -> Iterator[tuple[int, NDArray[Any]]]:
        start = 0
        for part in records_in_parts(self._path, _RECORD):
            yield start, part
            start += len(part)

    def _placed(self, records: NDArray[Any]) -> Floats:
        placed: Floats = records["xyz"].astype(np.float64) + self.origin
        return placed

    @property
    def _path(self) -> Path:
        return self.folder / "points.bin"
