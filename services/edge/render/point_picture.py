"""Render a small picture of a coloured point cloud, from the front right and a little above, as JPEG."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats

_SIDE = 360
"""Pixels of the picture's width and height."""
_AZIMUTH_DEG, _ELEVATION_DEG = 25.0, 20.0
"""As the first view of the contact sheet, and a little higher, so that the ground shows."""
_MARGIN = 0.05
"""Of half the picture, free on every side."""
_FRAMED = (1, 99)
"""Percentiles of the points along each axis that the picture shows: a few stray ones do not shrink it."""
_AROUND = 3.0
"""Most that a picture shows, over the size of the thing: of a statue not the houses behind it."""
_BACKDROP, _UNCOLOURED = 224, 120
"""sRGB grey behind the points, and of points without colours."""
_DOT = (-1, 0, 1)
"""Pixels around a point, along each axis, that it covers: 100,000 points leave no gaps in what fills the picture."""
_QUALITY = 85


def point_picture(xyz: Floats, rgb: Bytes | None, to_asset: Floats, thing: Floats) -> bytes:
    """Render points (N,3) with sRGB colours (N,3) to a JPEG; to_asset (4,4): to the frame in which Y is up.

    thing (M,3): points that are in the middle; of what is around them at most `_AROUND` times their size is shown.
    """
    from PIL import Image

    to_view = _view_axes() @ to_asset[:3, :3]
    view, subject = to_view @ xyz.T, to_view[:2] @ thing.T
    low, high = np.percentile(subject, _FRAMED, axis=1).reshape(2, 2, 1)
    reach = np.percentile(np.abs(view[:2] - (low + high) / 2).max(axis=0), _FRAMED[1])
    half = max(min(float(reach), _AROUND * float((high - low).max()) / 2), 1e-12)
    place = np.rint(_SIDE / 2 * (1 + (1 - _MARGIN) * (view[:2] - (low + high) / 2) / half * [[1], [-1]])).astype(int)
    order = np.argsort(view[2])  # the nearest last: they cover the others
    dot = np.stack(np.meshgrid(_DOT, _DOT), axis=0).reshape(2, 1, -1)
    column, row = (place[:, order, None] + dot).reshape(2, -1)
    colours = np.full_like(xyz, _UNCOLOURED, np.uint8) if rgb is None else rgb
    colours = np.repeat(colours[order], dot.shape[2], axis=0)
    shown = (column >= 0) & (column < _SIDE) & (row >= 0) & (row < _SIDE)
    picture = np.full((_SIDE, _SIDE, 3), _BACKDROP, np.uint8)
    picture[row[shown], column[shown]] = colours[shown]
    out = BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=_QUALITY)
    return out.getvalue()


def _view_axes() -> Floats:
    """(3,3) right, up and backward axes of the camera, in the asset frame."""
    azimuth, elevation = np.radians([_AZIMUTH_DEG, _ELEVATION_DEG])
    back = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    return np.stack([right, np.cross(back, right), back])
