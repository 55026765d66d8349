"""The data of the papers as their authors lay it out on disk: a folder in, subjects (points and truth) out.

ShapeNet cars   CAP-UDF's:  input/NAME.ply|.xyz|.npy, ground_truth/NAME.obj (github.com/junshengzhou/CAP-UDF)
                NDF's:      .../ID/NAME_scaled.off beside .../ID/voxelized_point_cloud_*points.npz, whose `point_cloud`
                            are the points (github.com/jchibane/ndf)
3D scenes       CAP-UDF's:  input/lounge_1000.xyz.npy (1,000 points per m²), ground_truth/lounge.ply
                or the scans as Stanford publishes them: lounge.ply beside each other, or NAME/NAME.ply
DeepFashion3D   point_cloud/1/1-2.ply is pose 2 of garment 1, filtered_registered_mesh/1-2/model_cleaned.obj its mesh
                (V2; the first edition has deep_fashion_3d_point_cloud/1/1-2.ply and no meshes)
                (github.com/GAP-LAB-CUHK-SZ/deepFashion3D)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from services.edge.arrays import Floats
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.sampling import area, sample

POINT_FILES = (".ply", ".xyz.npy", ".xyz", ".npy", ".npz")
MESH_FILES = (".obj", ".off", ".ply")
PER_SQUARE_METRE = 1_000  # points of a scene that comes without any: the paper's Table 3


@dataclass(frozen=True, slots=True)
class Subject:
    """points (N,3) to reconstruct and the truth, in one frame; a truth without faces is a dense cloud of vertices."""

    name: str
    points: Floats
    truth: Mesh


class LayoutError(Exception):
    """The folder holds nothing that is laid out as these data are; the message names what was looked for."""


def shapenet_cars(folder: Path, points: int = 10_000) -> Iterator[Subject]:
    """The cars of a folder, as CAP-UDF or as NDF lays them out; without points of their own, `points` are drawn."""
    if (folder / "ground_truth").is_dir():
        yield from _cap_udf(folder)
        return
    scaled = sorted(folder.rglob("*_scaled.off"))
    _require(scaled, folder, "ground_truth/*.obj with input/*, or */*_scaled.off")
    for file in scaled:
        truth = read_mesh(file)
        clouds = sorted(file.parent.glob("voxelized_point_cloud_*points.npz"))
        yield Subject(file.parent.name, read_points(clouds[0]) if clouds else _drawn(truth, points), truth)


def scenes(folder: Path, per_square_metre: int = PER_SQUARE_METRE) -> Iterator[Subject]:
    """The scenes of a folder, in metres; without points of their own, so many per square metre are drawn."""
    if (folder / "ground_truth").is_dir():
        yield from _cap_udf(folder)
        return
    scans = sorted({*folder.glob("*.ply"), *folder.glob("*/*.ply")})
    _require(scans, folder, "ground_truth/*.ply with input/*.xyz.npy, or *.ply")
    for file in scans:
        truth = read_mesh(file)
        yield Subject(file.stem, _drawn(truth, int(per_square_metre * area(truth))), truth)


def deep_fashion(folder: Path, points: int = 10_000) -> Iterator[Subject]:
    """The garments of a folder, `points` drawn from each dense cloud; the cloud is the truth where there is no mesh.

    Both are moved to the unit frame of the truth: the data's own unit is nobody's.
    """
    clouds = sorted(folder.rglob("*point_cloud/*/*-*.ply"), key=lambda file: _garment(file.stem))
    _require(clouds, folder, "point_cloud/GARMENT/GARMENT-POSE.ply")
    for file in clouds:
        dense = read_points(file)
        mesh = folder / "filtered_registered_mesh" / file.stem / "model_cleaned.obj"
        truth = read_mesh(mesh) if mesh.exists() else Mesh(dense, np.empty((0, 3), np.int64))
        chosen = np.random.default_rng(0).permutation(len(dense))[:points]
        low, high = truth.vertices.min(0), truth.vertices.max(0)
        middle, size = (low + high) / 2, float((high - low).max())
        yield Subject(file.stem, (dense[chosen] - middle) / size, Mesh((truth.vertices - middle) / size, truth.faces))


def read_points(file: Path) -> Floats:
    """(N,3) float64 points of a .ply, .xyz, .npy, or NDF's .npz."""
    if file.suffix == ".npz":
        with np.load(file) as stored:
            xyz = stored["point_cloud"]
    elif file.suffix == ".npy":
        xyz = np.load(file)
    elif file.suffix == ".xyz":
        xyz = np.loadtxt(file, ndmin=2)
    else:
        xyz = trimesh.load(file, process=False).vertices
    return np.asarray(xyz, np.float64)[:, :3]


def read_mesh(file: Path) -> Mesh:
    """The triangles of a file, its parts merged, in the frame of the file. Raises LayoutError where it has none."""
    mesh = trimesh.load_scene(file, process=False).to_mesh()
    if len(mesh.faces) == 0:
        raise LayoutError(f"{file} has no faces: it is no truth to measure against")
    return Mesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))


def _cap_udf(folder: Path) -> Iterator[Subject]:
    truths = {file.stem: file for file in sorted((folder / "ground_truth").iterdir()) if file.suffix in MESH_FILES}
    inputs = [file for file in sorted((folder / "input").glob("*")) if file.name.endswith(POINT_FILES)]
    _require(inputs, folder, "input/*" + " or *".join(POINT_FILES))
    for file in inputs:
        name = file.name.split(".")[0]
        # lounge_1000 are points of lounge: what follows the first underscore says how they were drawn.
        truth = truths.get(name) or truths.get(name.split("_", 1)[0])
        if truth is None:
            raise LayoutError(f"{file} has no truth: {folder / 'ground_truth'} holds {', '.join(truths) or 'none'}")
        yield Subject(name, read_points(file), read_mesh(truth))


def _drawn(truth: Mesh, count: int) -> Floats:
    return sample(truth, count, np.random.default_rng(0)).xyz


def _garment(stem: str) -> tuple[int, ...]:
    return tuple(int(part) for part in stem.split("-") if part.isdigit())


def _require(found: list[Path], folder: Path, wanted: str) -> None:
    if not found:
        raise LayoutError(f"{folder} holds no {wanted}")
