"""Decode a point cloud in a child process, for decoders in native code that may end the process on hostile bytes."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats, Tick
from services.edge.capture.colours import rgb8
from services.edge.capture.files import unreadable
from services.edge.capture.nouns import Cloud
from services.edge.child_process import ChildError, run_child
from services.edge.errors import CaptureError

POSITIONS, COLOURS = "xyz.npy", "rgb.npy"
"""Files that the child writes: (N,3) float64, and (N,3) integers if the cloud has colours."""

_CHILD_BYTES = 6 * 2**30  # limit of the child's address space; 20 million points take under 3 GiB
_CHILD_SECONDS = 120.0  # time limit of the child; 20 million points take about 40 s
_FAR = 10_000.0  # metres from the origin above which coordinates are georeferenced: no scan of a room is that large


def decode_in_child(
    kind: Literal["LAZ", "E57"], path: Path, file: str, tick: Tick
) -> tuple[Floats, NDArray[Any] | None]:
    """Decode a cloud -> xyz (N,3) float64, and the colours (N,3) as stored or None. `tick` is called meanwhile.

    Raises CAPTURE_TOO_LARGE where that takes too long, CAPTURE_UNREADABLE where the decoder fails.
    """
    with tempfile.TemporaryDirectory(prefix="cloud-") as name:
        folder = Path(name)
        module, limit = "services.edge.capture.cloud_child", str(_CHILD_BYTES)
        command = [sys.executable, "-m", module, kind, str(path.resolve()), name, limit]
        try:
            run_child(command, f"the {kind} decoder", folder / "log", tick, most_seconds=_CHILD_SECONDS)
        except ChildError as error:
            if error.too_slow:
                what = f"takes too long to decode: more than {_CHILD_SECONDS:.0f} s"
                raise CaptureError("CAPTURE_TOO_LARGE", what, file=file) from None
            raise unreadable(file, f"is not a readable {kind} (its points are damaged)") from None
        colours = folder / COLOURS
        return np.load(folder / POSITIONS), np.load(colours) if colours.exists() else None


def near_origin(xyz: Floats, rgb: NDArray[Any] | None, file: str) -> tuple[Cloud, tuple[str, ...]]:
    """Return the cloud and warnings; georeferenced coordinates (N,3) are moved near the origin to keep precision."""
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    colours = None if rgb is None else rgb8(rgb)
    if not len(finite) or np.abs(finite).max() < _FAR:
        return Cloud(xyz, colours), ()
    origin = np.floor(finite.min(axis=0))
    moved = ", ".join(f"{value:.0f}" for value in origin)
    warning = f"{file}: coordinates are georeferenced; ({moved}) was subtracted from every point"
    return Cloud(xyz - origin, colours), (warning,)
