"""Infer points where a thing has surface that no photo gave depth of: dark sides, undersides, holes.

1. orient  points get normals that point to the cameras which see them; what is specks and noise counts less
                                                                                              (oriented_points.py)
2. carve   photos tell what around the thing is free space, once more by its outlines when it is roughly known
                                                                                              (carving.py)
3. close   a closed surface is fitted to the points, out of free space and over the plane that the thing stands on
                                                                                              (solid.py)
4. lay     it is laid on the points                                                           (lay_on_points.py)
           Where many do not lie on it, both sides of a sheet were seen, and nothing is missing
5. choose  of its parts without points those are taken that are missing surface and no true openings: where the thing
           stood, and holes that the surface around goes on over. A sleeve's end or the mouth of a cup is neither
                                                                                              (loose_parts.py)
6. join    the chosen parts grow over unsure points beside them, and are smoothed; the other points there are drawn onto
           the surface, the nearer the more, so that measured and inferred points meet without a seam
7. sample  the chosen parts become points                                                     (sample_parts.py)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, evenly, no_tick, part_of, pick, smoothstep
from capture2vr.edge.closing.carving import Carving
from capture2vr.edge.closing.lay_on_points import lay_on_points, smooth_parts
from capture2vr.edge.closing.loose_parts import LooseParts, is_loose
from capture2vr.edge.closing.oriented_points import orient_points, ramp
from capture2vr.edge.closing.sample_parts import grown, sample_parts, spread_colours
from capture2vr.edge.closing.solid import fit_solid
from capture2vr.edge.mesh.distance import distance_to_mesh
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.order.option_table import Fill

_ROUGH, _CELLS = (16, 32), (16, 32, 64)
"""Cells along the longest side: of the surface that outlines are started from, and of the final one."""
_MOST_PICTURES = 20
"""Photos that are asked, evenly chosen: each takes a fifth of a second."""
_MOST_BESIDE = 0.2
"""Share of the points beside the outlines from which on these are those of something else, and are not used."""
_UNSURE, _CERTAIN = 0.7, 0.9
"""Certainty up to which a point does not count for the final surface, and from which on it counts fully."""
_SURE = 0.96
"""Certainty from which on a point surely lies on a surface: of a rendered apple all do but at the border of what photos
see, of real fruit two thirds near it."""
_PROBES, _LIES_ON, _NEARLY_ALL = 5_000, 2.0, 0.8
"""Points that are asked whether they lie on the closed surface, the spacings within which they do, and the share of
them that must: of fruit, statue, plush toy and dress 99 % do, of a cup with a thin wall 88, of a broken shell that was
seen from both sides 66. To such a sheet no surface belongs that would close it."""
_MOST_INSIDE = 0.04
"""Share of the points below the closed surface from which on this is a lid over an inside that photos saw. Of fruit 1 %
are, of statue, bananas, shoe and heads less, of a cape whose neck was closed 8."""
_BESIDE, _FRINGE_OFF = 12.0, 0.5
"""Spacings: points so near to inferred ones and so far off the closed surface are a fringe, depth that was matched
across an outline."""
_RINGS = 3
"""Rings of triangles around what is inferred that are smoothed with it."""
_AROUND = 6
"""Vertices whose tangent planes tell where a closed mesh is."""


@dataclass(frozen=True, slots=True)
class MissingPoints:
    """Inferred points: xyz (M,3), rgb (M,3) or None; fringe (N,): mask of the measured points that they replace;
    measured (N,3): places of the others, which meet the inferred ones smoothly; closed: whether no opening is left that
    could be a true one."""

    xyz: Floats
    rgb: Bytes | None
    fringe: Bools
    measured: Floats
    closed: bool


def infer_missing(
    xyz: Floats,
    rgb: Bytes | None,
    pictures: Sequence[PosedPicture],
    support: Plane | None,
    fill: Fill,
    tick: Tick = no_tick,
) -> MissingPoints:
    """Infer the points that a thing lacks; fill: "all" also closes true openings and sides that nobody saw.

    xyz (N,3), N ≥ 13, of the thing alone, in a frame in which its longest side is about 1; pictures with depth, and
    the plane that it stands on, with its normal to the thing, in the same frame
    """
    none = np.zeros(len(xyz), bool)
    nothing = MissingPoints(xyz[none], pick(rgb, none), none, xyz, closed=False)
    pictures = tuple(each.loaded() for each in evenly(pictures, _MOST_PICTURES))
    tree = cKDTree(xyz)
    points, certain = orient_points(xyz, tree, pictures)
    tick(0.1)
    carving = Carving(pictures)
    rough = fit_solid(points, carving.is_free, support, _ROUGH, part_of(tick, 0.1, 0.2))
    if not len(rough.faces):
        return nothing
    outlined = carving.with_outlines(rough)
    tick(0.5)
    beside = outlined.is_beside(xyz)
    if beside.mean() < _MOST_BESIDE:
        carving = outlined
    else:
        beside = none
    kept = replace(points, weight=points.weight * ramp(certain, _UNSURE, _CERTAIN)).subset(~beside)
    solid = fit_solid(kept, carving.is_free, support, _CELLS, part_of(tick, 0.5, 0.9))
    if not len(solid.faces):
        return nothing
    cell = 1 / _CELLS[-1]
    local = point_spacing(xyz, tree)
    spacing = float(np.median(local))
    solid, laid = lay_on_points(solid, kept, spacing, cell)
    if not _lie_on(xyz, solid, spacing):
        return nothing
    parts = LooseParts.without_points(solid, tree, local)
    inside = _above(solid, xyz, cell)[0] < -_LIES_ON * spacing  # where nobody can have seen any
    hollow = bool(inside.mean() > _MOST_INSIDE)
    eyes = np.array([each.eye for each in pictures])
    chosen, closed = parts.missing(support, eyes, cell, spacing, fill, hollow=hollow)
    if not chosen.any():
        return replace(nothing, closed=closed)
    sure = certain >= min(_SURE, float(np.median(certain)))
    near = _near(solid, chosen, solid.vertices[solid.faces].mean(axis=1), _BESIDE * spacing) < 1
    chosen |= near & (parts.number < 0) & is_loose(solid, cKDTree(xyz[sure]), local[sure])
    solid = smooth_parts(solid, grown(solid, chosen, _RINGS), laid)
    away = _near(solid, chosen, xyz, _BESIDE * spacing)
    above, up = _above(solid, xyz, cell)
    fringe = beside | ((away < 1) & (np.abs(above) > _FRINGE_OFF * spacing))
    if closed:
        fringe |= inside
    joined = xyz - (smoothstep(1 - away, (0, 1)) * above)[:, None] * up
    tinted = sure & ~fringe if (sure & ~fringe).any() else sure
    light = None if rgb is None else spread_colours(solid, chosen, joined[tinted], rgb[tinted])
    places, colours = sample_parts(solid, chosen, cKDTree(joined[~fringe]), spacing, light)
    tick(1.0)
    return MissingPoints(places, colours, fringe, joined, closed)


def _lie_on(xyz: Floats, mesh: Mesh, spacing: float) -> bool:
    """Return whether nearly all points (N,3) lie on a closed mesh: a sheet, both sides of which were seen, does not."""
    some = xyz[:: max(1, len(xyz) // _PROBES)]
    return bool((distance_to_mesh(some, mesh) < _LIES_ON * spacing).mean() > _NEARLY_ALL)


def _near(mesh: Mesh, chosen: Bools, xyz: Floats, reach: float) -> Floats:
    """(N,) in [0,1]: distances of places (N,3) to the middles of chosen faces (F,), over a reach; 1 beyond it."""
    middles = cKDTree(mesh.vertices[mesh.faces[chosen]].mean(axis=1))
    away: Floats = np.minimum(middles.query(xyz, distance_upper_bound=reach, workers=-1)[0] / reach, 1)
    return away


def _above(mesh: Mesh, xyz: Floats, cell: float) -> tuple[Floats, Floats]:
    """Heights (N,) of points (N,3) above a closed mesh of triangles of about a cell, and its normals (N,3) there: the
    mean of the nearest vertices' tangent planes."""
    away, near = cKDTree(mesh.vertices).query(xyz, k=range(1, 1 + min(_AROUND, len(mesh.vertices))), workers=-1)
    normals = vertex_normals(mesh)[near]
    weight = np.exp((np.square(away[:, :1]) - np.square(away)) / cell**2)
    weight *= np.maximum(np.einsum("nkx,nx->nk", normals, normals[:, 0]), 0)  # not those of a thin wall's other side
    height = np.einsum("nkx,nkx->nk", xyz[:, None] - mesh.vertices[near], normals)
    up = np.einsum("nk,nkx->nx", weight, normals)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    return (weight * height).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9), up
