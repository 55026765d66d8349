"""How far a mesh lies from the truth, and how whole it is.

Distances are in the frame of the two meshes, which is the unit frame for every figure that this project prints.
All of them rest on area-weighted random samples, so even the truth against itself is not 0: `floor` is that residue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import SurfaceSamples, area, sample
from capture2vr.edge.mesh.topology import component_count

SAMPLES = 100_000  # per mesh: the floor of a unit sphere is then .0028, well under what methods differ by
BORDER_SAMPLES = 20_000  # per mesh: borders of length 5 are then sampled every .00025, a tenth of the usual floor
SAME_PLACE = 9  # decimals of the unit frame to which vertices at one place agree


@dataclass(frozen=True, slots=True)
class Quality:
    """A mesh against the truth.

    chamfer_l1           ½(mean distance mesh→truth + mean distance truth→mesh)
    chamfer_l2           the two mean squared distances, added
    f_005, f_010         F-score: harmonic mean of the shares of samples within 0.005 and 0.01
    normal_consistency   mean |cos| between a sample's normal and that of the nearest sample, both directions
    boundary_edges       edges of one face; boundary_loops: their connected chains
    boundary_error       `boundary_error` of the two meshes: how far their borders lie from each other
    non_manifold_edges   edges of three or more faces; edges: all of them
    components           connected pieces of faces
    area_ratio           area of the mesh / area of the truth
    floor                chamfer_l1 of two samplings of the truth: no mesh can be told from the truth below it
    floor_f_005          their F-score at 0.005: no mesh comes above it
    """

    chamfer_l1: float
    chamfer_l2: float
    f_005: float
    f_010: float
    normal_consistency: float
    edges: int
    boundary_edges: int
    boundary_loops: int
    boundary_error: float
    non_manifold_edges: int
    components: int
    area_ratio: float
    floor: float
    floor_f_005: float


@dataclass(frozen=True, slots=True)
class Gaps:
    """Nearest-sample distances between surfaces a and b, both ways, and |cos| of the normals that meet."""

    a_to_b: Floats
    b_to_a: Floats
    cos: Floats

    @property
    def chamfer_l1(self) -> float:
        return float(self.a_to_b.mean() + self.b_to_a.mean()) / 2

    @property
    def chamfer_l2(self) -> float:
        return float(np.square(self.a_to_b).mean() + np.square(self.b_to_a).mean())

    def f_score(self, within: float) -> float:
        """Harmonic mean of precision and recall at the distance `within`."""
        precision, recall = float((self.a_to_b < within).mean()), float((self.b_to_a < within).mean())
        return 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0


def compare(mesh: Mesh, truth: Mesh, samples: int = SAMPLES, seed: int = 0) -> Quality:
    """All figures of a mesh against the truth. Raises ValueError where either has no area."""
    rng = np.random.default_rng(seed)
    made, true, again = (sample(surface, samples, rng) for surface in (mesh, truth, truth))
    gaps, floor = gaps_between(made, true), gaps_between(again, true)
    edges = edges_of(mesh.faces)
    boundary = edges.border_ends
    return Quality(
        chamfer_l1=gaps.chamfer_l1,
        chamfer_l2=gaps.chamfer_l2,
        f_005=gaps.f_score(0.005),
        f_010=gaps.f_score(0.010),
        normal_consistency=float(gaps.cos.mean()),
        edges=len(edges.ends),
        boundary_edges=len(boundary),
        boundary_loops=component_count(boundary),
        boundary_error=boundary_error(mesh, truth, seed=seed),
        non_manifold_edges=edges.crowded_count,
        components=component_count(edges.ends),
        area_ratio=area(mesh) / area(truth),
        floor=floor.chamfer_l1,
        floor_f_005=floor.f_score(0.005),
    )


def gaps_between(a: SurfaceSamples, b: SurfaceSamples) -> Gaps:
    """Distances from every sample to the nearest of the other surface."""
    a_to_b, nearest_b = cKDTree(b.xyz).query(a.xyz, workers=-1)
    b_to_a, nearest_a = cKDTree(a.xyz).query(b.xyz, workers=-1)
    cos = [_abs_cos(a.normals, b.normals[nearest_b]), _abs_cos(b.normals, a.normals[nearest_a])]
    return Gaps(a_to_b, b_to_a, np.concatenate(cos))


def chamfer_l1(mesh: Mesh, truth: Mesh, samples: int = SAMPLES, seed: int = 0) -> float:
    """½(mean accuracy + mean completeness)."""
    rng = np.random.default_rng(seed)
    return gaps_between(sample(mesh, samples, rng), sample(truth, samples, rng)).chamfer_l1


def distances_to(mesh: Mesh, points: Floats, samples: int = 800_000) -> Floats:
    """(n,) of points (n,3) from the surface: from the face that the nearest of many samples lies on, or, beyond a
    border, from that sample."""
    dense = sample(mesh, samples, np.random.default_rng(1))
    gap, nearest = cKDTree(dense.xyz).query(points, workers=-1)
    off = np.abs(np.einsum("ni,ni->n", points - dense.xyz[nearest], dense.normals[nearest]))
    aside = np.sqrt(np.maximum(gap**2 - off**2, 0))
    distances: Floats = np.where(aside < 3 * np.sqrt(area(mesh) / len(dense.xyz)), off, gap)
    return distances


def boundary_error(mesh: Mesh, truth: Mesh, samples: int = BORDER_SAMPLES, seed: int = 0) -> float:
    """Symmetric Chamfer distance of the two borders: ½(mean distance mesh→truth + mean distance truth→mesh).

    A border is all edges of one face, vertices at the same place being one, sampled evenly along its length. An opening
    that was closed and a hole that was torn both count. 0 where neither mesh has a border, inf where only one has.
    """
    rng = np.random.default_rng(seed)
    made, true = (sample_border(surface, samples, rng) for surface in (mesh, truth))
    if len(made) == 0 or len(true) == 0:
        return 0.0 if len(made) == len(true) else np.inf
    there, back = cKDTree(true).query(made, workers=-1)[0], cKDTree(made).query(true, workers=-1)[0]
    return float(there.mean() + back.mean()) / 2


def sample_border(mesh: Mesh, count: int, rng: np.random.Generator) -> Floats:
    """(count,3) uniform random points along the edges of one face; (0,3) where the mesh is closed."""
    whole = welded(mesh)
    ends = whole.vertices[edges_of(whole.faces).border_ends]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if not length.sum() > 0:
        return np.empty((0, 3))
    edge = rng.choice(len(length), count, p=length / length.sum())
    xyz: Floats = ends[edge, 0] + rng.random((count, 1)) * (ends[edge, 1] - ends[edge, 0])
    return xyz


def welded(mesh: Mesh) -> Mesh:
    """The mesh with vertices at the same place made one, and without faces that thereby lost a corner.

    Files repeat a vertex for every normal and texture coordinate; its borders are then no borders of the surface.
    """
    _, first, same = np.unique(np.round(mesh.vertices, SAME_PLACE), axis=0, return_index=True, return_inverse=True)
    faces = same.ravel()[mesh.faces]
    whole = (faces != faces[:, [1, 2, 0]]).all(axis=1)
    return Mesh(mesh.vertices[first], faces[whole])


def _abs_cos(a: Floats, b: Floats) -> Floats:
    cos: Floats = np.abs(np.einsum("nx,nx->n", a, b))
    return cos
