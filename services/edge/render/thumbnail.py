"""Small pictures for pages: one of the thing from three quarters, and one that turns it round. WebP on nothing.

The colours are straight (not times alpha), so that a page of any colour shows through the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np

from services.edge.arrays import Bytes, Tick, no_tick
from services.edge.mesh.band import part_of
from services.edge.mesh.nouns import Mesh, Textured
from services.edge.mesh.views import Subject, View, cameras, view
from services.edge.srgb import to_srgb
from services.edge.threads import in_threads

THUMBNAIL_SIDE, THUMBNAIL_BYTES = 256, 15_000  # a page of a hundred is 1.5 MB at most
TURNING_SIDE, TURNING_BYTES = 192, 200_000

_AZIMUTH, _ELEVATION = 30.0, 18.0  # degrees: front and side both show, and a little of the top
_SKY_RAYS = 400_000  # the grain of fewer would show; that of these is lost between small pixels
_FRAMES = 24  # 15° from one to the next: still read as turning
_FRAME_MS = 125  # once round in 3 s
_QUALITIES = (82, 68, 54, 40, 26, 12, 0)  # of WebP, the best that keeps within the bytes; 82 looks like the original
_PROBES = 4  # frames, evenly spread, that tell what all of them will take
_SPARE = 0.9  # of the bytes: how far the probes are trusted


def thumbnail(mesh: Mesh | Textured) -> bytes:
    """WebP of 256² pixels with alpha, the thing from three quarters, Y up; at most 15 KB.

    For LOD1 or LOD2: more faces show nothing more. Raises ValueError if there are no faces.
    """
    subject = Subject.of(mesh, THUMBNAIL_SIDE, sky_rays=_SKY_RAYS)
    (camera,) = cameras(subject, (_AZIMUTH,), _ELEVATION)
    return _within([_rgba(view(subject, camera, THUMBNAIL_SIDE))], THUMBNAIL_BYTES)


def turning(mesh: Mesh | Textured, *, tick: Tick = no_tick) -> bytes:
    """Animated WebP of 192² pixels with alpha that loops for ever: the thing turned once round Y; at most 200 KB.

    For LOD1 or LOD2. `tick` is called before the frames and after each, with the fraction done. Raises ValueError if
    there are no faces.
    """
    subject = Subject.of(mesh, TURNING_SIDE, sky_rays=_SKY_RAYS)
    tick(0)
    azimuths = [_AZIMUTH - 360 * frame / _FRAMES for frame in range(_FRAMES)]
    around = cameras(subject, azimuths, _ELEVATION)
    frames = in_threads(lambda camera: _rgba(view(subject, camera, TURNING_SIDE)), around, part_of(tick, 0, 0.8))
    animation = _within(frames, TURNING_BYTES)
    tick(1)
    return animation


def _rgba(seen: View) -> Bytes:
    """(S,S,4) uint8: sRGB and straight alpha."""
    colour = to_srgb(seen.light / np.maximum(seen.cover, 1e-6))
    return np.concatenate([colour, np.rint(255 * seen.cover).astype(np.uint8)], axis=2)


def _within(frames: Sequence[Bytes], most: int) -> bytes:
    """The frames as one WebP of the best quality that takes so many bytes at most."""
    probes = frames[:: max(1, len(frames) // _PROBES)]
    share = len(probes) / len(frames)
    for quality in _QUALITIES:
        if len(probes) < len(frames) and len(_webp(probes, quality)) > _SPARE * share * most:
            continue
        picture = _webp(frames, quality)
        if len(picture) <= most:
            break
    return picture


def _webp(frames: Sequence[Bytes], quality: int) -> bytes:
    from PIL import Image

    first, *others = (Image.fromarray(frame) for frame in frames)
    out = BytesIO()
    # Every frame on its own: a difference from the one before is no shorter where everything moves, and takes longer.
    turn = {"save_all": True, "append_images": others, "duration": _FRAME_MS, "loop": 0, "kmin": 0, "kmax": 1}
    first.save(out, "WEBP", quality=quality, method=4, **(turn if others else {}))
    return out.getvalue()
