"""The area of a mesh, and random points on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Points of a surface: xyz (N,3), normals (N,3) of length 1."""

    xyz: Floats
    normals: Floats


def sample(mesh: Mesh, count: int, rng: np.random.Generator) -> SurfaceSamples:
    """`count` area-weighted uniform random points of a mesh. Raises ValueError where the mesh has no area."""
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    if not doubled.sum() > 0:
        raise ValueError(f"a mesh of {len(mesh.faces)} faces without area cannot be sampled")
    face = rng.choice(len(doubled), count, p=doubled / doubled.sum())
    # √u spreads evenly over the triangle: without it samples crowd at the first corner.
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    bary = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    return SurfaceSamples(np.einsum("nc,ncx->nx", bary, corners[face]), cross[face] / doubled[face, None])


def area(mesh: Mesh) -> float:
    """Sum of the triangles' areas."""
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)
