"""The paper's Tables 2 to 4, its printed figures beside those reached: `python -m tests.bench table2` to `table4`.

Nothing is measured here: the figures are those of published.json and yardstick.json, on shapes that anybody can have.
The paper's own samples are not named, so only the order of the methods can be compared, not the figures. A method that
has not ended shows the steps that it reached. F-scores and distances are in the unit frame of every shape.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from tests.bench import published, yardstick
from tests.bench.published import DENSE_PER_M2, DENSE_SCENE, DRESS, PER_M2, SCENE, TRUCK, Cell, by_density, cells
from tests.bench.records import Record, Records
from tests.bench.shapes import Row

Stored = dict[tuple[str, str, str], Record]


@dataclass(frozen=True, slots=True)
class Line:
    """A method of a table: what the paper calls it, its printed figures, and the method measured here, or why none."""

    name: str
    printed: tuple[float, ...]
    method: str = ""
    absent: str = ""


PRODUCT = Line("the product", (), published.OWN)
ONE_PHOTO = "of one photo: bench single-image"
METHODS = (
    ("Ground truth", "floor", ""),
    ("Implicitly [44]", "", ONE_PHOTO),
    ("Anchor-UDF [47]", "", ONE_PHOTO),
    ("CAP-UDF [46]", "cap-udf", ""),
    ("Doungtap et al. [55]", "", "no public code"),
    ("LevelSet-UDF [49]", "levelset-udf", ""),
    ("the paper", "paper", ""),
)
"""Lines of Tables 2 and 3: name, the method measured here, or why none is."""


def _lines(*printed: tuple[float, ...]) -> tuple[Line, ...]:
    return tuple(
        Line(name, figures, method, absent) for (name, method, absent), figures in zip(METHODS, printed, strict=True)
    )


TABLE_2 = {
    DRESS: _lines(
        (0.001212, 3.001e-6, 0.9897, 0.999),
        (0.005122, 4.209e-4, 0.854, 0.912),
        (0.001734, 1.211e-4, 0.922, 0.954),
        (0.001536, 1.060e-4, 0.94, 0.995),
        (0.001534, 1.034e-4, 0.949, 0.996),
        (0.001516, 6.296e-5, 0.957, 0.997),
        (0.00158, 5.075e-6, 0.97, 0.997),
    ),
    TRUCK: _lines(
        (0.004502, 7.221e-5, 0.9495, 0.999),
        (0.00601, 13.101e-5, 0.654, 0.899),
        (0.005277, 11.792e-5, 0.85, 0.902),
        (0.005014, 9.811e-5, 0.8405, 0.991),
        (0.005001, 9.798e-5, 0.8516, 0.993),
        (0.004986, 8.637e-5, 0.9193, 0.997),
        (0.004919, 8.496e-5, 0.9229, 0.998),
    ),
}
"""Chamfer-L1, consistency, F@.005, F@.01."""
TABLE_3 = _lines(
    (0.0019, 0.1575, 0.0005),
    (0.0078, 0.8315, 0.00031),
    (0.0045, 0.5411, 0.0002),
    (0.0028, 0.3254, 0.00012),
    (0.0028, 0.324, 0.00012),
    (0.0027, 0.281, 0.0001),
    (0.0026, 0.2587, 0.00009),
)
"""Chamfer-L1, Chamfer-L2 × 10⁻⁶, consistency, at 1,000 points per square metre."""
TABLE_4 = {
    PER_M2: {TRUCK: (0.00595, 0.00586), DRESS: (0.00917, 0.0016), SCENE: (None, None)},
    DENSE_PER_M2: {TRUCK: (0.00798, 0.0067), DRESS: (0.01251, 0.00255), SCENE: (None, None)},
}
"""Chamfer-L1 without and with the self-consistency loss, by points per square metre; the truck's is that of a van."""
MEMORY_GB = {PER_M2: ("3.9–6.8", "2.1–3.2"), DENSE_PER_M2: ("6.1–7.8", "3.6–4.5")}
"""The GPU memory beside them, printed once for both objects."""


def main(arguments: list[str], table: str) -> None:
    """Print one table."""
    argparse.ArgumentParser(prog=f"python -m tests.bench {table}", description=__doc__).parse_args(arguments)
    records = {**Records(yardstick.STORED).all(), **Records(published.STORED).all()}
    for line in TABLES[table](records):
        print(line)


