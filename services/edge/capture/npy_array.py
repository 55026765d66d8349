"""Memory-map the array of a .npy file without unpickling anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.capture.files import translate_errors, truncated, unreadable
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say


def npy_array(path: Path, file: str) -> NDArray[Any]:
    """Memory-map the numeric array of a .npy; pickled objects are refused.

    Raises CAPTURE_TRUNCATED when the file is shorter than its header says, CAPTURE_EMPTY for an array of size 0, and
    CAPTURE_UNREADABLE.
    """
    with translate_errors(file, "NumPy array"), path.open("rb") as stream:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = header(stream)
        start = stream.tell()
    if dtype.hasobject or (dtype.fields is None and dtype.kind not in "fiu"):
        raise unreadable(file, say("has_values_type_only_integers", type=dtype))
    count = 1
    for side in shape:
        count *= int(side)
    if count < 0 or count * dtype.itemsize > path.stat().st_size - start:
        raise truncated(file, say("cut_off_too_short_array", shape=shape))
    if count == 0:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_numbers"), file=file, hints=(say("export_capture_again"),))
    with translate_errors(file, "NumPy array"):
        return np.asarray(np.memmap(path, dtype, "r", start, shape, "F" if fortran else "C"))
