"""The data of the papers as their authors lay it out on disk: a folder in, subjects (points and truth) out, by class.

ShapeNet        CAP-UDF's:  input/NAME.ply|.xyz|.npy, ground_truth/NAME.obj (github.com/junshengzhou/CAP-UDF)
                NDF's:      SYNSET/ID/NAME_scaled.off beside SYNSET/ID/voxelized_point_cloud_*points.npz, whose
                            `point_cloud` are the points (github.com/jchibane/ndf)
                its own:    SYNSET/ID/models/model_normalized.obj (version 2) or SYNSET/ID/model.obj (version 1)
3D scenes       CAP-UDF's:  input/lounge_1000.xyz.npy (1,000 points per m²), ground_truth/lounge.ply
                or the scans as Stanford publishes them: lounge.ply beside each other, or NAME/NAME.ply
DeepFashion3D   point_cloud/1/1-2.ply is pose 2 of garment 1, filtered_registered_mesh/1-2/model_cleaned.obj its mesh
                (V2; the first edition has deep_fashion_3d_point_cloud/1/1-2.ply and no meshes); a line of
                cloth_type_list.txt is a class and the numbers of its garments
                (github.com/GAP-LAB-CUHK-SZ/deepFashion3D)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from tests.bench.data_files import DataMissing

POINT_FILES = (".ply", ".xyz.npy", ".xyz", ".npy", ".npz")
MESH_FILES = (".obj", ".off", ".ply")
# WordNet's numbers of ShapeNet's classes: the thirteen that reconstruction papers use.
SYNSETS = {
    "02691156": "airplane",
    "02828884": "bench",
    "02933112": "cabinet",
    "02958343": "car",
    "03001627": "chair",
    "03211117": "display",
    "03636649": "lamp",
    "03691459": "loudspeaker",
    "04090263": "rifle",
    "04256520": "sofa",
    "04379243": "table",
    "04401088": "telephone",
    "04530566": "watercraft",
}
PER_SQUARE_METRE = 1_000  # points of a scene that comes without any: the paper's Table 3


@dataclass(frozen=True, slots=True)
class Subject:
    """points (N,3) to reconstruct and the truth, in one frame; a truth without faces is a dense cloud of vertices."""

    name: str
    points: Floats
    truth: Mesh


@dataclass(frozen=True, slots=True)
class Entry:
    """A subject of a folder that is not read yet. group: its class, "" where the folder names none"""

    name: str
    group: str
    read: Callable[[], tuple[Floats, Mesh]]

    def load(self) -> Subject:
        """Read points and truth. Raises LayoutError for a file that cannot be read."""
        try:
            return Subject(self.name, *self.read())
        except LayoutError:
            raise
        except Exception as error:  # whatever the readers of five formats raise for a damaged file
            raise LayoutError(f"{self.name} cannot be read: {type(error).__name__}: {error}") from error


class LayoutError(DataMissing):
    """The folder holds nothing that is laid out as these data are; the message names what was looked for."""


def shapenet(folder: Path, points: int = 10_000) -> list[Entry]:
    """The shapes of a folder, in one of three layouts; without points of their own, `points` are drawn."""
    if (folder / "ground_truth").is_dir():
        return _cap_udf(folder)
    for pattern, above in (("*_scaled.off", 0), ("models/model_normalized.obj", 1), ("model.obj", 0)):
        if files := sorted(folder.rglob(pattern)):
            return [_shape(file, file.parents[above], points) for file in files]
    raise LayoutError(f"{folder} holds no ground_truth/*.obj with input/*, */*_scaled.off or */*/models/*.obj")


def scenes(folder: Path, per_square_metre: int = PER_SQUARE_METRE) -> list[Entry]:
    """The scenes of a folder, in metres; without points of their own, so many per square metre are drawn."""
    if (folder / "ground_truth").is_dir():
        return _cap_udf(folder)
    scans = sorted({*folder.glob("*.ply"), *folder.glob("*/*.ply")})
    _require(scans, folder, "ground_truth/*.ply with input/*.xyz.npy, or *.ply")
    return [Entry(file.stem, "", partial(_scan, file, per_square_metre)) for file in scans]


def deep_fashion(folder: Path, points: int = 10_000) -> list[Entry]:
    """The garments of a folder, `points` drawn from each dense cloud; the cloud is the truth where there is no mesh.

    Both are moved to the unit frame of the truth: the data's own unit is nobody's.
    """
    clouds = sorted(folder.rglob("*point_cloud/*/*-*.ply"), key=lambda file: _numbers(file.stem))
    _require(clouds, folder, "point_cloud/GARMENT/GARMENT-POSE.ply")
    classes = garment_classes(folder)
    groups = [classes.get(_numbers(file.stem)[0], "") for file in clouds]
    return [
        Entry(file.stem, group, partial(_garment, folder, file, points))
        for file, group in zip(clouds, groups, strict=True)
    ]


def garment_classes(folder: Path) -> dict[int, str]:
    """The class of each garment by its number, from DeepFashion3D's list; {} where the folder has none.

    Raises LayoutError for a list that cannot be read.
    """
    classes: dict[int, str] = {}
    for file in sorted(folder.rglob("cloth_type_list.txt"))[:1]:
        for number, line in enumerate(file.read_text(errors="replace").splitlines(), 1):
            name, *garments = line.replace(":", " ").replace(",", " ").split() or [""]
            if not all(each.isdigit() for each in garments):
                raise LayoutError(f"{file}, line {number}: a class and numbers of garments were expected, not {line!r}")
            classes.update({int(each): name for each in garments})
    return classes


def _shape(file: Path, folder: Path, points: int) -> Entry:
    """A shape of ShapeNet: its folder is named by its id, the one above by the synset of its class."""
    clouds = sorted(folder.glob("voxelized_point_cloud_*points.npz"))
    synset = folder.parent.name
    return Entry(folder.name, SYNSETS.get(synset, synset), partial(_shape_data, file, clouds[:1], points))


def _shape_data(file: Path, clouds: list[Path], points: int) -> tuple[Floats, Mesh]:
    truth = read_mesh(file)
    return read_points(clouds[0]) if clouds else _drawn(truth, points), truth


def _scan(file: Path, per_square_metre: int) -> tuple[Floats, Mesh]:
    truth = read_mesh(file)
    return _drawn(truth, int(per_square_metre * area(truth))), truth


def _garment(folder: Path, file: Path, points: int) -> tuple[Floats, Mesh]:
    dense = read_points(file)
    mesh = folder / "filtered_registered_mesh" / file.stem / "model_cleaned.obj"
    truth = read_mesh(mesh) if mesh.exists() else Mesh(dense, np.empty((0, 3), np.int64))
    chosen = np.random.default_rng(0).permutation(len(dense))[:points]
    low, high = truth.vertices.min(0), truth.vertices.max(0)
    middle, size = (low + high) / 2, float((high - low).max())
    return (dense[chosen] - middle) / size, Mesh((truth.vertices - middle) / size, truth.faces)


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


def _cap_udf(folder: Path) -> list[Entry]:
    truths = {file.stem: file for file in sorted((folder / "ground_truth").iterdir()) if file.suffix in MESH_FILES}
    inputs = [file for file in sorted((folder / "input").glob("*")) if file.name.endswith(POINT_FILES)]
    _require(inputs, folder, "input/*" + " or *".join(POINT_FILES))
    entries = []
    for file in inputs:
        name = file.name.split(".")[0]
        # lounge_1000 are points of lounge: what follows the first underscore says how they were drawn.
        truth = truths.get(name) or truths.get(name.split("_", 1)[0])
        if truth is None:
            raise LayoutError(f"{file} has no truth: {folder / 'ground_truth'} holds {', '.join(truths) or 'none'}")
        entries.append(Entry(name, "", partial(_read_both, file, truth)))
    return entries


def _read_both(points: Path, truth: Path) -> tuple[Floats, Mesh]:
    return read_points(points), read_mesh(truth)


def _drawn(truth: Mesh, count: int) -> Floats:
    return sample(truth, count, np.random.default_rng(0)).xyz


def _numbers(stem: str) -> tuple[int, ...]:
    """The numbers of a garment and its pose: (1, 2) of "1-2"."""
    return tuple(int(part) for part in stem.split("-") if part.isdigit()) or (0,)


def _require(found: list[Path], folder: Path, wanted: str) -> None:
    if not found:
        raise LayoutError(f"{folder} holds no {wanted}")
