"""Texture atlas made from vertex colours, for viewers that do not show vertex colours.

Two faces share a block of 8 × 8 texels, one in each half, so that nothing has to be unwrapped: 25,000 faces take 0.1 s.
JPEG works in blocks of that size too, so no colour spreads from one block into the next.

    face 2b    corners at texel (½,½) (5,½) (½,5) of block b: half a texel inside, so that filtering stays within
    face 2b+1  the same, turned by half a turn
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.srgb import to_linear, to_srgb

MOST_FACES = 131_072  # fill 256² blocks: a texture of 2048², the largest that every phone loads

_BLOCK = 8  # texels along each side
_NEAR, _FAR = 0.5, 5.0  # texels from the centre of the block's first texel: where the legs of a face begin and end
_QUALITY = 92  # of JPEG; its usual 75 shows in smooth shades


@dataclass(frozen=True, slots=True)
class FacePicture:
    """Texture atlas of a mesh. jpeg: sRGB, square; uv (F,3,2) float64: of each face's corners, (0,0) the upper left."""

    jpeg: bytes
    uv: Floats


def face_picture(mesh: Mesh) -> FacePicture:
    """Make the texture atlas of a mesh with colours. Raises ValueError without colours, and above MOST_FACES faces."""
    from PIL import Image

    if mesh.rgb is None:
        raise ValueError("a mesh without colours has no colour atlas")
    count = len(mesh.faces)
    if count > MOST_FACES:
        raise ValueError(f"{count:,} faces are more than the {MOST_FACES:,} of a colour atlas; use a coarser level")
    across = int(np.ceil(np.sqrt((count + 1) // 2)))
    out = BytesIO()
    Image.fromarray(_picture(mesh.rgb[mesh.faces], across)).save(out, "JPEG", quality=_QUALITY, subsampling=0)
    return FacePicture(out.getvalue(), _corners(count, across))


def _picture(corners: Bytes, across: int) -> Bytes:
    """(8·across, 8·across, 3) uint8 image from the colours (F,3,3) of the faces' corners: blocks row by row."""
    pairs = np.zeros((2 * across**2, 3, 3), np.float32)
    pairs[: len(corners)] = to_linear(corners)
    if len(corners) % 2:
        pairs[len(corners)] = pairs[len(corners) - 1]  # never shown; a smooth block takes fewer bytes
    texels = to_srgb(_weights() @ pairs.reshape(-1, 6, 3))
    blocks = texels.reshape(across, across, _BLOCK, _BLOCK, 3).swapaxes(1, 2)
    return blocks.reshape(across * _BLOCK, across * _BLOCK, 3)


def _weights() -> Floats:
    """(64,6) float32 weights of the two faces' corners at each texel of a block; linear, also beyond a face's edge."""
    along = (np.arange(_BLOCK) - _NEAR) / (_FAR - _NEAR)
    down, right = np.meshgrid(along, along, indexing="ij")
    first = np.stack([1 - right - down, right, down], axis=2)
    second = first[::-1, ::-1]
    place = np.add.outer(np.arange(_BLOCK), np.arange(_BLOCK))
    shares = (np.sign(_BLOCK - 1 - place) + 1) / 2  # 1 in the first face's half, ½ on the diagonal, 0 in the second's
    both = np.concatenate([shares[:, :, None] * first, (1 - shares)[:, :, None] * second], axis=2)
    weights: Floats = both.reshape(_BLOCK**2, 6).astype(np.float32)
    return weights


def _corners(count: int, across: int) -> Floats:
    """(count,3,2) texture coordinates of each face's corners."""
    first = np.array([[_NEAR, _NEAR], [_FAR, _NEAR], [_NEAR, _FAR]])
    inside = np.stack([first, _BLOCK - 1 - first])
    down, right = np.divmod(np.arange(count) // 2, across)
    corner = np.stack([right, down], axis=1)[:, None] * _BLOCK
    uv: Floats = (corner + inside[np.arange(count) % 2] + 0.5) / (across * _BLOCK)
    return uv
