"""The camera model of a single photo, which the network predicts: how points are rotated and projected. Torch.

Frame of the thing: y up, the camera at azimuth 0 on the side of +z, the farthest point of the surface at distance 1.
A camera looks at the thing from azimuth 0, that is from +z. With x, y, z rotated by its elevation and roll,

    u = s·x / (1 − k·z) + a,    v = s·y / (1 − k·z) + b         in [-1,1], u to the right, v up

where k is one over the distance in radii of the thing. Six numbers: elevation, roll (radians), k, s, a, b.
"""

from __future__ import annotations

import torch
from torch import Tensor

SIDE = 64
"""Pixels along each side of the network's input; the training time is proportional to the number of pixels."""
FILL = 0.88
"""Share of the frame that the mask's longer side takes, on average."""


def project(xyz: Tensor, camera: Tensor) -> tuple[Tensor, Tensor]:
    """Project points (n,m,3) by cameras (n,6) -> places in the picture (n,m,2), and depth (n,m), larger is farther."""
    elevation, roll, k, s = (camera[:, number, None] for number in range(4))
    x, y, z = xyz.unbind(dim=2)
    # A camera above looks down: the thing's top leans towards it.
    y, z = y * elevation.cos() - z * elevation.sin(), y * elevation.sin() + z * elevation.cos()
    x, y = x * roll.cos() - y * roll.sin(), x * roll.sin() + y * roll.cos()
    scale = s / (1 - k * z).clamp(min=0.2)  # a camera that a network guesses may be inside the thing
    return torch.stack([x * scale, y * scale], dim=2) + camera[:, None, 4:], -z


def about_vertical(xyz: Tensor, yaw: Tensor) -> Tensor:
    """Rotate points (n,m,3) about the vertical by (n,) radians, from +z towards +x."""
    c, s = yaw.cos()[:, None], yaw.sin()[:, None]
    x, y, z = xyz.unbind(dim=2)
    return torch.stack([c * x + s * z, y, c * z - s * x], dim=2)
