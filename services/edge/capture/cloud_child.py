"""Child process that decodes one point cloud: `python -m services.edge.capture.cloud_child KIND FILE FOLDER BYTES`.

It writes the points, and their colours if there are any, to FOLDER, with at most BYTES of address space.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np

from services.edge.capture import e57, las
from services.edge.capture.cloud_process import COLOURS, POSITIONS
from services.edge.child_process import set_up_child

_DECODERS = {"LAZ": las.decode_points, "E57": e57.decode_points}


def main(kind: str, file: Path, folder: Path, limit_bytes: int) -> None:
    """Decode `file` into `folder` with at most `limit_bytes` of address space; every failure is a non-zero exit."""
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))
    xyz, rgb = _DECODERS[kind](file)
    np.save(folder / POSITIONS, xyz)
    if rgb is not None:
        np.save(folder / COLOURS, rgb)


if __name__ == "__main__":
    set_up_child()
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
