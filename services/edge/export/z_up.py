"""The asset frame turned for programs whose Z axis is up: metres, the floor at z = 0."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats

Z_UP: Floats = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""(3,3) from the asset frame, in which Y is up: a quarter turn about X."""


def z_up(xyz: Floats) -> Floats:
    """Turn positions (N,3) of the asset frame."""
    turned: Floats = xyz @ Z_UP.T
    return turned
