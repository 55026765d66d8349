"""All points of a large scene in an archive of prepared points: a file of records, written and read in parts."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.jobs.archived_arrays import invalid
from capture2vr.edge.record_files import records_in_parts

WHOLE = "whole.bin"
"""Name of the file in the archive."""
MOST_WHOLE = 200_000_000
"""Most points that are read: as many as a capture may have."""
RECORD = np.dtype([("xyz", "<f4", (3,)), ("rgb", "u1", (3,))])
"""A point: its place from the origin of the head, and sRGB, 0 where the capture has no colours."""

_FARTHEST = 1e12  # capture units from the origin


@dataclass(frozen=True, slots=True)
class ArchivedWhole:
    """What the head of the archive tells of the file."""

    points: Annotated[int, Field(ge=1, le=MOST_WHOLE)]
    origin: tuple[float, float, float]
    coloured: bool

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


def write_whole(packed: zipfile.ZipFile, whole: CloudParts, origin: Floats) -> ArchivedWhole:
    """Write all points to a zip, relative to `origin` (3,), from which float32 is exact to micrometres in a building.

    Returns their entry in the head: parts may hold fewer points than were announced, as invalid ones are dropped.
    """
    count, coloured = 0, False
    with packed.open(WHOLE, "w", force_zip64=True) as file:
        for part in whole.read():
            records = np.zeros(len(part.xyz), RECORD)
            records["xyz"] = part.xyz - origin
            if part.rgb is not None:
                coloured = True
                records["rgb"] = part.rgb
            file.write(records.tobytes())
            count += len(records)
    x, y, z = (float(value) for value in origin)
    return ArchivedWhole(count, (x, y, z), coloured)


def read_whole(path: Path, head: ArchivedWhole) -> CloudParts:
    """Check the file of an unpacked archive, and return its points, which are read from there later.

    Raises EdgeError POINTS_INVALID.
    """
    size = path.stat().st_size
    if size != head.points * RECORD.itemsize:
        raise invalid(f"has {size:,} bytes instead of those of {head.points:,} points", WHOLE)
    if not np.abs(head.origin).max() <= _FARTHEST:
        raise invalid(f"has an origin beyond {_FARTHEST:g}", WHOLE)
    for records in records_in_parts(path, RECORD):
        if not (np.abs(records["xyz"]) <= _FARTHEST).all():  # false for NaN
            raise invalid(f"has coordinates that are not finite, or beyond {_FARTHEST:g}", WHOLE)
    return CloudParts(head.points, lambda: (_cloud(each, head) for each in records_in_parts(path, RECORD)))


def _cloud(records: np.ndarray, head: ArchivedWhole) -> Cloud:
    xyz = records["xyz"].astype(np.float64) + np.array(head.origin)
    return Cloud(xyz, np.ascontiguousarray(records["rgb"]) if head.coloured else None)
