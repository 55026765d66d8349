"""Open surfaces in closed form, as meshes and as random point samples, in the unit frame.

Every maker returns a `Mesh` whose bounding box is centred at 0 with longest side 1. `sampled` draws what a scanner
would: uniform random points of the surface, so the spacing varies as it does in life.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample


def sampled(
    mesh: Mesh, count: int, *, noise: float = 0.0, outliers: float = 0.0, uneven: float = 1.0, seed: int = 0
) -> Floats:
    """(count,3) points of the surface, plus Gaussian noise (standard deviation per axis) and a share of outliers.

    Outliers are uniform in the bounding box grown by a tenth. `uneven` is how many times denser the points lie at one
    end of the longest side than at the other.
    """
    rng = np.random.default_rng(seed)
    xyz = sample(mesh, count, rng).xyz if uneven == 1 else _unevenly(mesh, count, uneven, rng)
    xyz = xyz + rng.normal(0, 1, xyz.shape) * noise
    stray = rng.random(count) < outliers
    low, high = mesh.vertices.min(0) - 0.05, mesh.vertices.max(0) + 0.05
    xyz[stray] = rng.uniform(low, high, (int(stray.sum()), 3))
    return xyz


def _unevenly(mesh: Mesh, count: int, uneven: float, rng: np.random.Generator) -> Floats:
    """(count,3) points whose density falls exponentially along the longest side, to a share of 1/uneven."""
    axis = int(np.argmax(np.ptp(mesh.vertices, axis=0)))
    low, size = mesh.vertices[:, axis].min(), np.ptp(mesh.vertices[:, axis])
    kept: list[Floats] = []
    while sum(map(len, kept)) < count:
        xyz = sample(mesh, 4 * count, rng).xyz
        kept.append(xyz[rng.random(len(xyz)) < uneven ** -((xyz[:, axis] - low) / size)])
    return np.concatenate(kept)[:count]


def unit(vertices: Floats, faces: np.ndarray) -> Mesh:
    """The mesh in its unit frame."""
    low, high = vertices.min(0), vertices.max(0)
    return Mesh((vertices - (low + high) / 2) / (high - low).max(), np.asarray(faces, np.int64))


def read_unit(path: Path, part: str = "") -> Mesh:
    """A mesh file, its parts merged or only the named one, in its unit frame."""
    scene = trimesh.load_scene(path, process=False)
    mesh = scene.geometry[part] if part else scene.to_mesh()
    return unit(np.asarray(mesh.vertices), mesh.faces)


def half(mesh: Mesh, towards: tuple[float, float, float] = (3.0, 2.0, 1.0)) -> Mesh:
    """The part of the mesh on one side of an oblique plane through its middle, cut clean, in its unit frame."""
    vertices, faces, _ = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.faces, towards, (0.0, 0.0, 0.0))
    return unit(vertices, faces)


def patch(shape: Callable[[Floats, Floats], list[Floats]], u_cells: int, v_cells: int) -> Mesh:
    """The surface (u,v) in [0,1]² -> [x,y,z], on a regular grid of triangles."""
    u, v = np.meshgrid(np.linspace(0, 1, u_cells + 1), np.linspace(0, 1, v_cells + 1), indexing="ij")
    made = grid(np.stack(np.broadcast_arrays(*shape(u, v)), axis=-1).astype(np.float64))
    return unit(made.vertices, made.faces)


def grid(points: Floats) -> Mesh:
    """Two triangles for each cell of a grid of points (R,C,3), where they are."""
    rows, columns = points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return Mesh(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def joined(*meshes: Mesh) -> Mesh:
    """Several surfaces as one, in its unit frame."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    faces = np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)])
    return unit(np.concatenate([m.vertices for m in meshes]), faces)


def moved(mesh: Mesh, by: tuple[float, float, float]) -> Mesh:
    """The mesh, shifted."""
    return Mesh(mesh.vertices + np.array(by), mesh.faces)


def sphere() -> Mesh:
    """Radius ½, closed but for the seam of its own grid."""
    return patch(lambda u, v: _on_sphere(2 * np.pi * u, np.pi * v), 192, 96)


def hemisphere() -> Mesh:
    """The upper half of a sphere, open below: one border."""
    return patch(lambda u, v: _on_sphere(2 * np.pi * u, np.pi / 2 * v), 192, 64)


def disk() -> Mesh:
    """Flat, radius ½: one border."""
    return patch(lambda u, v: [v * np.cos(2 * np.pi * u), v * np.sin(2 * np.pi * u), 0 * u], 192, 64)


def cylinder() -> Mesh:
    """An open tube of radius ¼ and height 1: two borders."""
    return patch(lambda u, v: [np.cos(2 * np.pi * u) / 4, np.sin(2 * np.pi * u) / 4, v], 192, 4)


