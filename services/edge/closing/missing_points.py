"""Infer points where a thing has surface that no photo gave depth of: dark sides, undersides, holes.

1. orient  points get normals that point to the cameras which see them                        (oriented_points.py)
2. carve   photos tell what around the thing is free space, once more by its outlines when it is roughly known
                                                                                              (carving.py)
3. close   a closed surface is fitted to the points, out of free space and over the plane that the thing stands on
                                                                                              (solid.py)
4. lay     it is laid on the points                                                           (lay_on_points.py)
           Where many do not lie on it, both sides of a sheet were seen, and nothing is missing
5. choose  of its parts without points those are taken that are missing surface and no true openings: where the thing
           stood, and holes that the surface around goes on over. A sleeve's end or the mouth of a cup is neither
                                                                                              (loose_parts.py)
6. sample  the chosen parts become points                                                     (sample_parts.py)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, evenly, no_tick, part_of, pick
from capture2vr.edge.closing.carving import Carving
from capture2vr.edge.closing.lay_on_points import lay_on_points
from capture2vr.edge.closing.loose_parts import LooseParts
from capture2vr.edge.closing.oriented_points import orient_points
from capture2vr.edge.closing.sample_parts import sample_parts
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
_PROBES, _LIES_ON, _NEARLY_ALL = 5_000, 2.0, 0.8
"""Points that are asked whether they lie on the closed surface, the spacings within which they do, and the share of
them that must: of fruit, statue, plush toy and dress 99 % do, of a cup with a thin wall 88, of a broken shell that was
seen from both sides 66. To such a sheet no surface belongs that would close it."""
_MOST_INSIDE = 0.04
"""Share of the points below the closed surface from which on this is a lid over an inside that photos saw. Of fruit 1 %
are, of statue, bananas, shoe and heads less, of a cape whose neck was closed 8."""
_FRINGE_NEAR, _FRINGE_OFF = 12.0, 0.5
"""Spacings: points so near to inferred ones and so far off the closed surface are a fringe, depth that was matched
across an outline."""


@dataclass(frozen=True, slots=True)
class MissingPoints:
    """Inferred points: xyz (M,3), rgb (M,3) or None; fringe (N,): mask of the measured points that they replace;
    closed: whether no opening is left that could be a true one."""

    xyz: Floats
    rgb: Bytes | None
    fringe: Bools
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
    nothing = MissingPoints(xyz[none], pick(rgb, none), none, closed=False)
    pictures = tuple(each.loaded() for each in evenly(pictures, _MOST_PICTURES))
    tree = cKDTree(xyz)
    points = orient_points(xyz, tree, pictures)
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
    kept = points.subset(~beside)
    solid = fit_solid(kept, carving.is_free, support, _CELLS, part_of(tick, 0.5, 0.9))
    if not len(solid.faces):
        return nothing
    cell = 1 / _CELLS[-1]
    local = point_spacing(xyz, tree)
    spacing = float(np.median(local))
    solid = lay_on_points(solid, kept, spacing, cell)
    if not _lie_on(xyz, solid, spacing):
        return nothing
    parts = LooseParts.without_points(solid, tree, local)
    inside = _inside(solid, xyz, spacing)
    hollow = bool(inside.mean() > _MOST_INSIDE)
    eyes = np.array([each.eye for each in pictures])
    chosen, closed = parts.missing(support, eyes, cell, spacing, fill, hollow=hollow)
    if not chosen.any():
        return replace(nothing, closed=closed)
    fringe = beside | _fringe(solid, chosen, xyz, spacing)
    if closed:
        fringe |= inside
    tree = cKDTree(xyz[~fringe])
    places, light = sample_parts(solid, chosen, tree, spacing, pick(rgb, ~fringe))
    tick(1.0)
    return MissingPoints(places, light, fringe, closed)


def _lie_on(xyz: Floats, mesh: Mesh, spacing: float) -> bool:
    """Return whether nearly all points (N,3) lie on a closed mesh: a sheet, both sides of which were seen, does not."""
    some = xyz[:: max(1, len(xyz) // _PROBES)]
    return bool((distance_to_mesh(some, mesh) < _LIES_ON * spacing).mean() > _NEARLY_ALL)


def _fringe(mesh: Mesh, chosen: Bools, xyz: Floats, spacing: float) -> Bools:
    """Find the points (N,) near the chosen faces (F,) of a closed mesh that lie off it."""
    centres = cKDTree(mesh.vertices[mesh.faces[chosen]].mean(axis=1))
    fringe: Bools = np.isfinite(centres.query(xyz, distance_upper_bound=_FRINGE_NEAR * spacing, workers=-1)[0])
    fringe[fringe] = distance_to_mesh(xyz[fringe], mesh) > _FRINGE_OFF * spacing
    return fringe


def _inside(mesh: Mesh, xyz: Floats, spacing: float) -> Bools:
    """Find the points (N,) that lie below a closed mesh, where nobody can have seen any if it is that."""
    near = cKDTree(mesh.vertices).query(xyz, workers=-1)[1]
    inside: Bools = np.einsum("nx,nx->n", xyz - mesh.vertices[near], vertex_normals(mesh)[near]) < -_LIES_ON * spacing
    return inside
