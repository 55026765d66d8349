"""What is reconstructed: a file, a folder or an archive on this machine, or points in memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.capture.units import in_unit
from capture2vr.edge.clouds.array_cloud import capture_of_points
from capture2vr.edge.read_capture import read_capture as read_folder
from capture2vr.errors import BadInput
from capture2vr.order.job_fields import options_of
from capture2vr.order.reading import AS_IT_SEEMS, FileReading, UnitName
from capture2vr.process.archives import is_zip, unpack

_READ_AS_IT_IS = (".r3d", ".usdz", ".3mf")
"""Archives that are a file to whoever reads captures: Record3D's, and models, which it names as not readable."""

Source = str | os.PathLike[str] | Capture | NDArray[Any]
"""What `reconstruct` takes: a path, a capture that was read, or points (N,3)."""


def read_capture(path: str | os.PathLike[str], *, columns: str = "", unit: UnitName = "") -> Capture:
    """Read and check a capture: a folder or a file of photos, a video, a scan of a phone's app, a point cloud, a mesh.

    Pictures and depth images are loaded when they are needed; the files have to stay where they are.

    path     a folder, or one file; an archive has to be unpacked before, except for Record3D's .r3d
    columns  of a table of points, by their numbers from 1, such as "x=2,y=3,z=4"
    unit     of the coordinates in a file: "m", "cm", "mm", "in", "ft", "us-ft", "deg"

    Returns the capture: its `kind` ("points", "rgbd", "photos" or "image"), `format`, `warnings`, and the `cloud`,
    `frames` or `photos`. Positions are in the units of the file, `metres_per_unit` of them to the metre.

    Raises CaptureError, which names the file, the reason and what to do; BadInput for columns that there cannot be.

    >>> import capture2vr
    >>> capture = capture2vr.read_capture(folder / "sphere.npy")
    >>> capture.kind, capture.cloud.xyz.shape
    ('points', (600, 3))
    """
    return read_folder(Path(path), reading=reading_of(columns, unit))


def reading_of(columns: str = "", unit: UnitName = "") -> FileReading:
    """Return what a caller says of files. Raises BadInput for columns that there cannot be."""
    return options_of({"columns": columns, "unit": unit}).reading


@contextmanager
def opened(source: Source, rgb: ArrayLike | None = None, reading: FileReading = AS_IT_SEEMS) -> Iterator[Capture]:
    """Return the capture that a source is; an archive is unpacked for as long as the block lasts.

    rgb  (N,3) colours of points in memory; reading: what is said of files. Raises BadInput, ArchiveError, CaptureError.
    """
    if isinstance(source, np.ndarray):
        yield in_unit(capture_of_points(source, rgb, unit=reading.unit), reading.unit)
        return
    if rgb is not None:
        raise BadInput("colours go with points in memory; the file or folder has its own: leave rgb out")
    if isinstance(source, Capture):
        yield in_unit(source, reading.unit)
        return
    with TemporaryDirectory(prefix="capture2vr-") as scratch:
        yield read_folder(open_source(Path(source), Path(scratch)), reading=reading)


def open_source(source: Path, scratch: Path) -> Path:
    """Return the capture's folder or file, unpacking an archive into `scratch`. Raises BadInput, ArchiveError."""
    if not source.exists():
        raise BadInput(f"{source}: there is no such file or folder")
    if not source.is_file() and not source.is_dir():
        raise BadInput(f"{source} is neither a file nor a folder")  # reading a pipe or a device may never end
    # A file named .zip must be an archive: if not, unpack() says so.
    suffix = source.suffix.lower()
    if source.is_file() and suffix not in _READ_AS_IT_IS and (suffix == ".zip" or is_zip(source)):
        unpack(source, scratch / "capture")
        return scratch / "capture"
    return source