def mobius() -> Mesh:
    """One border, one side: no winding is consistent all round."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        turn, across = 2 * np.pi * u, (v - 0.5) * 0.8
        radius = 1 + across * np.cos(turn / 2)
        return [radius * np.cos(turn), radius * np.sin(turn), across * np.sin(turn / 2)]

    return patch(shape, 400, 32)


def two_sheets(apart: float = 0.06) -> Mesh:
    """Two parallel wavy sheets, `apart` in the unit frame."""
    sheet = patch(lambda u, v: [u, v, 0.05 * np.sin(4 * u) * np.cos(3 * v)], 100, 100)
    return joined(moved(sheet, (0, 0, -apart / 2)), moved(sheet, (0, 0, apart / 2)))


def nested_bowls(apart: float = 0.06) -> Mesh:
    """Two hemispheres with the same middle, `apart` in the unit frame: layers that bend together."""
    outer = hemisphere()
    rim = np.array([0, 0, outer.vertices[:, 2].min()])  # the middle of both
    return joined(outer, Mesh((outer.vertices - rim) * (1 - 2 * apart) + rim, outer.faces))


def smooth_sheet() -> Mesh:
    """A square of cloth with gentle waves."""
    return patch(lambda u, v: [u, v, 0.08 * np.sin(5 * u + 1) * np.cos(4 * v) + 0.03 * np.sin(9 * v)], 160, 160)


def pleated_sheet() -> Mesh:
    """A square with ten pleats, 0.05 high, crest to crest 0.1."""
    return patch(lambda u, v: [u, v, 0.025 * np.sin(20 * np.pi * u) * (0.6 + 0.4 * v)], 400, 80)


def pleated_skirt() -> Mesh:
    """A flared tube with nine pleats that deepen towards the hem; open at waist and hem."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        turn = 2 * np.pi * u
        radius = 0.18 + 0.2 * v + 0.035 * v * np.sin(9 * turn)
        return [radius * np.cos(turn), radius * np.sin(turn), -0.9 * v]

    return patch(shape, 560, 80)


def bumpy_sheet() -> Mesh:
    """A square covered with bumps of two sizes."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        return [u, v, 0.03 * np.sin(13 * u) * np.sin(11 * v) + 0.01 * np.sin(37 * u + 2) * np.sin(31 * v)]

    return patch(shape, 240, 240)


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0), cells: int = 12) -> Mesh:
    """A closed box with these sides, its middle at `at`, not brought to the unit frame. The faces share no vertices."""
    sheet = patch(lambda u, v: [u, v, 0 * u], cells, cells)
    sides = [sheet.vertices + np.array([0, 0, half]) for half in (-0.5, 0.5)]
    turned = [np.roll(side, turn, axis=1) for side in sides for turn in range(3)]
    faces = np.concatenate([sheet.faces + number * len(sheet.vertices) for number in range(6)])
    return Mesh(np.concatenate(turned) * np.array(size) + np.array(at), faces)


def cube() -> Mesh:
    """Closed, twelve creases."""
    return box((1, 1, 1), cells=20)


def chair() -> Mesh:
    """Six boxes that touch: slabs two spacings thick at 10,000 points, and thin legs."""
    legs = (box((0.07, 0.07, 0.8), (x, y, -0.43)) for x in (-0.45, 0.45) for y in (-0.45, 0.45))
    return joined(box((1, 1, 0.06)), box((1, 0.06, 1), (0, 0.47, 0.53)), *legs)


def leaves(count: int = 40) -> Mesh:
    """A shrub: bent leaves in any pose, alone, touching and piercing each other."""
    rng = np.random.default_rng(5)
    leaf = patch(lambda u, v: [0.7 * (u - 0.5) * np.sin(np.pi * v), v, 0.25 * v * v + 0.3 * (u - 0.5) ** 2], 24, 24)
    poses = Rotation.random(count, random_state=5).as_matrix()
    places = rng.normal(0, 0.7, (count, 3))
    return joined(*(Mesh(leaf.vertices @ pose.T + at, leaf.faces) for pose, at in zip(poses, places, strict=True)))


def scroll() -> Mesh:
    """A sheet rolled up three times, the layers 0.1 apart: one border."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        turns = 3.2 * u
        radius = 0.12 + 0.05 * turns
        return [radius * np.cos(2 * np.pi * turns), radius * np.sin(2 * np.pi * turns), 0.6 * v]

    return patch(shape, 600, 100)


def coil() -> Mesh:
    """A thin tube wound three times round: two borders."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        turn, around = 18 * u, 2 * np.pi * v
        radius = 0.4 + 0.035 * np.cos(around)
        return [radius * np.cos(turn), radius * np.sin(turn), 0.035 * np.sin(around) + 0.04 * turn]

    return patch(shape, 900, 24)


def corner() -> Mesh:
    """Three faces of a cube that meet: three creases and a corner."""
    face = patch(lambda u, v: [u, v, 0 * u], 20, 20).vertices + np.array([0.5, 0.5, 0])
    faces = patch(lambda u, v: [u, v, 0 * u], 20, 20).faces
    return joined(*(Mesh(np.roll(face, turn, axis=1), faces) for turn in range(3)))


def grid_with_holes() -> Mesh:
    """A flat square of 8 × 8 cells with 3 × 3 of them missing: ten borders."""
    mesh = patch(lambda u, v: [u, v, 0 * u], 56, 56)
    cell = np.floor((mesh.vertices[mesh.faces].mean(1)[:, :2] + 0.5) * 7).astype(int)
    hole = (cell % 2 == 1).all(axis=1)
    return Mesh(mesh.vertices, mesh.faces[~hole])


def _on_sphere(turn: Floats, tilt: Floats) -> list[Floats]:
    return [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
