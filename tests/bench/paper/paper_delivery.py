"""The paper's Tables 6 and 7: what a mesh costs from points to headset: `python -m tests.bench table6`.

Table 6 follows the dress from its points to a mesh in memory, three ways: by hand, as the paper's 'traditional' way
goes, with the mesh that is exported as OBJ; the same mesh as GLB; and the product's bundle. What a person does by hand
(export, copy, import into the editor, material, build, install) is not timed here, and the paper does not time it
either. Table 7 counts what each method's mesh of the lounge costs, the meshes being those that `published` keeps.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.simplify import lods
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.storage.bundle import Bundle
from tests.bench.delivery import import_costs, read_mesh, write_obj
from tests.bench.paper.paper_figures import NAMES, product_mesh
from tests.bench.paper.paper_tables import DRESS
from tests.bench.published import NO_MESH, SCENE, add_state, cells, mesh_reached

LINKS = (20, 150, 200, 1000)  # Mbit/s; the paper asks for 150 to 200
PRINTED_7 = {
    "cap-udf": (827.62, 1031.52, 411.80, 57.5),
    "levelset-udf": (837.83, 1044.03, 416.74, 58.0),
    "paper": (822.03, 1024.45, 408.95, 57.3),
}
"""Thousands of vertices, edges and faces, and MB. The paper also has Doungtap et al., whose code is not public."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way from points to headset: seconds to reconstruct, bytes that are sent, seconds to import; by hand or not."""

    name: str
    reconstruct_s: float
    size: int
    import_s: float
    by_hand: bool

    def sending_s(self, link: float) -> float:
        """Seconds on a link of so many Mbit/s."""
        return 8 * self.size / (link * 1e6)


def main(arguments: list[str], table: str) -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(prog=f"python -m tests.bench {table}", description=__doc__)
    add_state(parser)
    options = parser.parse_args(arguments)
    for line in table6(ways()) if table == "table6" else table7(options.state):
        print(line, flush=True)


def ways() -> list[Way]:
    """Reconstruct the dress with the preset `standard`, and measure the files of all ways."""
    points = DRESS.sampled(DRESS.truth(), 0)
    began = time.perf_counter()
    preset = replace(load_preset("standard"), resolution=DRESS.resolution)
    bundles = [
        each for each in reconstruct(Capture("points", "dress", Cloud(points)), preset) if isinstance(each, Bundle)
    ]
    seconds = time.perf_counter() - began
    files = bundles[-1].files
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        mesh = read_ply(files["mesh.ply"], folder)
        obj, raw = folder / "raw.obj", folder / "raw.glb"
        write_obj(obj, mesh)
        raw.write_bytes(to_glb(mesh))
        levels = sorted(name for name in files if name.endswith(".glb"))
        for name in levels:
            (folder / name).write_bytes(files[name])
        paths = [obj, raw, *(folder / name for name in levels)]
        costs = {path.name: each["seconds"] for path, each in zip(paths, import_costs(paths), strict=True)}
        sizes = {path.name: path.stat().st_size for path in paths}
    coarsest, finest = levels[-1], levels[0]
    return [
        Way("a person, raw OBJ", seconds, sizes["raw.obj"], costs["raw.obj"], by_hand=True),
        Way("a person, raw GLB", seconds, sizes["raw.glb"], costs["raw.glb"], by_hand=True),
        Way("the product, first mesh", seconds, sizes[coarsest], costs[coarsest], by_hand=False),
        Way("the product, finest mesh", seconds, sizes[finest], costs[finest], by_hand=False),
        Way(
            "the product, all levels",
            seconds,
            sum(sizes[name] for name in levels),
            sum(costs[name] for name in levels),
            by_hand=False,
        ),
    ]


def read_ply(content: bytes, folder: Path) -> Mesh:
    """The mesh of a bundle's mesh.ply, with its colours."""
    path = folder / "mesh.ply"
    path.write_bytes(content)
    return read_mesh(path)


def table6(known: list[Way]) -> Iterator[str]:
    """Lines of Table 6: seconds of each step and in all, and how many times less the product sends than a raw OBJ."""
    links = " | ".join(f"s at {link} Mbit/s" for link in LINKS)
    yield f"| way | reconstruct s | MB | {links} | times less than OBJ | import s | by hand | s in all at 150 Mbit/s |"
    yield "|" + "---|" * (8 + len(LINKS) - 1)
    raw = known[0].size
    for way in known:
        sent = " | ".join(f"{way.sending_s(link):.3f}" for link in LINKS)
        whole = way.reconstruct_s + way.sending_s(150) + way.import_s
        in_all = f"{whole:.2f}" + (" and the person's" if way.by_hand else "")
        hand = "export, copy, import, material, build" if way.by_hand else "nothing"
        yield (
            f"| {way.name} | {way.reconstruct_s:.1f} | {way.size / 1e6:.2f} | {sent} | {raw / way.size:.1f} "
            f"| {way.import_s:.4f} | {hand} | {in_all} |"
        )


def table7(state: Path) -> Iterator[str]:
    """Lines of Table 7: the printed counts beside those of the lounge here, as raw GLB, and of the product's levels."""
    pairs_of = " | ".join(f"{what}, printed | here" for what in ("vertices × 10³", "edges × 10³", "faces × 10³", "MB"))
    yield f"| mesh | steps | {pairs_of} | import ms |"
    yield "|" + "---|" * 11
    meshes: list[tuple[str, str, tuple[float, ...] | None, Mesh, bool]] = []
    for cell in cells():
        if cell.row != SCENE or cell.method not in PRINTED_7:
            continue
        reached = mesh_reached(cell, state)
        if reached is None or not len(reached[1].faces):
            printed = PRINTED_7[cell.method]
            why = NO_MESH if reached is None else f"no surface after {reached[0]:,}"
            yield f"| {NAMES[cell.method]} | {why} | " + " | ".join(f"{each:.2f} | –" for each in printed) + " | – |"
            continue
        step, mesh = reached
        steps = f"{step:,} of {cell.config.loss_steps:,}"
        meshes.append((NAMES[cell.method], steps, PRINTED_7[cell.method], mesh, False))
    whole = product_mesh(SCENE, state)
    meshes.append(("the product, as extracted", "–", None, whole, False))
    meshes += [(f"the product, LOD {level}", "–", None, mesh, True) for level, mesh in enumerate(lods(whole))]
    with tempfile.TemporaryDirectory() as scratch:
        paths = [Path(scratch) / f"{number}.glb" for number in range(len(meshes))]
        for path, (*_, mesh, packed) in zip(paths, meshes, strict=True):
            path.write_bytes(to_glb(mesh, "meshopt" if packed else "float"))
        for (name, steps, known, mesh, _), path, cost in zip(meshes, paths, import_costs(paths), strict=True):
            size = path.stat().st_size / 1e6
            counts = (len(mesh.vertices) / 1e3, len(edges_of(mesh.faces).ends) / 1e3, len(mesh.faces) / 1e3, size)
            pairs = [
                f"{'–' if known is None else format(known[place], '.2f')} | {value:.2f}"
                for place, value in enumerate(counts)
            ]
            yield f"| {name} | {steps} | {' | '.join(pairs)} | {1000 * cost['seconds']:.1f} |"
