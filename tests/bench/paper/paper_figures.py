"""The paper's Figures 5 to 7 and 9: every method's mesh in the colours of its error: `python -m tests.bench figure5`.

Nothing is trained here but the product's own fit: the meshes of the literature are those that `published` left in its
folder of --state, each as far as it came. The picture lies beside the tables; --glb FILE writes the same meshes side by
side, with a bar that tells the scale.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from capture2vr.edge.mesh.nouns import Mesh
from tests.bench.data_files import PICTURES
from tests.bench.methods import Settings, make
from tests.bench.paper import heat_maps
from tests.bench.paper.heat_maps import Column, View
from tests.bench.published import NO_MESH, OBJECTS, SCENE, Cell, add_state, cells, keep_mesh, kept_mesh, mesh_reached
from tests.bench.shapes import DEFORMED, Row
from tests.support.mesh_metrics import compare, welded

NAMES = {"cap-udf": "CAP-UDF", "levelset-udf": "LevelSetUDF", "paper": "the paper"}
_FROM_THE_RIGHT = View()
_EDGE = 0.04  # of a room's sides: walls and ceiling that would hide what is in it


def opened(mesh: Mesh) -> Mesh:
    """A room without its ceiling and the two walls before the camera."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = (mesh.vertices[mesh.faces].mean(axis=1) - low) / (high - low)
    return replace(mesh, faces=mesh.faces[(middle < 1 - _EDGE).all(axis=1)])


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the paper: a line of meshes for each row, from where they are seen, and what of them is shown."""

    rows: tuple[Row, ...]
    methods: tuple[str, ...] = ("cap-udf", "levelset-udf", "paper")
    view: View = _FROM_THE_RIGHT
    points: bool = False
    shown: Callable[[Mesh], Mesh] = lambda mesh: mesh


FIGURES = {
    "figure5": Figure(tuple(row for row in OBJECTS if row.label == "dress, 10,000")),
    "figure6": Figure(tuple(row for row in OBJECTS if row.name == "truck"), view=View(45, 20)),
    "figure7": Figure((SCENE,), view=View(35, 35), shown=opened),
    "figure9": Figure(DEFORMED, ("levelset-udf", "paper"), points=True),
}


def main(arguments: list[str], name: str) -> None:
    """Draw a figure and print its table."""
    options = _parser(name).parse_args(arguments)
    figure = FIGURES[name]
    print("| row | method | steps | Chamfer-L1 | F@.005 | pieces |\n|---|---|---|---|---|---|")
    rows = [columns(row, figure, options.state) for row in figure.rows]
    picture = options.picture or PICTURES / f"{name}.png"
    heat_maps.draw(rows, figure.view, picture)
    print(f"\ndrawn: {picture.name}")
    if options.glb:
        heat_maps.write_glb([column for row in rows for column in row], options.glb)
        print(f"written: {options.glb}")


def columns(row: Row, figure: Figure, state: Path) -> list[Column]:
    """The columns of a row: the points where they are shown, each method, the product, the truth."""
    known = row.truth()
    truth = welded(known)
    seen = [Column(f"the {row.name}'s points", "", heat_maps.dots(row.sampled(known, 0)))] if figure.points else []
    for method in figure.methods:
        cell, reached = _farthest(row, method, state)
        seen.append(_of_literature(cell, reached, truth, figure))
    product = product_mesh(row, state)
    seen.append(_measured(row, "the product, standard", "", product, truth, figure))
    return [*seen, Column("the truth", "", heat_maps.plain(figure.shown(truth)))]


def _farthest(row: Row, method: str, state: Path) -> tuple[Cell, tuple[int, Mesh] | None]:
    """The cell of a method whose kept mesh came farthest, and that mesh with its step: the paper's was trained with two
    numbers of queries."""
    found = [(cell, mesh_reached(cell, state)) for cell in cells() if (cell.row, cell.method) == (row, method)]
    return max(found, key=lambda each: each[1][0] if each[1] else 0)


def _of_literature(cell: Cell, reached: tuple[int, Mesh] | None, truth: Mesh, figure: Figure) -> Column:
    name, of = cell.label.replace(cell.method, NAMES[cell.method]), cell.config.loss_steps
    if reached is None or not len(reached[1].faces):
        why = NO_MESH if reached is None else f"no surface after {reached[0]:,} of {of:,} steps"
        print(f"| {cell.row.label} | {name} | {why} | | | |", flush=True)
        return Column(name, why, None)
    step, mesh = reached
    steps = f"{step:,} steps" if step >= of else f"{step:,} of {of:,} steps"
    return _measured(cell.row, name, steps, mesh, truth, figure)


def _measured(row: Row, name: str, steps: str, mesh: Mesh, truth: Mesh, figure: Figure) -> Column:
    quality = compare(mesh, truth)
    figures = f"{quality.chamfer_l1:.5f} | {quality.f_005:.3f} | {quality.components}"
    print(f"| {row.label} | {name} | {steps or '–'} | {figures} |", flush=True)
    caption = f"{steps}{', ' if steps else ''}CD {quality.chamfer_l1:.4f}, F {quality.f_005:.2f}"
    return Column(name, caption, heat_maps.coloured(figure.shown(mesh), truth))


def product_mesh(row: Row, state: Path) -> Mesh:
    """The product's mesh of a row, which the folder of --state keeps as it keeps the others."""
    kept = state / f"{row.label} standard.npz".replace(" ", "-").replace(",", "")
    if not kept.exists():
        made = make(row.sampled(row.truth(), 0), Settings("standard", resolution=row.resolution)).mesh
        kept.parent.mkdir(parents=True, exist_ok=True)
        keep_mesh(kept, made)
    return kept_mesh(kept)


def _parser(name: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"python -m tests.bench {name}", description=__doc__)
    add_state(parser)
    parser.add_argument("--picture", type=Path, help="where the picture goes instead of beside the tables")
    parser.add_argument("--glb", type=Path, help="also write the meshes, with a bar that tells the scale")
    return parser
