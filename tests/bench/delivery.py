"""What reaches a headset: bytes, seconds on the wire, seconds to import and memory, of raw OBJ, raw GLB and our levels.

After the paper's Tables 6 and 7. Importing is what three.js's loaders take in node, the median of five, in a process of
its own; memory is that of the geometry. Errors of the levels are distances both ways, of a thing scaled to 1 m.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import trimesh

from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.mesh.simplify import lods
from tests.bench.shapes import load
from tests.support.mesh_metrics import distances_to
from tests.support.npm_packages import installed

_LINKS = (20, 100, 1000)  # Mbit/s
_SAMPLES = 50_000  # whose distances are told
LOADERS = Path(__file__).with_name("loaders")


def scan(side: int = 448) -> Mesh:
    """A bumpy, noisy, coloured sheet of some 400,000 triangles in no order, as an extraction gives them; 1 m wide."""
    rng = np.random.default_rng(0)

    def smooth(count: int) -> np.ndarray:
        return np.asarray(cv2.resize(rng.random((count, count)), (side, side), interpolation=cv2.INTER_CUBIC))

    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    height = 0.2 * smooth(5) + 0.05 * smooth(20) + 0.01 * smooth(80) + rng.normal(0, 4e-4, (side, side))
    rgb = np.stack([smooth(12), smooth(15), smooth(40)], axis=-1) * 255 + rng.normal(0, 2, (side, side, 3))
    number = rng.permutation(side * side).reshape(side, side)
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = rng.permutation(np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))
    place = np.argsort(number.ravel())
    xyz, rgb = np.stack([u, height, v], axis=-1).reshape(-1, 3), rgb.clip(0, 255).astype(np.uint8).reshape(-1, 3)
    return Mesh(xyz[place], faces, rgb[place])


MESHES: dict[str, Callable[[], Mesh]] = {
    "scan-like sheet": scan,
    "milk truck": lambda: load("milktruck/CesiumMilkTruck.gltf"),
    "dress": lambda: load("dress/dress-v17k-f34k.obj"),
}


def read_mesh(file: Path) -> Mesh:
    """What `capture2vr run` leaves as `mesh.ply`, with its colours."""
    read = trimesh.load_mesh(file, process=False)
    rgb = read.visual.vertex_colors[:, :3] if read.visual.kind == "vertex" else None
    return Mesh(np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64), rgb)


@dataclass(frozen=True, slots=True)
class _Variant:
    name: str
    file: Path
    mesh: Mesh


def main(arguments: list[str]) -> None:
    """Print one table of what is sent and one of the levels; a file among the arguments is a mesh to be measured alone,
    a word chooses among those that are."""
    files = {Path(each).parent.name: partial(read_mesh, Path(each)) for each in arguments if Path(each).is_file()}
    known = files or MESHES
    chosen = [name for name in known if files or all(word in name for word in arguments)]
    rows, levels = [], []
    for name in chosen:
        mesh = known[name]()
        mesh = replace(mesh, vertices=mesh.vertices / np.ptp(mesh.vertices, axis=0).max())
        began = time.perf_counter()
        made = lods(mesh)
        packed = [to_glb(level, "meshopt") for level in made]
        seconds = time.perf_counter() - began
        with tempfile.TemporaryDirectory() as scratch:
            variants = _written(Path(scratch), mesh, made, packed)
            rows += [f"| {name} {row}" for row in _sent(variants)]
        levels += [f"| {name} | {len(mesh.faces):,} | {seconds:.2f} | {_errors(mesh, made)} |"]
    links = " | ".join(f"s at {link} Mbit/s" for link in _LINKS)
    print(f"| mesh | file | vertices | edges | faces | MB | of raw GLB | {links} | import ms | MB in memory |")
    print(f"|{'---|' * (9 + len(_LINKS))}")
    print("\n".join(rows))
    print("\n| mesh | faces | s for its levels | faces, mean / largest error in mm of each level, of a thing of 1 m |")
    print("|---|---|---|---|")
    print("\n".join(levels))


def _written(folder: Path, mesh: Mesh, levels: tuple[Mesh, ...], packed: list[bytes]) -> list[_Variant]:
    obj = folder / "raw.obj"
    write_obj(obj, mesh)
    raw = folder / "raw.glb"
    raw.write_bytes(to_glb(mesh))
    variants = [_Variant("raw OBJ", obj, mesh), _Variant("raw GLB", raw, mesh)]
    for number, (level, content) in enumerate(zip(levels, packed, strict=True)):
        file = folder / f"lod{number}.glb"
        file.write_bytes(content)
        variants.append(_Variant(f"ours, LOD {number}", file, level))
    return variants


def loaders() -> Path:
    """The folder that three.js lies in, for node and for a page. Skips where it cannot be had."""
    return installed("loaders", LOADERS, what="three.js's loaders")


def import_costs(files: Sequence[Path]) -> list[dict[str, float]]:
    """What three.js's loaders take for each file in node: seconds (the median of five), bytes of the geometry."""
    command = ["node", "--max-old-space-size=8192", str(LOADERS / "import.mjs"), *map(str, files)]
    done = subprocess.run(command, cwd=loaders(), capture_output=True, text=True, check=True)
    costs: list[dict[str, float]] = json.loads(done.stdout)
    return costs


def write_obj(path: Path, mesh: Mesh) -> None:
    """Write a mesh as any program exports it: text, with colours at its vertices where it has them."""
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.rgb, process=False).export(path)


def _sent(variants: list[_Variant]) -> list[str]:
    raw = next(each.file.stat().st_size for each in variants if each.name == "raw GLB")
    rows = []
    for each, cost in zip(variants, import_costs([each.file for each in variants]), strict=True):
        size = each.file.stat().st_size
        wire = " | ".join(f"{8 * size / (link * 1e6):.3f}" for link in _LINKS)
        counts = f"{len(each.mesh.vertices):,} | {len(edges_of(each.mesh.faces).ends):,} | {len(each.mesh.faces):,}"
        figures = f"{size / 1e6:.2f} | {size / raw:.2f} | {wire} | {1000 * cost['seconds']:.1f}"
        rows.append(f"| {each.name} | {counts} | {figures} | {cost['bytes'] / 1e6:.1f} |")
    return rows


def _errors(mesh: Mesh, levels: tuple[Mesh, ...]) -> str:
    rng = np.random.default_rng(0)
    truth = sample(mesh, _SAMPLES, rng).xyz
    told = []
    for level in levels:
        both = 1000 * np.concatenate([distances_to(level, truth), distances_to(mesh, sample(level, _SAMPLES, rng).xyz)])
        told.append(f"{len(level.faces):,}: {both.mean():.2f} / {both.max():.1f}")
    return "; ".join(told)
