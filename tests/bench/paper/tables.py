"""The paper's Tables 2 and 3 on the data that you have: `python -m tests.bench tables --scenes DIR`.

Objects (Table 2: ShapeNet as it is, garments in their unit frame) and scenes (Table 3, metres), each a line a method,
the mean over the subjects; by class where the folder names classes. CD-L2 is the sum of both mean squares, as in all
these benches; CAP-UDF's own evaluation halves it. The floor is the truth against itself.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

from tests.bench import datasets
from tests.bench.cell import run_cell
from tests.bench.datasets import Entry, LayoutError, Subject
from tests.bench.methods import LITERATURE, PEERS, PRODUCT, Settings, Unavailable
from tests.bench.report import head, words

SOURCES = {
    "shapenet": ("Table 2: ShapeNet", datasets.shapenet),
    "garments": ("Table 2: DeepFashion3D", datasets.deep_fashion),
    "scenes": ("Table 3: 3D scenes", datasets.scenes),
}
COLUMNS = ("CD-L1", "CD-L2 × 10⁻⁶", "F@.005", "F@.01", "normals", "consistency × 10⁵", "s", "peak MB", "of")


def main(arguments: list[str]) -> None:
    """Print a table for each folder that is named."""
    options = _parser().parse_args(arguments)
    chosen = {name: folder for name in SOURCES if (folder := getattr(options, name))}
    if not chosen:
        raise SystemExit(f"name a folder: {', '.join(f'--{name} DIR' for name in SOURCES)}")
    for name, folder in chosen.items():
        title, load = SOURCES[name]
        entries = load(folder)
        for group in dict.fromkeys(entry.group for entry in entries):
            _print_group(
                f"{title}, {group}" if group else title, [each for each in entries if each.group == group], options
            )
        if name == "garments":
            print("".join(_absent_classes(folder, entries)), end="")


def _print_group(title: str, entries: list[Entry], options: argparse.Namespace) -> None:
    """Print the table of one class, and a sentence for each of its subjects that cannot be read."""
    subjects, unread = [], []
    for entry in entries[: options.limit]:
        try:
            subjects.append(entry.load())
        except LayoutError as error:
            unread.append(str(error))
    print(f"### {title}\n")
    if subjects:
        print("| method | " + " | ".join(COLUMNS) + " |\n|" + "---|" * (1 + len(COLUMNS)))
        for line in table(subjects, options):
            print(line, flush=True)
        print()
    for reason in unread:
        print(f"Not measured: {reason}\n")


def _absent_classes(folder: Path, entries: list[Entry]) -> Iterator[str]:
    """Yield a sentence for each class that the list names and the folder does not have."""
    there = {entry.group for entry in entries}
    for name, count in Counter(datasets.garment_classes(folder).values()).items():
        if name not in there:
            yield f"Not measured: class {name}, none of whose {count} garments is in {folder}\n\n"


def table(subjects: list[Subject], options: argparse.Namespace) -> Iterator[str]:
    """A line for every method, then the floor."""
    floors: list[tuple[float, float]] = []
    for method in options.methods.split(","):
        name = head(method, options.steps, options.batch)
        try:
            results = list(_results(subjects, method, options))
        except Unavailable as error:
            yield f"| {name} | — {error} |" + " |" * (len(COLUMNS) - 1)
            continue
        done = [figures for figures in results if "failed" not in figures]
        yield f"| {name} | {' | '.join(_means(done, len(results)))} |"
        floors = floors or [(each["floor"], each["floor_f_005"]) for each in done if each["floor"] is not None]
    if floors:
        distance, f_score = (fmean(column) for column in zip(*floors, strict=True))
        yield f"| floor | {distance:.5f} | | {f_score:.4f} |" + " |" * (len(COLUMNS) - 3)


def _results(subjects: list[Subject], method: str, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    of_literature = method not in PRODUCT and method not in PEERS
    settings = Settings(
        method,
        resolution=options.resolution,
        steps=options.steps if of_literature else 0,
        batch=options.batch if of_literature else 0,
        device=options.device,
    )
    for subject in subjects:
        figures = run_cell(subject.points, subject.truth, settings, options.timeout)
        print(f"{subject.name}: {method}: {words(figures)}", file=sys.stderr, flush=True)
        yield figures


def _means(done: list[dict[str, Any]], tried: int) -> list[str]:
    if not done:
        return ["—"] * (len(COLUMNS) - 1) + [f"0 of {tried}"]
    return [
        _mean(done, "chamfer_l1", "{:.5f}"),
        _mean(done, "chamfer_l2", "{:.4g}", 1e6),
        _mean(done, "f_005", "{:.4f}"),
        _mean(done, "f_010", "{:.4f}"),
        _mean(done, "normal_consistency", "{:.3f}"),
        _mean(done, "consistency", "{:.1f}", 1e5),
        _mean(done, "seconds", "{:.1f}"),
        _mean(done, "peak_mb", "{:,.0f}"),
        f"{len(done)} of {tried}",
    ]


def _mean(done: list[dict[str, Any]], figure: str, form: str, factor: float = 1.0) -> str:
    values = [each[figure] for each in done if each[figure] is not None]
    return form.format(factor * fmean(values)) if values else "—"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench tables", description=__doc__)
    for name, (title, _) in SOURCES.items():
        parser.add_argument(f"--{name}", type=Path, metavar="DIR", help=title)
    known = ",".join([*PRODUCT, *PEERS, *LITERATURE])
    parser.add_argument("--methods", default=known, help=f"lines, among them any preset; all: {known}")
    parser.add_argument("--limit", type=int, help="only the first so many of each class")
    parser.add_argument("--resolution", type=int, default=256, help="cells along the longest side; the papers' is 256")
    parser.add_argument("--steps", type=int, default=0, help="of the literature; 0: as published")
    parser.add_argument("--batch", type=int, default=0, help="of the literature; 0: as published")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--timeout", type=float, default=24 * 3_600, help="seconds per mesh")
    return parser
