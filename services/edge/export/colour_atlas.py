"""A picture that holds the colours of vertices, for viewers that show no colours without one.

Two faces share a block of 8 × 8 texels, one in each half, so that nothing has to be unwrapped: 25,000 faces take 0.1 s.
Eight is also what JPEG works in, so no colour spreads from one block into the next.

    face 2b    corners at texel (½,½) (5,½) (½,5) of block b: half a texel inside, so that filtering stays within
    face 2b+1  the same, turned by half a turn
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.mesh.nouns import Mesh
from services.edge.srgb import to_linear, to_srgb

MOST_FACES = 131_072  # fill 256² blocks: a picture of 2048², the most that every phone loads

_BLOCK = 8  # texels along each side
_NEAR, _FAR = 0.5, 5.0  # texels from the middle of the first one: where the legs of a face begin and end
_QUALITY = 92  # of JPEG; its usual 75 shows in smooth shades


@dataclass(frozen=True, slots=True)
class FacePicture:
    """jpeg: sRGB, square. uv (F,3,2) float64: of each face's corners in it, (0,0) its upper left corner."""

    jpeg: bytes
    uv: Floats


def face_picture(mesh: Mesh) -> FacePicture:
    """The colours of a mesh that has some. Raises ValueError above `MOST_FACES` faces."""
    from PIL import Image

    if mesh.rgb is None:
        raise ValueError("a mesh without colours has no picture")
    count = len(mesh.faces)
    if count > MOST_FACES:
        raise ValueError(f"{count:,} faces are more than the {MOST_FACES:,} that a picture holds; take a coarser level")
    across = int(np.ceil(np.sqrt((count + 1) // 2)))
    out = BytesIO()
    Image.fromarray(_picture(mesh.rgb[mesh.faces], across)).save(out, "JPEG", quality=_QUALITY, subsampling=0)
    return FacePicture(out.getvalue(), _corners(count, across))


def _picture(corners: Bytes, across: int) -> Bytes:
    """(8·across, 8·across, 3) from the corners' colours (F,3,3): blocks row by row."""
    pairs = np.zeros((2 * across**2, 3, 3), np.float32)
    pairs[: len(corners)] = to_linear(corners)
    if len(corners) % 2:
        pairs[len(corners)] = pairs[len(corners) - 1]  # nobody sees it, and a smooth block is a short one
    texels = to_srgb(_weights() @ pairs.reshape(-1, 6, 3))
    blocks = texels.reshape(across, across, _BLOCK, _BLOCK, 3).swapaxes(1, 2)
    return blocks.reshape(across * _BLOCK, across * _BLOCK, 3)


def _weights() -> Floats:
    """(64,6) float32 how much each corner of the two faces counts at each texel; beyond an edge the slope goes on."""
    along = (np.arange(_BLOCK) - _NEAR) / (_FAR - _NEAR)
    down, right = np.meshgrid(along, along, indexing="ij")
    first = np.stack([1 - right - down, right, down], axis=2)
    second = first[::-1, ::-1]
    place = np.add.outer(np.arange(_BLOCK), np.arange(_BLOCK))
    shares = (np.sign(_BLOCK - 1 - place) + 1) / 2  # 1 in the first's half, ½ along the line between, 0 in the second's
    both = np.concatenate([shares[:, :, None] * first, (1 - shares)[:, :, None] * second], axis=2)
    weights: Floats = both.reshape(_BLOCK**2, 6).astype(np.float32)
    return weights


def _corners(count: int, across: int) -> Floats:
    """(count,3,2) where the corners of each face are in the picture."""
    first = np.array([[_NEAR, _NEAR], [_FAR, _NEAR], [_NEAR, _FAR]])
    inside = np.stack([first, _BLOCK - 1 - first])
    down, right = np.divmod(np.arange(count) // 2, across)
    corner = np.stack([right, down], axis=1)[:, None] * _BLOCK
    uv: Floats = (corner + inside[np.arange(count) % 2] + 0.5) / (across * _BLOCK)
    return uv
