"""A closed surface lies where its points are, though some of their normals are turned the wrong way."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.closing.oriented_points import OrientedPoints
from capture2vr.edge.closing.solid import fit_solid

RADIUS = 0.4


def directions(count: int) -> Floats:
    found = np.random.default_rng(0).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def nowhere(places: Floats) -> Bools:
    return np.zeros(len(places), bool)


def distances_from_middle(xyz: Floats, normal: Floats) -> Floats:
    """Distances (V,) of the vertices of the surface that is fitted to points."""
    solid = fit_solid(OrientedPoints(xyz, normal, np.ones(len(xyz))), nowhere, None, (16, 32))
    return np.asarray(np.linalg.norm(solid.vertices, axis=1))


def test_patches_of_normals_that_point_inwards_make_no_pits() -> None:
    outwards = directions(8_000)
    patches = np.linalg.norm(RADIUS * (outwards[:, None] - outwards[:20]), axis=2).min(axis=1) < 0.025
    normal = np.where(patches[:, None], -outwards, outwards)
    assert np.abs(distances_from_middle(RADIUS * outwards, normal) - RADIUS).max() < 0.001  # 0.0046 with them


def test_both_sides_of_a_thin_wall_count() -> None:
    outwards = directions(16_000)
    inner = 0.95 * RADIUS
    xyz, normal = np.concatenate([RADIUS * outwards, inner * outwards]), np.concatenate([outwards, -outwards])
    seam = np.abs(xyz[:, 2]) < 0.05  # a slit, so that the inside is no cavity
    found = distances_from_middle(xyz[~seam], normal[~seam])
    assert np.mean(np.abs(found - inner) < 0.005) > 0.1  # none at all where the rule asks every normal
