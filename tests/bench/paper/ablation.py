"""What each loss does: each off in turn, and the weight of self-consistency (the paper's Table 4).

Every variant is the preset with one weight changed, from the same points, seed and number of steps, meshed alike.
Results are kept in ablation.json as the yardstick's are.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.preset import load_preset
from tests.bench.cell import run_cell
from tests.bench.methods import Settings
from tests.bench.records import Record, Records, fingerprint, record_of
from tests.bench.report import words
from tests.bench.shapes import ROWS, Row

STORED = Path(__file__).parent / "ablation.json"
SHAPES = ("two sheets 0.06 apart, 3,000", "pleated skirt, 1,000", "dress, 10,000, σ 0.004")
LOSSES = {
    "chamfer": "L_CD",
    "projection": "L_proj",
    "orthogonality": "L_orth",
    "surface": "L_surf",
    "self_consistency": "L_sc",
    "far_share": "far queries",
}
READINGS: dict[str, dict[str, Any]] = {
    "printed sign of λ": {"sign": "printed"},
    "log(1/ω) an input": {"certainty": "input"},
    "pairs agree in their distance alone": {"pairs": "distance"},
    "mean of both directions in (1)": {"chamfer": 0.5},
    "kernel 3 over 6 neighbours": {"neighbours": 6},
    "169 throughout": {"widths": (169,) * 6},
}
"""Other readings of the paper's equations and network."""
ANCHOR_LOSSES = {"DISTANCE": "L_d", "GRADIENT": "L_g", "FLATNESS": "L_c"}
"""Weights of the anchors' losses, constants of `anchor_losses.py`."""
SURFACE = 0.1  # τ_f where the preset has none: LevelSetUDF's
CONSISTENCY = (1e-3, 1e-1)  # τ_s beside the preset's own


def main(arguments: list[str]) -> None:
    """Measure what is missing and print the table."""
    options = _parser().parse_args(arguments)
    rows = [row for row in ROWS if row.label in SHAPES and options.rows in row.label]
    records = Records(STORED)
    config = load_preset(options.preset).fit
    if config is None:
        raise SystemExit(f"preset '{options.preset}' trains nothing")
    print(f"preset {options.preset}, {options.steps:,} steps of {options.batch:,} queries\n")
    print("| row | variant | Chamfer-L1 | F@.005 | normals | consistency | pieces | boundary error | s | peak MB |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        for name, changes in variants(config):
            record = _measured(row, name, changes, options, records)
            print(f"| {row.label} | {name} | {' | '.join(_cells(record.figures))} |", flush=True)


def variants(config: AnchorConfig | NetworkConfig) -> Iterator[tuple[str, dict[str, Any]]]:
    """The preset, then each of its losses off (or the one it has not, on), then other weights of self-consistency."""
    yield "as it is", {}
    if isinstance(config, AnchorConfig):
        yield from ((f"without {name}", {constant: 0.0}) for constant, name in ANCHOR_LOSSES.items())
        yield "without L_d and L_g: no self-consistency", {"DISTANCE": 0.0, "GRADIENT": 0.0}
        return
    for field, name in LOSSES.items():
        if getattr(config, field):
            yield f"without {name}", {field: 0.0}
    if not config.surface:
        yield f"with L_surf, τ_f = {SURFACE:g}", {"surface": SURFACE}
    for weight in CONSISTENCY:
        if weight != config.self_consistency:
            yield f"τ_s = {weight:g}", {"self_consistency": weight}
    if config.model == "separable":
        yield from READINGS.items()


def _measured(row: Row, name: str, changes: dict[str, Any], options: argparse.Namespace, records: Records) -> Record:
    settings = Settings(
        options.preset,
        resolution=row.resolution,
        steps=options.steps,
        batch=options.batch,
        seed=options.seed,
        device=options.device,
        bare=True,
        changes=changes,
    )
    key: dict[str, Any] = {
        **row.scan,
        "preset": options.preset,
        "steps": options.steps,
        "batch": options.batch,
        "seed": options.seed,
        "device": options.device,
        "changes": changes,
    }
    stored = records.all().get((row.label, name, fingerprint(key)))
    if stored and not options.fresh:
        return stored
    truth = row.truth()
    figures = run_cell(row.sampled(truth, options.seed), truth, settings, options.timeout)
    record = record_of(row.label, name, key, figures)
    records.add(record)
    print(f"{row.label}: {name}: {words(figures)}", file=sys.stderr, flush=True)
    return record


def _cells(figures: dict[str, Any]) -> list[str]:
    if "failed" in figures:
        return [f"failed: {figures['failed']}", *["—"] * 7]
    error = figures["boundary_error"]
    return [
        f"{figures['chamfer_l1']:.5f}",
        f"{figures['f_005']:.3f}",
        f"{figures['normal_consistency']:.3f}",
        f"{figures['consistency']:.4f}",
        f"{figures['components']}",
        "∞" if error == "inf" else f"{error:.4f}",
        f"{figures['seconds']:.0f}",
        f"{figures['peak_mb']:,.0f}",
    ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench ablation", description=__doc__)
    parser.add_argument("--preset", default="paper", help="whose losses; any preset that trains")
    parser.add_argument("--rows", default="", help=f"only rows whose label contains this, of: {'; '.join(SHAPES)}")
    parser.add_argument("--steps", type=int, default=1_500, help="0: as the preset says")
    parser.add_argument("--batch", type=int, default=500, help="0: as the preset says")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fresh", action="store_true", help="measure again what is already stored")
    parser.add_argument("--timeout", type=float, default=3_600, help="seconds per cell")
    return parser
