"""Ask posed photos and their depth images what they see at places: surface, free space, or nothing that they know of.

Free space is where a view sees farther than the place; and, where the background has no depth (a sky, a plain wall),
where it shows a colour of the background instead of a colour of the surface around the place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.fill_gaps import Ask
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import pixels_at, shrink_to

_BEYOND = 0.02
"""Relative depth by which a view sees past a place, or something before it."""
_FACING = 0.25
"""Least cosine between a place's normal and the ray of a view that is asked: 75 degrees. A ray that grazes a surface
passes over it when the surface is a little too high."""
_MOST_PICTURES = 8
"""Pictures whose colours are asked, those that look at most places: each takes a tenth of a second to load."""
_LONGEST_PX = 320
"""Longer side of the pictures whose colours are asked."""
_BACKGROUND_COLOURS = 12
"""Clusters (k-means) of the background's colours in a picture."""
_SILHOUETTE_PX = 9
"""Side of the square around each projected point that is not background."""
_LEAST_BACKGROUND = 0.02
"""Share of the picture: with less of it, nothing is known of the background."""
_NEIGHBOURS = 16
"""Points around a place whose colours it may have."""
_NEARER = 0.5
"""A background's colour is at most this times as far as the surface's from what the picture shows."""
_UNLIKE = 30.0
"""Least distance, in sRGB levels, from the surface's colours at which a place is taken for background."""


@dataclass(frozen=True, slots=True)
class ColouredSurface:
    """Known surface: xyz (N,3) in the pictures' frame, and its colours rgb (N,3) sRGB."""

    xyz: Floats
    rgb: Bytes


def ask_views(pictures: Sequence[PosedPicture], surface: ColouredSurface | None = None) -> Ask:
    """Return a function from places (N,3) and unit normals (N,3), in the pictures' frame, to
    the number of views (N,) that see past each, into free space; 0 where as many see surface there.

    surface: known surface, to tell background by its colours; None: only depth is asked.
    """

    def ask(places: Floats, normals: Floats) -> Ints:
        past, on = (np.zeros(len(places), np.int64) for _ in range(2))
        seen = []
        for picture in pictures:
            index, behind, there, unknown = _look(picture, places, normals)
            past[index] += behind
            on[index] += there
            seen.append(index[there | unknown])
        if surface is not None:
            most = sorted(range(len(pictures)), key=lambda number: -len(seen[number]))[:_MOST_PICTURES]
            near = cKDTree(surface.xyz).query(places, k=range(1, 1 + min(_NEIGHBOURS, len(surface.xyz))), workers=-1)[1]
            for number in most:
                index = seen[number]
                if len(index):
                    past[index] += _shows_background(pictures[number], places[index], near[index], surface)
        return np.where(past > on, past, 0)

    return ask


def _look(picture: PosedPicture, places: Floats, normals: Floats) -> tuple[Ints, Bools, Bools, Bools]:
    """Return the places (M,) in a picture, whether it sees past each, whether it sees surface there, and whether it
    looks at it and knows nothing."""
    index, at, z = picture.in_view(places)
    found = pixels_at(picture.depth(), at)
    towards = picture.eye - places[index]
    # The sign of a normal says nothing on an open surface.
    cosine = np.abs(np.einsum("nx,nx->n", towards, normals[index])) / np.linalg.norm(towards, axis=1)
    facing, unknown = cosine > _FACING, found == 0
    there = np.abs(found - z) <= _BEYOND * z
    return index, (found > (1 + _BEYOND) * z) & facing, there & facing, unknown & facing


def _shows_background(picture: PosedPicture, places: Floats, near: Ints, surface: ColouredSurface) -> Bools:
    """(N,) whether the picture shows a colour of its background at places, and not one of the surface near (N,K)."""
    import cv2

    rgb = shrink_to(picture.load_rgb(), _LONGEST_PX)
    size = rgb.shape[1::-1]
    _, at, _ = picture.in_view(surface.xyz)
    on = np.zeros(rgb.shape[:2], np.uint8)
    column, row = np.minimum(at * size, np.array(size) - 1).astype(np.int64).T
    on[row, column] = 1
    background = rgb[cv2.dilate(on, np.ones((_SILHOUETTE_PX,) * 2, np.uint8)) == 0].astype(np.float32)
    if len(background) < _LEAST_BACKGROUND * on.size:
        return np.zeros(len(places), bool)
    some = background[np.random.default_rng(0).permutation(len(background))[:4_000]]
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_MAX_ITER, 10, 0.0)
    count = min(_BACKGROUND_COLOURS, len(some))
    _, _, centres = cv2.kmeans(some, count, np.empty(0), stop, 1, cv2.KMEANS_PP_CENTERS)
    colour = pixels_at(rgb, picture.project(places)[0]).astype(np.float32)
    to_surface = np.linalg.norm(surface.rgb[near].astype(np.float32) - colour[:, None], axis=2).min(axis=1)
    to_background = np.linalg.norm(centres[None] - colour[:, None], axis=2).min(axis=1)
    return np.asarray((to_surface > _UNLIKE) & (to_background < _NEARER * to_surface))
