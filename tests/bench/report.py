"""The yardstick's records as Markdown: how near, how whole, how long, and who is best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tests.bench.methods import NAMES, PEERS, PRODUCT
from tests.bench.records import Record, code_version
from tests.bench.shapes import Row, topology

TIE = 0.03  # on clean rows: two samplings of one mesh differ by 1 %, two seeds of one method by 2 %
KEPT, STALE = "†", " \\*"
Figures = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Grid:
    """What is shown: rows, heads of the columns by method, records by (row, method), and the product's method."""

    rows: Sequence[Row]
    heads: dict[str, str]
    records: dict[tuple[str, str], Record]
    product: str

    def figures(self, row: Row, method: str) -> Figures | None:
        """A cell's figures, None where it was not measured or failed."""
        record = self.records.get((row.label, method))
        return record.figures if record and "failed" not in record.figures else None

    def of_row(self, row: Row) -> dict[str, Figures]:
        """The figures of a row by method, of the cells that have any."""
        cells = {method: self.figures(row, method) for method in self.heads}
        return {method: figures for method, figures in cells.items() if figures}

    def stale(self, row: Row, method: str) -> bool:
        """Whether other code than this checkout's made the cell; Open3D's cells do not depend on ours."""
        record = self.records.get((row.label, method))
        return record is not None and method not in PEERS and record.version != code_version(method)

    def kept(self, row: Row, method: str) -> bool:
        """Whether the pipeline found its training no better and stayed with the preview."""
        record = self.records.get((row.label, method))
        return record is not None and any("preview was kept" in said for said in record.figures.get("remarks", ()))


@dataclass(frozen=True, slots=True)
class Standing:
    """How a column compares with the others on a row: its figure over the best other one, best is lowest."""

    row: Row
    rival: str
    ratio: float

    @property
    def outcome(self) -> str:
        """A win, a tie (within 3 % on a clean row), or behind."""
        if self.ratio <= 1:
            return "win"
        return "tie" if self.row.clean and self.ratio <= 1 + TIE else "behind"


def head(method: str, steps: int, batch: int) -> str:
    """A column's head; that of a field fitted for the bench says how long."""
    name = NAMES.get(method, method)
    if method in PRODUCT or method in PEERS or not steps:
        return name
    return f"{name}, {steps:,} × {batch:,}" if batch else f"{name}, {steps:,} steps"


def words(figures: Figures) -> str:
    """A cell on one line, for the log."""
    if "failed" in figures:
        return f"failed: {figures['failed']}"
    pieces = f"{figures['components']} pieces, {figures['seconds']:.1f} s, {figures['peak_mb']:,.0f} MB"
    return f"{figures['chamfer_l1']:.5f}/{figures['f_005']:.3f}, {pieces}"


def everything(grid: Grid) -> str:
    """All tables and the count."""
    parts = [
        "### How near: Chamfer-L1 / F@.005\n",
        table(grid, _near, ("floor", lambda row: _floor(grid, row))),
        "\n### How near: Chamfer-L2 × 10⁶ / F@.01 / normal consistency\n",
        table(grid, lambda f: f"{f['chamfer_l2'] * 1e6:.1f}/{f['f_010']:.3f}/{f['normal_consistency']:.3f}"),
        "\n### How whole: pieces / border loops / non-manifold edges\n",
        table(
            grid,
            lambda f: f"{f['components']}/{f['boundary_loops']}/{f['non_manifold_edges']}",
            ("truth", lambda row: "/".join(map(str, topology(row.truth)))),
        ),
        "\n### Borders and area: boundary error / area over the truth's\n",
        table(grid, lambda f: f"{_number(f['boundary_error'])}/{f['area_ratio']:.3f}"),
        "\n### How long: seconds / peak MB\n",
        table(grid, lambda f: f"{f['seconds']:.1f}/{f['peak_mb']:,.0f}"),
        "\n### Standing\n",
        *verdicts(grid),
        *_failures(grid),
    ]
    return "\n".join(parts)


def table(grid: Grid, cell: Callable[[Figures], str], beside: tuple[str, Callable[[Row], str]] | None = None) -> str:
    """One table: a line a row, a column a method, and a column beside the rows' names for what the best there can be.

    The best by Chamfer-L1 is bold; a stale cell has an asterisk, a kept preview a dagger.
    """
    heads = ["row", *([beside[0]] if beside else []), *grid.heads.values()]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in grid.rows:
        cells = grid.of_row(row)
        best = min(cells, key=lambda method: cells[method]["chamfer_l1"], default=None)
        shown = [row.label, *([beside[1](row)] if beside else [])]
        for method in grid.heads:
            text = cell(cells[method]) if method in cells else "—"
            text = f"**{text}**" if method == best else text
            shown.append(text + KEPT * grid.kept(row, method) + STALE * grid.stale(row, method))
        lines.append("| " + " | ".join(shown) + " |")
    return "\n".join(lines)


def verdicts(grid: Grid) -> list[str]:
    """Where the product's column is best, by Chamfer-L1 and by F@.005, and which rows it loses to whom.

    First against the other methods, then with the product's other presets, which take longer or less long, among them.
    """
    said = []
    product = grid.heads.get(grid.product, grid.product)
    others = [method for method in grid.heads if method not in PRODUCT]
    for name, figure, rivals in (
        ("Chamfer-L1 against other methods", "chamfer_l1", others),
        ("F@.005 against other methods", "f_005", others),
        ("Chamfer-L1 against all columns", "chamfer_l1", list(grid.heads)),
        ("F@.005 against all columns", "f_005", list(grid.heads)),
    ):
        standings = _standings(grid, figure, rivals)
        count = {kind: sum(each.outcome == kind for each in standings) for kind in ("win", "tie", "behind")}
        said.append(
            f"- {name}: {product} is best on {count['win']} of {len(standings)} rows, "
            f"within {TIE:.0%} of the best on {count['tie']} clean ones, behind on {count['behind']}."
        )
        said += [
            f"  - {each.row.label}: {each.ratio - 1:.1%} behind {grid.heads[each.rival]}"
            for each in standings
            if each.outcome == "behind"
        ]
    return said


def _standings(grid: Grid, figure: str, rivals: Sequence[str]) -> list[Standing]:
    standings = []
    for row in grid.rows:
        own = grid.figures(row, grid.product)
        cells = {method: each for method, each in grid.of_row(row).items() if method in rivals}
        cells.pop(grid.product, None)
        if own and cells:
            losses = {method: _loss(figures, figure) for method, figures in cells.items()}
            rival = min(losses, key=lambda method: losses[method])
            standings.append(Standing(row, rival, _loss(own, figure) / max(losses[rival], 1e-12)))
    return standings


def _loss(figures: Figures, figure: str) -> float:
    """A figure of which less is better; an F-score is inverted, so that 3 % of it are 3 %."""
    value = float(figures[figure])
    return value if figure == "chamfer_l1" else 1 / max(value, 1e-12)


def _near(figures: Figures) -> str:
    return f"{figures['chamfer_l1']:.5f}/{figures['f_005']:.3f}"


def _floor(grid: Grid, row: Row) -> str:
    return next((f"{f['floor']:.5f}/{f['floor_f_005']:.3f}" for f in grid.of_row(row).values()), "")


def _number(value: float | str) -> str:
    return "∞" if value == "inf" else f"{value:.4f}"


def _failures(grid: Grid) -> list[str]:
    return [
        f"- {row.label}: {grid.heads[method]} failed: {record.figures['failed']}"
        for row in grid.rows
        for method in grid.heads
        if (record := grid.records.get((row.label, method))) and "failed" in record.figures
    ]
