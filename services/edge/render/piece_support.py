"""Ask posed photos about the pieces of a mesh: how many see each one, and do they agree on its colours?

A false piece, of matches that only seemed to agree, is seen by one photo, or shows something else in every one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import SplitMesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import bilinear, pixels_at, shrink_to

_PLACES = 48
"""Places on each piece: shares are then exact to 7 %."""
_ALIKE = 0.03
"""Relative difference of depth within which a photo sees a place: the largest that fusion takes for one surface."""
_SEEN = 0.25
"""Share of a piece's places that a photo which sees it sees: the other side of a leaf is hidden."""
_LONGEST_PX = 640
"""Longer side of the pictures whose colours are compared: a pixel's noise is averaged out, a print is not."""


@dataclass(frozen=True, slots=True)
class PieceSupport:
    """What the photos say of P pieces: views (P,), the number that see each; unlike (P,), by how many sRGB levels they
    differ in its colours, NaN where fewer than two see the same place."""

    views: Ints
    unlike: Floats


def piece_support(split: SplitMesh, chosen: Sequence[int], pictures: Sequence[PosedPicture]) -> PieceSupport:
    """Ask pictures with depth images about the chosen pieces (P) of a mesh in the pictures' frame."""
    rng = np.random.default_rng(0)
    places = np.concatenate([_places(split, number, rng) for number in chosen])
    owner = np.arange(len(chosen)).repeat(_PLACES)
    views = np.zeros(len(chosen), np.int64)
    seen, total, squares = np.zeros(len(places)), np.zeros((len(places), 3)), np.zeros((len(places), 3))
    for picture in pictures:
        index, at = _visible(picture, places)
        if not len(index):
            continue
        views += np.bincount(owner[index], minlength=len(chosen)) >= _SEEN * _PLACES
        rgb = bilinear(shrink_to(picture.load_rgb(), _LONGEST_PX), at).astype(np.float64)
        seen[index] += 1
        total[index] += rgb
        squares[index] += rgb**2
    unlike = _unlike(seen, total, squares).reshape(len(chosen), _PLACES)
    known = np.isfinite(unlike).any(axis=1)
    medians = np.full(len(chosen), np.nan)
    medians[known] = np.nanmedian(unlike[known], axis=1)
    return PieceSupport(views, medians)


def _places(split: SplitMesh, number: int, rng: np.random.Generator) -> Floats:
    """Draw _PLACES places on one piece."""
    return sample(Mesh(split.mesh.vertices, split.mesh.faces[split.piece == number]), _PLACES, rng).xyz


def _visible(picture: PosedPicture, places: Floats) -> tuple[Ints, Floats]:
    """Return the places (M,) that a picture's depth image confirms, and their positions (M,2) in it."""
    index, at, z = picture.in_view(places)
    confirmed = np.abs(pixels_at(picture.depth(), at) - z) < _ALIKE * z
    return index[confirmed], at[confirmed]


def _unlike(seen: Floats, total: Floats, squares: Floats) -> Floats:
    """Return the standard deviation of each place's colours over the pictures, RMS of the channels; NaN: unknown."""
    mean = total / np.maximum(seen, 1)[:, None]
    variance = np.maximum(squares / np.maximum(seen, 1)[:, None] - mean**2, 0).mean(axis=1)
    return np.where(seen >= 2, np.sqrt(variance), np.nan)
