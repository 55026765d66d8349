"""The process that decodes one LAZ: `python -m services.edge.capture.laz_child FILE BYTES`.

Writes the point count (u64), whether there are colours (one byte), xyz (float64) and colours (u16) to its output.
"""

from __future__ import annotations

import resource
import struct
import sys
from pathlib import Path

import numpy as np

from services.edge.capture.las import points


def main(file: str, limit_bytes: int) -> None:
    """Decode within `limit_bytes` of address space; every failure is a non-zero exit."""
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    xyz, rgb = points(Path(file))
    out = sys.stdout.buffer
    out.write(struct.pack("<Q?", len(xyz), rgb is not None))
    out.write(np.ascontiguousarray(xyz, np.float64).data)
    if rgb is not None:
        out.write(np.ascontiguousarray(rgb, np.uint16).data)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
