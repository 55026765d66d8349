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
from itertools import islice, product
from typing import Any

from capture2vr.edge.field.step import Step
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from capture2vr.edge.paper_field.networks import network_of
from capture2vr.edge.preset import load_preset
from tests.support import surfaces

NETWORKS: dict[str, dict[str, Any]] = {
    "128 and 256, as printed": {},
    "169 throughout": {"widths": (169,) * 6},
    "128 throughout": {"widths": (128,) * 6},
    "kernel 3 over 6 neighbours, 168 throughout": {"widths": (168,) * 6, "neighbours": 6},
    "log(1/ω) an input": {"certainty": "input"},
    "ancestors' MLP": {"model": "mlp"},
}
"""Readings of the paper's network, and its ancestors', by what differs from the preset `paper`."""
TERMS = {"all terms": {}, "pull": {"projection": 0.0, "orthogonality": 0.0, "self_consistency": 0.0, "surface": 0.0}}
WARM = 3  # steps before the clock: allocators, and the capture of a CUDA graph
TURNS, STEPS = 5, {"cpu": 2, "cuda": 100}  # steps of one model before the other's turn; a GPU yields every 25 of them


def main(arguments: list[str]) -> None:
    """Print the sizes, then the seconds."""
    options = _parser().parse_args(arguments)
    paper = load_preset("paper").fit
    assert isinstance(paper, NetworkConfig)
    paper = replace(paper, pool=200_000)
    print(
        "The paper prints 147.2 thousand parameters and 0.57 MB for its network, 463.1 thousand and 1.78 for the MLP.\n"
    )
    print("| network | parameters | MB (2²⁰ bytes) |")
    print("|---|---|---|")
    for name, changes in NETWORKS.items():
        count = sum(each.numel() for each in network_of(replace(paper, **changes)).parameters())
        print(f"| {name} | {count:,} | {4 * count / 2**20:.2f} |")
    print(f"\n{options.device}\n")
    print("| network | terms | points | batch | ms a step | the MLP's | ratio | its 40,000 steps, min | GPU MB |")
    print("|---|---|---|---|---|---|---|---|---|")
    chosen = [(name, terms) for name in options.networks or list(NETWORKS)[:-1] for terms in TERMS]
    for (name, terms), points, batch in product(chosen, options.points, options.batch):
        config = replace(paper, batch=batch, **TERMS[terms])
        ours = step_seconds(points, replace(config, **NETWORKS[name]), options.device)
        theirs = step_seconds(points, replace(config, model="mlp"), options.device)
        own, other = _median_in_turns(ours, theirs)
        print(
            f"| {name} | {terms} | {points:,} | {batch:,} | {own * 1e3:.1f} | {other * 1e3:.1f} | {own / other:.2f} "
            f"| {own * 40_000 / 60:.0f} | {_gpu_mb(options.device)} |",
            flush=True,
        )


def step_seconds(count: int, config: NetworkConfig, on: str) -> Iterator[float]:
    """The seconds of a step on so many points, each time it is asked."""
    points = surfaces.sampled(surfaces.pleated_skirt(), count)
    device = "cuda" if on.startswith("cuda") else "cpu"
    running = fit_network(points, config, device=on)
    steps = (step for step in running if step.losses)
    first = next(islice(steps, WARM, None))
    while True:
        began, last = time.perf_counter(), _advanced(steps, first.number + STEPS[device])
        yield (time.perf_counter() - began) / (last.number - first.number)
        first = last


def _gpu_mb(device: str) -> str:
    """Most memory that was allocated on a GPU since the last call."""
    import torch

    if not device.startswith("cuda"):
        return "–"
    taken = torch.cuda.max_memory_allocated(device)
    torch.cuda.reset_peak_memory_stats(device)
    return f"{taken / 2**20:,.0f}"


def _advanced(steps: Iterator[Step], number: int) -> Step:
    return next(step for step in steps if step.number >= number)


def _median_in_turns(ours: Iterator[float], theirs: Iterator[float]) -> tuple[float, float]:
    pairs = [(next(ours), next(theirs)) for _ in range(TURNS)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench complexity", description=__doc__)
    parser.add_argument("--batch", type=int, nargs="*", default=[1_000, 5_000, 20_000], help="queries a step")
    parser.add_argument("--points", type=int, nargs="*", default=[10_000])
    parser.add_argument("--networks", nargs="*", choices=list(NETWORKS)[:-1], help="all if none is named")
    parser.add_argument("--device", default="cpu")
    return parser
