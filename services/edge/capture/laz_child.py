"""Child process that decodes one LAZ: `python -m services.edge.capture.laz_child FILE FOLDER BYTES`.

It writes the points, and their colours if there are any, to FOLDER, with at most BYTES of address space.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np

from services.edge.capture.las import COLOURS, POSITIONS, decode_points


def main(file: Path, folder: Path, limit_bytes: int) -> None:
    """Decode `file` into `folder` with at most `limit_bytes` of address space; every failure is a non-zero exit."""
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    xyz, rgb = decode_points(file)
    np.save(folder / POSITIONS, xyz)
    if rgb is not None:
        np.save(folder / COLOURS, rgb.astype(np.uint16))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
