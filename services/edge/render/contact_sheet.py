"""Render a contact sheet of a mesh from four sides, which people look at before they open a viewer."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, no_tick
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.renderer import RenderedView, RenderMesh, place_cameras, render_view
from capture2vr.edge.render.watermark import watermark
from capture2vr.edge.srgb import to_linear, to_srgb

_AZIMUTHS = (25.0, 115.0, 205.0, 295.0)  # degrees about Y from +Z: front, right, back, left, each turned to show depth
_ELEVATION = 15.0  # degrees: high enough to look into an open neck, low enough to see under a hem
_BACKDROP = (232, 208)  # sRGB grey at the top and at the bottom of a view


def render_sheet(mesh: Mesh | TexturedMesh, *, size: int = 512, mark: str = "", tick: Tick = no_tick) -> bytes:
    """Render a PNG of (2·size)² pixels: the mesh, Y up, from front, right, back and left, all at one scale.

    mark: a word across the foot, such as that it is generated; "": none. `tick` is called before the views and after
    each, with the fraction done. Raises ValueError if there are no faces.
    """
    from PIL import Image

    subject = RenderMesh.of(mesh, size)
    tick(0)
    around = place_cameras(subject, _AZIMUTHS, _ELEVATION)
    views = in_threads(lambda camera: _over_backdrop(render_view(subject, camera, size)), around, tick)
    sheet = np.concatenate([np.concatenate(views[:2], axis=1), np.concatenate(views[2:], axis=1)])
    out = BytesIO()
    Image.fromarray(watermark(sheet, mark)).save(out, "PNG", compress_level=6)
    return out.getvalue()


def _over_backdrop(view: RenderedView) -> Bytes:
    """Composite a view over the backdrop: (size,size,3) uint8 sRGB."""
    return to_srgb(view.light + (1 - view.cover) * _backdrop(len(view.light)))


def _backdrop(rows: int) -> Floats:
    """(rows,1,3) gradient of linear grey, lighter at the top."""
    top, bottom = (to_linear(np.full((1, 3), grey, dtype=np.uint8)) for grey in _BACKDROP)
    down = np.linspace(0, 1, rows, dtype=np.float32)[:, None, None]
    shades: Floats = (1 - down) * top + down * bottom
    return shades