def _table2(records: Stored) -> Iterator[str]:
    for row, lines in TABLE_2.items():
        yield f"\n{row.label} (the paper's: its ShapeNet sample, {row.name})\n"
        yield _head("Chamfer-L1", "consistency × 10⁵", "F@.005", "F@.01")
        yield "|" + "---|" * 10
        for line in (*lines, PRODUCT):
            found = _figures(row, line, records)
            chamfer, consistency, near, wide = line.printed or (None,) * 4
            pairs = [
                _pair(chamfer, found.get("chamfer_l1"), "{:.5f}"),
                _pair(_times(1e5, consistency), _times(1e5, found.get("consistency")), "{:,.5g}"),
                _pair(near, found.get("f_005"), "{:.3f}"),
                _pair(wide, found.get("f_010"), "{:.3f}"),
            ]
            yield f"| {line.name} | {found['steps']} | {' | '.join(pairs)} |"


def _table3(records: Stored) -> Iterator[str]:
    for scene, per_m2 in ((SCENE, PER_M2), (DENSE_SCENE, DENSE_PER_M2)):
        yield f"\n{scene.label} points, {per_m2:,} per square metre (the paper's: a lounge of the Stanford 3D scenes)\n"
        yield _head("Chamfer-L1", "Chamfer-L2 × 10⁻⁶", "consistency × 10⁵")
        yield "|" + "---|" * 8
        for line in (*TABLE_3, PRODUCT):
            found = _figures(scene, line, records)
            printed = line.printed if per_m2 == PER_M2 else ()
            chamfer, squared, consistency = printed or (None,) * 3
            pairs = [
                _pair(chamfer, found.get("chamfer_l1"), "{:.5f}"),
                _pair(squared, _times(1e6, found.get("chamfer_l2")), "{:.4g}"),
                _pair(_times(1e5, consistency), _times(1e5, found.get("consistency")), "{:,.5g}"),
            ]
            yield f"| {line.name} | {found['steps']} | {' | '.join(pairs)} |"


def _table4(records: Stored) -> Iterator[str]:
    yield (
        "\n| subject | points per m² | self-consistency | steps | Chamfer-L1, printed | reached | floor "
        "| GPU GB, printed | GPU MB | peak MB, process |"
    )
    yield "|" + "---|" * 10
    for per_m2, subjects in TABLE_4.items():
        for row, both in subjects.items():
            for on, method in enumerate(("paper-no-self", "paper")):
                found = _figures(by_density(row, per_m2), Line("", (), method), records)
                yield (
                    f"| {row.name} | {per_m2:,} | {'with' if on else 'without'} | {found['steps']} "
                    f"| {_pair(both[on], found.get('chamfer_l1'), '{:.5f}')} | {_number(found.get('floor'), '{:.5f}')} "
                    f"| {MEMORY_GB[per_m2][on] if both[on] else '–'} | {found.get('gpu_mb', '–')} "
                    f"| {found.get('peak_mb', '–')} |"
                )


def _figures(row: Row, line: Line, records: Stored) -> dict[str, Any]:
    """The latest figures of a line on a row; `steps` says how far it came, or why there are none."""
    if line.absent:
        return {"steps": line.absent}
    if line.method == "floor":
        known = next((record.figures for record in records.values() if record.row == row.label), {})
        curve = known.get("curve", [known])
        return {"steps": "–", "chamfer_l1": curve[-1].get("floor"), "f_005": curve[-1].get("floor_f_005")}
    if line == PRODUCT:
        found = [each for (label, method, _), each in records.items() if (label, method) == (row.label, line.method)]
        return {"steps": "–", **found[0].figures} if found else {"steps": "not measured"}
    cell = next(each for each in cells() if each.row == row and each.label == line.method)
    return _reached(cell, records)


def _reached(cell: Cell, records: Stored) -> dict[str, Any]:
    curve = published.curve_of(cell, records)
    if not curve:
        return {"steps": f"0 of {cell.config.loss_steps:,}"}
    last = curve[-1]
    ended = last["step"] >= cell.config.loss_steps
    return {**last, "steps": f"{last['step']:,}" + ("" if ended else f" of {cell.config.loss_steps:,}")}


def _head(*columns: str) -> str:
    return "| method | steps | " + " | ".join(f"{column}, printed | reached" for column in columns) + " |"


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def _pair(printed: float | None, reached: float | None, form: str) -> str:
    return f"{_number(printed, form)} | {_number(reached, form)}"


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)


TABLES: dict[str, Callable[[Stored], Iterator[str]]] = {"table2": _table2, "table3": _table3, "table4": _table4}
