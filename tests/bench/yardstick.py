"""Every shape by every method, measured once and kept: `python -m tests.bench yardstick`.

What is missing in yardstick.json is measured, each cell in a process of its own; then the tables are printed and
yardstick.png is drawn. `--table` only prints. Cells made by other code than this checkout's are marked, and measured
again with `--fresh`; where the code changed and what it computes should not have, `--adopt 3` measures three of them
and takes the others over if all three come out the same to the digit.
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
from tests.bench.methods import LITERATURE, NAMES, PEERS, PRODUCT, Settings, Unavailable
from tests.bench.records import Record, Records, code_version, fingerprint, record_of
from tests.bench.shapes import ROWS, Row

FOLDER = Path(__file__).parent
STORED = FOLDER / "yardstick.json"
PLOT = FOLDER / "yardstick.png"
# Of the literature, stated in the table: 40,000 steps of 5,000 take 8 hours on two cores. A query of LevelSetUDF costs
# two of CAP-UDF.
STEPS, BATCH = 1_000, {"levelset-udf": 500}
USUAL_BATCH = 1_000
MACHINE = ("seconds", "peak_mb", "threads", "remarks")  # of a cell's figures, those that the machine decides over


def main(arguments: list[str]) -> None:
    """Measure what is missing, print the tables, draw the plot."""
    options = _parser().parse_args(arguments)
    rows = [row for row in ROWS if options.rows in row.label and row.points in (options.points or [row.points])]
    methods = options.methods.split(",")
    records = Records(STORED)
    if options.adopt:
        adopt(rows, methods, options, records)
    elif not options.table:
        measure(rows, methods, options, records)
    stored = records.all()
    shown = {method: report.head(method, options.steps, _batch(method, options)) for method in methods}
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


def adopt(rows: list[Row], methods: list[str], options: argparse.Namespace, records: Records) -> None:
    """Mark cells of other code as this checkout's, method by method and version by version, if a sample says so."""
    shown = dict(_shown(rows, methods, options, records.all()))
    for method in methods:
        current = code_version(method)
        for version in sorted({record.version for record in shown.values()} - {current}):
            stale = [record for record in shown.values() if (record.method, record.version) == (method, version)]
            sample = stale[:: max(1, len(stale) // options.adopt)][: options.adopt]
            other = next((record for record in sample if not _comes_out_the_same(record, rows, options)), None)
            if other:
                print(f"{NAMES.get(method, method)}: {other.row} comes out different", file=sys.stderr)
                continue
            for record in stale:
                records.add(replace(record, version=current))
            print(f"{NAMES.get(method, method)}: {len(stale)} cells taken over", file=sys.stderr, flush=True)


def _comes_out_the_same(record: Record, rows: list[Row], options: argparse.Namespace) -> bool:
    (row,) = (row for row in rows if row.label == record.row)
    truth = row.truth()
    settings = _settings(row, record.method, options)
    figures = run_cell(row.sampled(truth, options.seed), truth, settings, options.timeout)
    return all(figures.get(name) == value for name, value in record.figures.items() if name not in MACHINE)


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
    return settings if method in PRODUCT else replace(settings, steps=options.steps, batch=_batch(method, options))


def _batch(method: str, options: argparse.Namespace) -> int:
    asked: int | None = options.batch
    return BATCH.get(method, USUAL_BATCH) if asked is None else asked


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
    known = ",".join([*PRODUCT, *PEERS, *LITERATURE])
    parser.add_argument("--methods", default=known, help=f"columns, among them any preset; all: {known}")
    parser.add_argument("--rows", default="", help="only rows whose label contains this")
    parser.add_argument("--points", type=int, nargs="*", help="only rows of these numbers of points")
    parser.add_argument("--steps", type=int, default=STEPS, help="of the literature; 0: as published")
    parser.add_argument("--batch", type=int, help="queries a step of the literature; 0: as published")
    parser.add_argument("--seed", type=int, default=0, help="of the points and of the training")
    parser.add_argument("--device", default="cpu", help="where fields are trained, as cuda:0")
    parser.add_argument("--fresh", action="store_true", help="measure again what is already stored")
    parser.add_argument(
        "--adopt", type=int, default=0, help="cells of each method to measure before all are taken over"
    )
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--product", default="standard", help="the column whose wins are counted")
    parser.add_argument("--timeout", type=float, default=3_600, help="seconds per cell")
    return parser
