"""Child process that decodes one point cloud: `python -m capture2vr.edge.clouds.cloud_child KIND FILE FOLDER BYTES`.

It writes the points, and their colours if there are any, to FOLDER, part by part, with at most BYTES of address space.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.edge.child_process import set_up_child
from capture2vr.edge.clouds import e57, las
from capture2vr.edge.clouds.cloud_process import COLOURS, GREYED, POSITIONS

_GREY = 128  # sRGB, of points without a colour beside points that have one
_DECODERS = {"LAZ": las.iter_points, "E57": e57.iter_points}


def main(kind: str, file: Path, folder: Path, limit_bytes: int) -> None:
    """Decode `file` into `folder` with at most `limit_bytes` of address space; every failure is a non-zero exit."""
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))
    save_parts(_DECODERS[kind](file), folder)


def save_parts(parts: Iterable[tuple[Floats, NDArray[Any] | None]], folder: Path) -> None:
    """Write parts of points, and of their colours where any part has them, to two .npy files.

    Parts without colours are grey then, and GREYED says of how many points.
    """
    count, greyed, kind = 0, 0, np.dtype(np.uint8)
    with ExitStack() as files:
        raw = [files.enter_context((folder / f"{name}.raw").open("wb")) for name in (POSITIONS, COLOURS)]
        for xyz, colours in parts:
            np.ascontiguousarray(xyz, np.float64).tofile(raw[0])
            if colours is None:
                np.full(xyz.shape, _GREY, kind).tofile(raw[1])
                greyed += len(xyz)
            else:
                kind = colours.dtype
                np.ascontiguousarray(colours).tofile(raw[1])
            count += len(xyz)
    _add_header(folder / POSITIONS, np.dtype(np.float64), count)
    if greyed < count:
        _add_header(folder / COLOURS, kind, count)
        if greyed:
            (folder / GREYED).write_text(str(greyed))
    else:
        (folder / f"{COLOURS}.raw").unlink()


def _add_header(path: Path, kind: np.dtype[Any], count: int) -> None:
    """Make a .npy of the raw rows (count,3) beside it."""
    raw = path.with_name(f"{path.name}.raw")
    with path.open("wb") as stream, raw.open("rb") as rows:
        header = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": (count, 3)}
        np.lib.format.write_array_header_1_0(stream, header)
        while block := rows.read(1 << 22):
            stream.write(block)
    raw.unlink()


if __name__ == "__main__":
    set_up_child()
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
