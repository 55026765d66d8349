"""Ray casting against a mesh with Embree, for rendered images, texture baking and simulated captures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh

LIFT = 1e-3  # of the longest side: offset of a ray's origin from its surface, so that it does not hit that again
_SKY_REACH = 0.35  # of the longest side: surface farther off does not darken


@dataclass(frozen=True, slots=True)
class Hits:
    """First hits of N rays.

    face (N,) int64, −1 where nothing was hit; along (N,) float32 distance in lengths of the ray's direction, infinite
    where nothing was hit; bary (N,3) float32 barycentric weights of the face's corners.
    """

    face: Ints
    along: Floats
    bary: Floats

    @classmethod
    def missed(cls, count: int) -> Hits:
        """Make the hits of rays that meet nothing, to be overwritten."""
        return cls(np.full(count, -1, np.int64), np.full(count, np.inf, np.float32), np.zeros((count, 3), np.float32))


class RaycastingScene:
    """A mesh with Embree's acceleration structure. Rays are in the mesh's frame; inside, everything is centred and
    scaled, because Embree computes in float32.

    Threads may share it, and should: Embree releases the interpreter lock (7 M rays/s on one thread, 13 M/s on two).
    """

    def __init__(self, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        self._centre, self._low, self._high = (low + high) / 2, low, high
        self.longest = float((high - low).max())
        self._scale = 1.0 / max(self.longest, 1e-30)
        self._scene = EmbreeScene()
        vertices = ((mesh.vertices - self._centre) * self._scale).astype(np.float32)
        self._geometry = TriangleMesh(self._scene, vertices, mesh.faces.astype(np.int32))
        self._run(np.zeros((1, 3)), np.ones((1, 3)))  # builds the tree now, before threads share it

    def corners(self) -> Floats:
        """Corners (8,3) of the mesh's bounding box."""
        low_or_high = np.stack(np.meshgrid(*[[0, 1]] * 3), axis=-1).reshape(-1, 3)
        corners: Floats = np.where(low_or_high, self._high, self._low)
        return corners

    def cast(self, origins: Floats, directions: Floats) -> Hits:
        """Find the first face along each ray; origins (N,3) or (1,3), directions (N,3) of any length but 0."""
        found = self._run(origins, directions, output=True)
        face, along, u, v = (found[key] for key in ("primID", "tfar", "u", "v"))
        along[face < 0] = np.inf
        return Hits(face.astype(np.int64), along, np.stack([1 - u - v, u, v], axis=1))

    def blocked(self, origins: Floats, directions: Floats, reach: float) -> Bools:
        """Test each ray for occlusion: (N,) True where a face lies within `reach` lengths of the ray's direction."""
        limit = np.full(len(directions), reach, dtype=np.float32)
        hit: Bools = self._run(origins, directions, dists=limit, query="OCCLUDED") >= 0
        return hit

    def _run(self, origins: Floats, directions: Floats, **options: object) -> Any:
        centre = self._centre.astype(origins.dtype)
        starts = ((np.broadcast_to(origins, directions.shape) - centre) * self._scale).astype(np.float32, copy=False)
        return self._scene.run(starts, (directions * self._scale).astype(np.float32, copy=False), **options)


def nearest_along(scene: RaycastingScene, places: Floats, normals: Floats, reach: float) -> Hits:
    """Find where the line through each place (N,3) along its unit normal (N,3) meets the mesh, on the side where that
    is nearer; nothing where it is farther off than `reach`."""
    above, below = scene.cast(places, normals), scene.cast(places, -normals)
    over = above.along <= below.along
    along = np.where(over, above.along, below.along)
    face = np.where(along <= reach, np.where(over, above.face, below.face), -1)
    return Hits(face, along, np.where(over[:, None], above.bary, below.bary))


def pinhole(x: Floats, y: Floats, right: Floats, down: Floats, ahead: Floats) -> Floats:
    """Ray directions of a pinhole camera: (len(y)·len(x),3) float32, row by row: ahead + x·right + y·down."""
    grid = np.empty((len(y), len(x), 3), dtype=np.float32)
    grid[:] = (ahead + x[:, None] * right)[None]
    grid += (y[:, None] * down).astype(np.float32)[:, None]
    return grid.reshape(-1, 3)


def open_sky(scene: RaycastingScene, vertices: Floats, normals: Floats, *, rays: int) -> Floats:
    """Ambient occlusion: (V,) share of `rays` rays over each vertex that hit nothing, with a cosine distribution.

    vertices (V,3), normals (V,3) of unit length, float32. Surface farther off than `_SKY_REACH` does not count.
    """
    tangent = np.cross(normals, np.eye(3, dtype=np.float32)[np.abs(normals).argmin(axis=1)])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(normals, tangent)
    start = vertices + np.float32(LIFT * scene.longest) * normals
    turn = np.random.default_rng(0).random(len(normals), dtype=np.float32) * np.float32(2 * np.pi)
    closed = np.zeros(len(normals), dtype=np.float32)
    for number in range(rays):
        # Malley's method: points spread evenly on the disk (a Fibonacci spiral), projected up to the hemisphere.
        radius = np.float32(np.sqrt((number + 0.5) / rays))
        angle = turn + np.float32(number * np.pi * (3 - np.sqrt(5)))
        ray = (radius * np.cos(angle))[:, None] * tangent + (radius * np.sin(angle))[:, None] * bitangent
        ray += np.sqrt(1 - radius**2) * normals
        closed += scene.blocked(start, ray, _SKY_REACH * scene.longest)
    share: Floats = 1 - closed / rays
    return share
