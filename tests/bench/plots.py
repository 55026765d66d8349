"""The yardstick as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats
from tests.bench.report import Grid

WORST = 4.0  # times the floor, where the colours end: beyond it a mesh is of no use
DARK = 0.42  # from the middle of the colours: the ends are too dark for black figures


def heat(grid: Grid, path: Path) -> None:
    """Chamfer-L1 over the floor and F@.005 over its floor's, a line a row, a column a method; the best is framed."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    near = _ratios(grid, "chamfer_l1", "floor")
    found = _ratios(grid, "f_005", "floor_f_005")
    width, height = 4.8 + 2 * 0.75 * len(grid.heads), 2.4 + 0.27 * len(grid.rows)
    figure, (left, right) = plt.subplots(1, 2, figsize=(width, height), sharey=True, layout="constrained")
    for axes, values, title, high, best in (
        (left, near, "Chamfer-L1 ÷ floor (1 is the best there can be)", WORST, np.nanargmin),
        (right, found, "F@.005 ÷ floor's (1 is the best there can be)", 1.0, np.nanargmax),
    ):
        low = 1.0 if best is np.nanargmin else 0.3
        colours = "RdYlGn_r" if best is np.nanargmin else "RdYlGn"
        shade = axes.imshow(values, aspect="auto", cmap=colours, vmin=low, vmax=high)
        axes.set_title(title, fontsize=10)
        axes.set_xticks(range(len(grid.heads)), [head.replace(", ", "\n") for head in grid.heads.values()])
        axes.tick_params(axis="x", labelrotation=90, labelsize=8)
        for y, line in enumerate(values):
            for x, value in enumerate(line):
                text = "–" if np.isnan(value) else f"{value:.2f}"
                dark = not np.isnan(value) and abs(float(np.clip(shade.norm(value), 0, 1)) - 0.5) > DARK
                axes.text(x, y, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
            if not np.isnan(line).all():
                corner = best(line) - 0.5, y - 0.5
                axes.add_patch(plt.Rectangle(corner, 1, 1, fill=False, edgecolor="black", linewidth=1.6))
    left.set_yticks(range(len(grid.rows)), [row.label for row in grid.rows], fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _ratios(grid: Grid, figure: str, floor: str) -> Floats:
    """(rows, methods) a figure over its floor, NaN where there is none."""
    values = np.full((len(grid.rows), len(grid.heads)), np.nan)
    for y, row in enumerate(grid.rows):
        for x, method in enumerate(grid.heads):
            figures = grid.figures(row, method)
            if figures:
                values[y, x] = figures[figure] / figures[floor]
    return values
