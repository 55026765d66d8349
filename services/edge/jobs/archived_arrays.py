"""Arrays in archives that one worker sends another: written as .npy, read only as the kind and shape expected."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.errors import EdgeError

_HEADER_BYTES = 1024


def write_array(packed: zipfile.ZipFile, name: str, array: Any) -> None:
    """Write a contiguous array to a zip."""
    with packed.open(name, "w") as file:
        np.lib.format.write_array(file, array, version=(1, 0), allow_pickle=False)


def read_array(path: Path, kind: np.dtype[Any], shape: tuple[int, ...]) -> Any:
    """Read a .npy file of the expected dtype and shape: the header is checked before memory is allocated for it.

    Raises EdgeError POINTS_INVALID.
    """
    with path.open("rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            found = np.lib.format.read_array_header_1_0(file, max_header_size=_HEADER_BYTES)
        except Exception:  # noqa: BLE001 - NumPy does not document what a broken header makes its parser raise
            raise invalid("is not a .npy array", path.name) from None
        data_bytes = path.stat().st_size - file.tell()
        if version != (1, 0) or found != (shape, False, kind) or data_bytes != int(np.prod(shape)) * kind.itemsize:
            raise invalid(f"is not an array of {kind} of the shape {shape}", path.name)
        return np.fromfile(file, kind).reshape(shape)


def invalid(message: str, file: str | None = None) -> EdgeError:
    """Create the error for prepared points that are malformed: `write_prepared` would not write them."""
    hints = ("install the same version of capture2vr on both workers",)
    return EdgeError("POINTS_INVALID", f"prepared points: {message}", file=file, hints=hints)
