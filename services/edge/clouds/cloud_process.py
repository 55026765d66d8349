"""Decode a point cloud in a child process, for decoders in native code that may end the process on hostile bytes."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Tick
from capture2vr.edge.capture.files import unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.raw_parts import PART, RawPart, RawParts
from capture2vr.edge.clouds.tables import MAX_POINTS
from capture2vr.edge.errors import CaptureError
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say

POSITIONS, COLOURS, GREYED = "xyz.npy", "rgb.npy", "greyed.txt"
"""Files that the child writes: (N,3) float64; (N,3) integers if the cloud has colours; how many it made grey."""

_CHILD_BYTES = 6 * 2**30  # limit of the child's address space; 20 million points take under 3 GiB
_CHILD_SECONDS = 120.0  # time limit of the child; 20 million points take about 40 s
_FAR = 10_000.0  # metres from the origin above which coordinates are georeferenced: no scan of a room is that large


def decode_in_child(
    kind: Literal["LAZ", "E57"], path: Path, file: str, tick: Tick
) -> tuple[Floats, NDArray[Any] | None, tuple[str, ...]]:
    """Decode a cloud -> xyz (N,3) float64, the colours (N,3) as stored or None, and warnings. Calls `tick` meanwhile.

    Raises CAPTURE_TOO_LARGE where that takes too long, CAPTURE_UNREADABLE where the decoder fails.
    """
    with tempfile.TemporaryDirectory(prefix="cloud-") as name:
        folder = Path(name)
        _decode(kind, path, file, folder, tick, _CHILD_SECONDS)
        xyz, colours = np.load(folder / POSITIONS), folder / COLOURS
        return xyz, np.load(colours) if colours.exists() else None, _greyed_warning(folder, len(xyz), file)


def _greyed_warning(folder: Path, count: int, file: str) -> tuple[str, ...]:
    """The warning that some of `count` points were made grey, if any were."""
    if not (folder / GREYED).exists():
        return ()
    return (greyed_warning(int((folder / GREYED).read_text()), count, file),)


def greyed_warning(bad: int, count: int, file: str) -> str:
    """Return the warning that so many of `count` points were made grey, because their scans have no colours."""
    what = say("points_scans_without_colours", bad=bad, count=count)
    return say("these_points_made_grey", file=file, what=what, advice=say("export_all_scans_with_colours"))


def _decode(kind: str, path: Path, file: str, folder: Path, tick: Tick, most_seconds: float) -> None:
    """Run the child, which writes POSITIONS and COLOURS to `folder`."""
    module, limit = "capture2vr.edge.clouds.cloud_child", str(_CHILD_BYTES)
    command = python_command("-m", module, kind, str(path.resolve()), str(folder), limit)
    try:
        run_child(command, f"the {kind} decoder", folder / "log", tick, most_seconds=most_seconds)
    except ChildError as error:
        if error.too_slow:
            what = say("takes_too_long_to_decode", seconds=most_seconds)
            raise CaptureError("CAPTURE_TOO_LARGE", what, file=file) from None
        raise unreadable(file, say("not_readable_points_damaged", kind=kind)) from None


def decode_to_disk(kind: Literal["LAZ", "E57"], path: Path, file: str, count: int, tick: Tick) -> RawParts:
    """Decode a large cloud in a child process to files of a temporary folder, which is removed with the last reader.

    Raises as `decode_in_child` does, of which it takes as many times the seconds as it has more points.
    """
    folder = Path(tempfile.mkdtemp(prefix="cloud-"))
    try:
        _decode(kind, path, file, folder, tick, _CHILD_SECONDS * max(1.0, count / MAX_POINTS))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    positions, colours = folder / POSITIONS, folder / COLOURS
    decoded = len(np.load(positions, mmap_mode="r"))  # fewer than announced where a scanner saw nothing

    def read() -> Iterator[RawPart]:
        for start in range(0, decoded, PART):
            yield RawPart(_rows(positions, start), _rows(colours, start) if colours.exists() else None)

    weakref.finalize(read, shutil.rmtree, folder, ignore_errors=True)
    return RawParts(decoded, read, _greyed_warning(folder, decoded, file))


def _rows(path: Path, start: int) -> NDArray[Any]:
    """One part of a .npy, by a map of its own, whose pages are freed with it."""
    return np.array(np.load(path, mmap_mode="r")[start : start + PART])


def near_origin(xyz: Floats, rgb: NDArray[Any] | None, file: str) -> tuple[Cloud, tuple[str, ...]]:
    """Return the cloud and warnings; georeferenced coordinates (N,3) are moved near the origin to keep precision."""
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    colours, notes = read_colours(rgb)
    origin = georeferenced_origin(finite.min(axis=0), finite.max(axis=0)) if len(finite) else None
    if origin is None:
        return Cloud(xyz, colours, notes=notes), ()
    return Cloud(xyz - origin, colours, None, notes, origin), (moved_warning(origin, file),)


def georeferenced_origin(low: Floats, high: Floats) -> Floats | None:
    """Return what to subtract from coordinates between low and high (3,), where they are georeferenced; else None."""
    if not max(np.abs(low).max(), np.abs(high).max()) >= _FAR or not np.isfinite(low).all():
        return None
    origin: Floats = np.floor(low)
    return origin


def moved_warning(origin: Floats, file: str) -> str:
    """Return the warning that `origin` was subtracted."""
    moved = ", ".join(f"{value:.0f}" for value in origin)
    return say("coordinates_georeferenced_subtracted_from_every", file=file, moved=moved)
