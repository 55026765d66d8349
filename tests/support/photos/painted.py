"""Colours for meshes in tests: at the vertices, and as pictures."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.mesh.nouns import Mesh


def painted(mesh: Mesh, *rgb: int) -> Mesh:
    """The mesh in one colour."""
    return replace(mesh, rgb=np.tile(np.array(rgb, np.uint8), (len(mesh.vertices), 1)))


def jpeg(pixels: Bytes) -> bytes:
    """(H,W,3) as a JPEG that hardly loses anything."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", quality=95, subsampling=0)
    return out.getvalue()


def quarters() -> bytes:
    """A JPEG of 64² pixels: red above green on the left, blue above yellow on the right."""
    pixels = np.full((64, 64, 3), (255, 255, 0), np.uint8)
    pixels[:32, :32], pixels[32:, :32], pixels[:32, 32:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    return jpeg(pixels)
