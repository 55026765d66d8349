"""Render what of a surface was measured, proposed and filled, for the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.origin import COLOURS, PICTURE
from capture2vr.edge.render.contact_sheet import render_sheet

_SIZE = 256  # pixels along each of the four views


def pictures_of_origin(mesh: Mesh) -> dict[str, bytes]:
    """Render a mesh, Y up, from four sides in `edge/origin.py`'s colours: PNG by name; none if all is measured."""
    if mesh.origin is None:
        return {}
    colours: Bytes = np.array(COLOURS, np.uint8)[mesh.origin]
    return {PICTURE: render_sheet(replace(mesh, rgb=colours), size=_SIZE)}
