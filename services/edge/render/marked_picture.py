"""Mark in a photo what a mesh lacks of it, and what it has too much: the picture that people look at."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from capture2vr.edge.render.photo_comparison import LikenessCheck, SurfaceCheck
from capture2vr.edge.render.sample_image import resize_mask

_HOLE, _INSIDE, _LEAK = (255, 0, 255), (255, 200, 0), (0, 200, 255)  # sRGB signal colours


def marked_jpeg(check: SurfaceCheck, likeness: LikenessCheck | None = None, quality: int = 85) -> bytes:
    """Encode the photo beside the rendering as JPEG: holes magenta, insides yellow, leaks cyan.

    The photo is darkened where the thing is not; without a likeness the right half shows the photo's colours on the
    mesh.
    """
    from PIL import Image

    photo = check.rgb if likeness is None else likeness.photo
    shown = np.where(check.mesh[..., None], check.rgb, 32).astype(np.uint8) if likeness is None else likeness.rendering
    size = (photo.shape[1], photo.shape[0])
    shown = shown.copy()
    for mask, colour in ((check.hole, _HOLE), (check.inside, _INSIDE), (check.leak, _LEAK)):
        shown[resize_mask(mask, size)] = colour
    thing = resize_mask(check.thing, size)
    left = np.where(thing[..., None], photo, photo // 3)
    stream = BytesIO()
    Image.fromarray(np.concatenate([left, shown], axis=1)).save(stream, "JPEG", quality=quality)
    return stream.getvalue()
