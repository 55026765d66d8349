"""Give inferred points the light that photos show there, and where none shows any, that of the points around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.mesh.edges import spread_values
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.texture.texture_mesh import Palette

_NEIGHBOURS = 8
"""Nearest points of an inferred point between which light spreads."""
_MOST = 0.5
"""Share of the points around a measured one that were inferred, above which its light counts for nothing."""
_SURE = 0.9
"""Reliability of the photos' light from which on it counts."""
_TEXEL = 2.0
"""Pixels of the photos that are averaged."""


def with_light_of_photos(palette: Palette, mesh: Mesh) -> Palette:
    """Return a mesh's palette with new light of its inferred points.

    Points were coloured before the photos' exposures were matched, and photos show background close to outlines: spread
    from measured points alone, their colours would end at a visible line. A guess keeps its colours: no photo shows it,
    and what is around it is the rim of what they show.
    """
    points = palette.points
    if points.inferred is None or palette.pictures is None or not points.inferred.any():
        return palette
    anew = points.inferred | (points.inferred_share(points.xyz) > _MOST)
    own = np.flatnonzero(anew if points.kept is None else anew & ~points.kept)
    if not len(own):
        return palette
    near = points.tree.query(points.xyz[own], k=range(2, 2 + min(_NEIGHBOURS, len(points) - 1)), workers=-1)[1]
    nodes = np.unique(np.append(own, near))
    ends = np.stack([np.repeat(own, near.shape[1]), near.ravel()], axis=1)
    places = points.xyz[nodes]
    normals = vertex_normals(mesh)[cKDTree(mesh.vertices).query(places, workers=-1)[1]]
    light, sure = palette.pictures(places, normals, _TEXEL * palette.pixel, no_tick)
    unknown = (sure < _SURE) | ~points.inferred[nodes]
    light = np.where(unknown[:, None], points.light[nodes], light)
    solved = spread_values(light, np.searchsorted(nodes, ends), unknown)
    spread = points.light.copy()
    spread[own] = solved[np.searchsorted(nodes, own)]
    return replace(palette, points=replace(points, light=spread))
