"""What a step costs: our network against its ancestors' (the paper's Table 5), both timed in the same run.

The two take turns, a few steps each, so that whatever else the machine does falls on both alike; the figure is the
median step. "All terms" are those of (7) for both; "pull" is the Chamfer term alone.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

from services.edge.field.step import Step
from services.edge.paper_field.network_config import NetworkConfig
from services.edge.paper_field.network_fit import fit_network
from services.edge.paper_field.networks import network_of
from services.edge.preset import load_preset
from tests.support import surfaces

MODELS = {"separable": "ours", "mlp": "ancestors' MLP"}
TERMS = {"all terms": {}, "pull": {"projection": 0.0, "orthogonality": 0.0, "self_consistency": 0.0, "surface": 0.0}}
WARM = 3  # steps before the clock: allocators, and the capture of a CUDA graph
TURNS, STEPS = 5, {"cpu": 2, "cuda": 100}  # steps of one model before the other's turn; a GPU yields every 25 of them


def main(arguments: list[str]) -> None:
    """Print the sizes, then the seconds."""
    options = _parser().parse_args(arguments)
    paper = load_preset("ours-paper").fit
    assert paper is not None
    paper = replace(paper, width=options.width, pool=200_000)
    print("| network | parameters | MB |")
    print("|---|---|---|")
    for model, name in MODELS.items():
        count = sum(each.numel() for each in network_of(replace(paper, model=model)).parameters())
        print(f"| {name}{f', {paper.width} wide' if model == 'separable' else ''} | {count:,} | {4e-6 * count:.2f} |")
    print(f"\n{options.points:,} points, {options.device}\n")
    print("| terms | batch | ours, ms a step | MLP, ms a step | ours / MLP | 40,000 steps of ours, min |")
    print("|---|---|---|---|---|---|")
    for terms, off in TERMS.items():
        for batch in options.batch:
            config = replace(paper, batch=batch, **off)
            ours, mlp = step_seconds(options, config, "separable"), step_seconds(options, config, "mlp")
            own, theirs = _median_in_turns(ours, mlp)
            print(
                f"| {terms} | {batch:,} | {own * 1e3:.1f} | {theirs * 1e3:.1f} | {own / theirs:.2f} "
                f"| {own * 40_000 / 60:.0f} |",
                flush=True,
            )


def step_seconds(options: argparse.Namespace, config: NetworkConfig, model: str) -> Iterator[float]:
    """The seconds of a step, each time it is asked."""
    points = surfaces.sampled(surfaces.pleated_skirt(), options.points)
    device = "cuda" if options.device.startswith("cuda") else "cpu"
    running = fit_network(points, replace(config, model=model), device=options.device)
    steps = (step for step in running if step.losses)
    first = next(islice(steps, WARM, None))
    while True:
        began, last = time.perf_counter(), _advanced(steps, first.number + STEPS[device])
        yield (time.perf_counter() - began) / (last.number - first.number)
        first = last


def _advanced(steps: Iterator[Step], number: int) -> Step:
    return next(step for step in steps if step.number >= number)


def _median_in_turns(ours: Iterator[float], theirs: Iterator[float]) -> tuple[float, float]:
    pairs = [(next(ours), next(theirs)) for _ in range(TURNS)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench complexity", description=__doc__)
    parser.add_argument("--batch", type=int, nargs="*", default=[1_000, 5_000, 20_000], help="queries a step")
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--width", type=int, default=128, help="of our network, 128 or 256")
    parser.add_argument("--device", default="cpu")
    return parser
