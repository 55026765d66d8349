"""Every shape by every method, measured once and kept: `python -m tests.bench yardstick`.

What is missing in yardstick.json is measured, each cell in a process of its own; then the tables are printed and
yardstick.png is drawn. `--table` only prints. Cells made by other code than this checkout's are marked, and measured
again with `--fresh`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.bench import plots, report
from tests.bench.cell import run_cell
from tests.bench.methods import ANCESTORS, NAMES, PEERS, PRODUCT, Settings, Unavailable
from tests.bench.records import Record, Records, fingerprint, record_of
from tests.bench.shapes import ROWS, Row

FOLDER = Path(__file__).parent
STORED = FOLDER / "yardstick.json"
PLOT = FOLDER / "yardstick.png"
STEPS, BATCH = 1_000, 1_000  # of the ancestors, stated in the table: 40,000 steps of 5,000 take 8 hours on two cores


def main(arguments: list[str]) -> None:
    """Measure what is missing, print the tables, draw the plot."""
    options = _parser().parse_args(arguments)
    rows = [row for row in ROWS if options.rows in row.label and row.points in (options.points or [row.points])]
    methods = options.methods.split(",")
    records = Records(STORED)
    if not options.table:
        measure(rows, methods, options, records)
    stored = records.all()
    shown = {method: report.head(method, options.steps, options.batch) for method in methods}
    grid = report.Grid(rows, shown, dict(_shown(rows, methods, options, stored)), options.product)
    print(report.everything(grid))
    if set(rows) == set(ROWS):
        plots.heat(grid, PLOT)
        print(f"\ndrawn: {PLOT.name}")


def measure(rows: list[Row], methods: list[str], options: argparse.Namespace, records: Records) -> None:
    """Measure the cells that no record is of, or all with --fresh."""
    for method in methods:
        for row in rows:
            chosen = _settings(row, method, options)
            if not options.fresh and (row.label, method, fingerprint(_key(row, chosen))) in records.all():
                continue
            truth = row.truth()
            try:
                figures = run_cell(row.sampled(truth, options.seed), truth, chosen, options.timeout)
            except Unavailable as error:
                print(f"{NAMES.get(method, method)}: — {error}", file=sys.stderr)
                break
            records.add(record_of(row.label, method, _key(row, chosen), figures))
            print(f"{row.label}: {NAMES.get(method, method)}: {report.words(figures)}", file=sys.stderr, flush=True)


def _shown(
    rows: list[Row], methods: list[str], options: argparse.Namespace, stored: dict[tuple[str, str, str], Record]
) -> Iterator[tuple[tuple[str, str], Record]]:
    for row in rows:
        for method in methods:
            record = stored.get((row.label, method, fingerprint(_key(row, _settings(row, method, options)))))
            if record:
                yield (row.label, method), record


def _settings(row: Row, method: str, options: argparse.Namespace) -> Settings:
    """What the method is run with on that row: what it does not know is left as it is, so its records stay valid."""
    settings = Settings(method, resolution=row.resolution, seed=options.seed, device=options.device)
    if method in PEERS:
        return replace(settings, resolution=0, device="cpu")
    if method == "draft":
        return replace(settings, device="cpu")
    return settings if method in PRODUCT else replace(settings, steps=options.steps, batch=options.batch)


def _key(row: Row, chosen: Settings) -> dict[str, Any]:
    return {
        **row.scan,
        "resolution": chosen.resolution,
        "steps": chosen.steps,
        "batch": chosen.batch,
        "seed": chosen.seed,
        "device": chosen.device,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench yardstick", description=__doc__)
    known = ",".join([*PRODUCT, *PEERS, *ANCESTORS])
    parser.add_argument("--methods", default=known, help=f"columns, among them any preset; all: {known}")
    parser.add_argument("--rows", default="", help="only rows whose label contains this")
    parser.add_argument("--points", type=int, nargs="*", help="only rows of these numbers of points")
    parser.add_argument("--steps", type=int, default=STEPS, help="of the ancestors; 0: as published")
    parser.add_argument("--batch", type=int, default=BATCH, help="of the ancestors; 0: as published")
    parser.add_argument("--seed", type=int, default=0, help="of the points and of the training")
    parser.add_argument("--device", default="cpu", help="where fields are trained, as cuda:0")
    parser.add_argument("--fresh", action="store_true", help="measure again what is already stored")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--product", default="standard", help="the column whose wins are counted")
    parser.add_argument("--timeout", type=float, default=3_600, help="seconds per cell")
    return parser
