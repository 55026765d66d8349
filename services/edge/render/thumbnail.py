"""Render small images for web pages: a thumbnail and a turning animation, as WebP with a transparent background.

The alpha is straight (colours are not premultiplied), so that a page of any colour shows through the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Tick, no_tick, part_of
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.renderer import Camera, RenderedView, RenderMesh, place_cameras, render_view
from capture2vr.edge.render.watermark import watermark
from capture2vr.edge.srgb import to_srgb

THUMBNAIL_SIDE, THUMBNAIL_BYTES = 256, 15_000  # pixels, bytes: a page of a hundred thumbnails is 1.5 MB at most
TURNING_SIDE, TURNING_BYTES = 192, 200_000

_AZIMUTH, _ELEVATION = 30.0, 18.0  # degrees: front and side both show, and a little of the top
_SKY_RAYS = 400_000  # the noise of fewer would show; at this size the noise of these does not
_FRAMES = 24  # 15° from one to the next: it still looks like turning
_FRAME_MS = 125  # one turn in 3 s
_LOSSLESS, _TWO_LEVELS = 100, 0  # of WebP's alpha: as it is, and without its shades between 0 and 255
# Of WebP's colours and alpha: the best that fits is taken; 82 looks like the original. Alpha that is kept as it is may
# alone take all of the bytes where a thing is full of gaps, as leaves and lace are.
_QUALITIES = (
    *((colours, _LOSSLESS) for colours in (82, 68, 54, 40, 26, 12, 0)),
    *((colours, _TWO_LEVELS) for colours in (40, 12, 0)),
)
_PROBES = 4  # evenly spread frames from which the size of all is estimated
_SPARE = 0.9  # of the bytes: what the estimate may use, for it is not exact


def thumbnail(mesh: Mesh | TexturedMesh, *, mark: str = "") -> bytes:
    """Render a WebP of 256² pixels with alpha: the mesh in three-quarter view, Y up; at most 15 KB.

    Meant for LOD1 or LOD2: more faces would not show. mark: a word across the foot, "": none. Raises ValueError if
    there are no faces.
    """
    subject = RenderMesh.of(mesh, THUMBNAIL_SIDE, sky_rays=_SKY_RAYS)
    (camera,) = place_cameras(subject, (_AZIMUTH,), _ELEVATION)
    return _compress([watermark(_rgba(render_view(subject, camera, THUMBNAIL_SIDE)), mark)], THUMBNAIL_BYTES)


def turning_preview(mesh: Mesh | TexturedMesh, *, mark: str = "", tick: Tick = no_tick) -> bytes:
    """Render an animated WebP of 192² pixels with alpha that loops for ever: the mesh turning about Y; at most 200 KB.

    Meant for LOD1 or LOD2. mark: a word across the foot, "": none. `tick` is called before the frames and after each,
    with the fraction done. Raises ValueError if there are no faces.
    """
    subject = RenderMesh.of(mesh, TURNING_SIDE, sky_rays=_SKY_RAYS)
    tick(0)
    azimuths = [_AZIMUTH - 360 * frame / _FRAMES for frame in range(_FRAMES)]
    around = place_cameras(subject, azimuths, _ELEVATION)

    def draw(camera: Camera) -> Bytes:
        return watermark(_rgba(render_view(subject, camera, TURNING_SIDE)), mark)

    frames = in_threads(draw, around, part_of(tick, 0, 0.8))
    animation = _compress(frames, TURNING_BYTES)
    tick(1)
    return animation


def _rgba(view: RenderedView) -> Bytes:
    """(S,S,4) uint8: sRGB and straight alpha."""
    colour = to_srgb(view.light / np.maximum(view.cover, 1e-6))
    return np.concatenate([colour, np.rint(255 * view.cover).astype(np.uint8)], axis=2)


def _compress(frames: Sequence[Bytes], most: int) -> bytes:
    """Encode frames as one WebP of the best quality that takes at most `most` bytes."""
    probes = frames[:: max(1, len(frames) // _PROBES)]
    share = len(probes) / len(frames)
    for quality in _QUALITIES[:-1]:
        if len(probes) < len(frames) and len(_webp(probes, *quality)) > _SPARE * share * most:
            continue
        picture = _webp(frames, *quality)
        if len(picture) <= most:
            return picture
    return _webp(frames, *_QUALITIES[-1])


def _webp(frames: Sequence[Bytes], colours: int, alpha: int) -> bytes:
    """Encode frames at these qualities, 0 to 100, of their colours and of their alpha."""
    from PIL import Image

    first, *others = (Image.fromarray(frame) for frame in frames)
    out = BytesIO()
    # Every frame is a key frame: where everything moves, a difference from the last frame is no smaller, and slower.
    turn = {"save_all": True, "append_images": others, "duration": _FRAME_MS, "loop": 0, "kmin": 0, "kmax": 1}
    first.save(out, "WEBP", quality=colours, alpha_quality=alpha, method=4, **(turn if others else {}))
    return out.getvalue()
