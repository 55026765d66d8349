"""Write points as LAZ, the compressed form of LAS 1.2, in which every program for point clouds reads colours.

The origin of each point is in its user data, a byte that all point formats have and that viewers show as a scalar: a
classification has other meanings (2 is ground), and fields of one's own need LAS 1.4.
"""

from __future__ import annotations

from datetime import date
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats

_STEP_M = 1e-4  # of the grid of positions: as in a GLB, less than a scan can tell
_SMALL_M, _FINE = 1.0, 1e-4  # things below that size have ten thousand steps
_SIXTEEN_BITS = 257  # LAS has colours of 16 bits: 255 becomes 65,535
_PLAIN, _COLOURED = 0, 2  # point formats
_DATE = date(2000, 1, 1)  # of the file's creation, so that equal points give equal bytes


def laz_bytes(xyz: Floats, rgb: Bytes | None, origin: Bytes | None = None) -> bytes:
    """Encode points (N,3), N ≥ 1, in metres with Z up, and their colours (N,3) uint8 sRGB.

    origin (N,) uint8: 0 measured, 1 proposed, 2 filled, as `edge/origin.py`; None: all are measured
    """
    import laspy

    header = laspy.LasHeader(version="1.2", point_format=_PLAIN if rgb is None else _COLOURED)
    header.creation_date = _DATE
    header.generating_software = "capture2vr"
    size = float(np.ptp(xyz, axis=0).max())
    step = _STEP_M if size >= _SMALL_M else max(size * _FINE, 1e-9)
    header.scales, header.offsets = np.full(3, step), np.floor(xyz.min(axis=0) / step) * step
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    if rgb is not None:
        las.red, las.green, las.blue = rgb.astype(np.uint16).T * _SIXTEEN_BITS
    if origin is not None:
        las.user_data = origin
    out = BytesIO()
    las.write(out, do_compress=True)
    return out.getvalue()
