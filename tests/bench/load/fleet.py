"""A fleet of 10 to 100,000 captures a day, simulated with measured captures: `python -m tests.bench fleet`.

First look: from Send on the phone until the headset shows the preview, at half and at 95 % of the captures. Every load
is met in three ways (`fleet_model.py`). Pools grow and shrink as the chart's do; a place is a shop or a studio with a
worker of its own. Prices are assumptions, and options. `--measure` measures the captures anew, on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import httpx

from capture2vr.cli.progress import StageBar
from capture2vr.cli.up import run_stack
from capture2vr.client.jobs import follow
from capture2vr.client.upload import upload
from tests.bench.data_files import PICTURES, data_file
from tests.bench.load.fleet_model import WAYS, Fleet, Outcome, Sample, Scaling, Way, simulate
from tests.bench.photo_sets import shell

STORED = Path(__file__).parent / "fleet.json"
PICTURE = PICTURES / "fleet.png"
LOADS = (10, 100, 1_000, 10_000, 100_000)
POOLS = (1, 4, 16, 64)  # workers, fixed, of the table of what they bear
GOAL_S = 120.0  # first look at 95 % of the captures: the longest of those measured takes 72 s without any waiting
_MOST = 10_000  # workers of a pool that grows: as many as it takes
_PEAK_H = (10.0, 14.0)  # the busiest hours: the rate is the highest at noon
_POINT_BYTES = 31  # of a point between two workers: services/edge/jobs/points_archive.py
_VIEW_BYTES = 150_000  # of a reduced picture with its depth there, about
_VIEWS = 48  # at most
_LOCAL = {
    "photos: fruit, 20": "photos_fruit/images",
    "photos: statue, 32": "photos_statue/images",
    "RGB-D: living room, 5 frames": "rgbd_livingroom",
    "cloud: scanned room": "cloud_room/fragment.pcd",
    "mesh: dress": "dress/dress-v17k-f34k.obj",
}


@dataclass(frozen=True, slots=True)
class Prices:
    """What things cost, in euro: an hour of a worker of 2 cores and 8 GB, an hour of a box of a place (600 for four
    years, and 10 W), a GB that leaves the CDN, a GB that is kept for a year."""

    worker_h: float = 0.10
    box_h: float = 0.02
    gb_out: float = 0.05
    gb_year: float = 0.25


def main(arguments: list[str]) -> None:
    """Measure, or simulate and print the tables, and draw the picture."""
    options = _parser().parse_args(arguments)
    if options.measure:
        STORED.write_text(json.dumps([asdict(each) for each in _measure()], indent=1) + "\n")
    samples = read_samples()
    prices = Prices(**{name: getattr(options, name) for name in Prices.__slots__})
    print(_inputs(samples), "\n")
    outcomes = {(load, way): simulate(_fleet(load, way, options), samples) for load in LOADS for way in WAYS}
    print(_table(outcomes, samples, options, prices), "\n")
    print(_capacities(samples, options))
    _draw(outcomes)


def read_samples() -> list[Sample]:
    """Read the measured captures."""
    return [Sample(**each) for each in json.loads(STORED.read_text())]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench fleet", description=__doc__)
    parser.add_argument("--measure", action="store_true", help="measure the captures first, on an idle machine")
    parser.add_argument("--per-place", type=float, default=100.0, help="captures a day of one place")
    for name, price in asdict(Prices()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=price, help="euro")
    return parser


def _fleet(load: float, way: Way, options: argparse.Namespace) -> Fleet:
    return Fleet(way, load, max(1, math.ceil(load / options.per_place)), Scaling(0, _MOST))


def at_share(values: list[float], arrived: int, share: float) -> float:
    """Return the value that this share of all that arrived stays below; infinite where fewer got there."""
    rank = math.ceil(share * arrived)
    return sorted(values)[rank - 1] if 0 < rank <= len(values) else math.inf


def cost_cents(outcome: Outcome, samples: list[Sample], prices: Prices) -> float:
    """Cost of an asset in cents: workers, boxes, bytes out and kept."""
    assets = max(1, len(outcome.end_s))
    kept = sum(each.all_bytes + each.upload_bytes for each in samples) / len(samples)
    euro = (outcome.pool_s * prices.worker_h + outcome.box_s * prices.box_h) / 3600 / assets
    euro += (outcome.sent_bytes / assets * prices.gb_out + kept * prices.gb_year) / 1e9
    return 100 * euro


def capacity(samples: list[Sample], make: Callable[[float], Fleet], *, at_most: float) -> float:
    """Return the most captures a day, to within 3 %, of which 95 % have their first look within two minutes at noon."""
    low, high = 1.0, at_most
    while high / low > 1.03:
        middle = math.sqrt(low * high)
        outcome = simulate(make(middle), samples, from_hour=_PEAK_H[0], to_hour=_PEAK_H[1])
        if at_share(outcome.first_look_s, outcome.arrived, 0.95) <= GOAL_S:
            low = middle
        else:
            high = middle
    return low


def _inputs(samples: list[Sample]) -> str:
    lines = ["| capture | MB sent | MB of points | MB, first and all | points s | preview s | refined s |"]
    lines.append("|---" * 7 + "|")
    for each in samples:
        sizes = f"{each.upload_bytes / 1e6:.1f} | {each.points_bytes / 1e6:.1f}"
        seen = f"{each.first_bytes / 1e6:.2f}, {each.all_bytes / 1e6:.1f}"
        lines.append(
            f"| {each.name} | {sizes} | {seen} | {each.points_s:.1f} | {each.preview_s:.1f} | {each.refine_s:.1f} |"
        )
    return "\n".join(lines)


def _table(
    outcomes: dict[tuple[int, Way], Outcome], samples: list[Sample], options: argparse.Namespace, prices: Prices
) -> str:
    heads = (
        "captures a day | way | places | workers, mean and most | busy | listed p95 | first look p50 | p95 | end p95 | "
        "cent an asset"
    )
    lines = [f"| {heads} |", "|---" * 10 + "|"]
    for (load, way), outcome in outcomes.items():
        places = _fleet(load, way, options).places if way != "centre" else 0
        paid = outcome.pool_s + outcome.box_s
        look = [at_share(outcome.first_look_s, outcome.arrived, share) for share in (0.5, 0.95)]
        end = at_share(outcome.end_s, outcome.arrived, 0.95)
        listed = at_share(outcome.listed_s, len(outcome.listed_s), 0.95)
        pool = f"{outcome.pool_s / 86_400:.1f}, {outcome.most_workers}" if way != "boxes" else ""
        lines.append(
            f"| {load:,} | {way} | {places or ''} | {pool} | {outcome.worked_s / paid:.0%} | {listed:.1f} | "
            f"{look[0]:.0f} | {look[1]:.0f} | {end:.0f} | {cost_cents(outcome, samples, prices):.2f} |"
        )
    return "\n".join(lines)


def _capacities(samples: list[Sample], options: argparse.Namespace) -> str:
    lines = ["| workers, fixed | centre | split, places enough |", "|---|---|---|"]
    for workers in POOLS:
        bears = []
        for way in ("centre", "split"):

            def make(load: float, way: Way = way, workers: int = workers) -> Fleet:
                places = math.ceil(load / options.per_place)
                return Fleet(way, load, places, Scaling(workers, workers))

            bears.append(capacity(samples, make, at_most=6_000.0 * workers))
        lines.append(f"| {workers} | {bears[0]:,.0f} | {bears[1]:,.0f} |")
    one = capacity(samples, lambda load: Fleet("boxes", load, 1, Scaling(1, 1)), at_most=6_000.0)
    return "\n".join([*lines, "", f"A place with one box bears {one:,.0f} captures a day."])


def _draw(outcomes: dict[tuple[int, Way], Outcome]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8.5, 4), layout="constrained")
    for way in WAYS:
        for share, line in ((0.5, ":"), (0.95, "-")):
            found = [outcomes[load, way] for load in LOADS]
            values = [at_share(each.first_look_s, each.arrived, share) for each in found]
            axes.plot(LOADS, values, line, marker="o", label=f"{way}, {share:.0%}", color=f"C{WAYS.index(way)}")
    axes.axhline(60.0, color="grey", linewidth=0.8)
    axes.set(xscale="log", xlabel="captures a day", ylabel="first look, s", ylim=(0, None))
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)


def _measure() -> Iterator[Sample]:
    with tempfile.TemporaryDirectory(prefix="fleet-") as scratch:
        photos = Path(scratch) / "shell"
        shell(photos, 25)
        sources = {"photos: rendered shell, 25": photos, **{name: data_file(path) for name, path in _LOCAL.items()}}
        for name, source in sources.items():
            with run_stack("127.0.0.1", 0, Path(scratch) / "data") as stack:
                yield _measure_one(stack.url, name, source)


def _measure_one(url: str, name: str, source: Path) -> Sample:
    with httpx.Client(base_url=url, timeout=600, trust_env=False) as client, StageBar() as bar:
        receipt = upload(client, source, bar)
        began = time.perf_counter()
        request = {"capture": receipt["capture"], "asset_key": "fleet"}
        job = client.post("/v1/jobs", json=request).raise_for_status().json()
        points = preview = end = 0.0
        for state in follow(client, job["id"]):
            now = time.perf_counter() - began
            if not points and state.get("stage") in ("FITTING", "EXTRACTING"):
                points = now
            if not preview and state.get("asset"):
                preview = now
            end, job = now, state
        assert job["state"] == "SUCCEEDED", job
        manifest = client.get(f"/v1/files/{job['asset']['manifest']}").raise_for_status().json()
    return _sample(name, receipt, manifest, (points, preview - points, end - preview))


def _sample(name: str, receipt: Any, manifest: Any, seconds: tuple[float, float, float]) -> Sample:
    files = {each["file"]: each["bytes"] for each in manifest["files"]}
    views = min(_VIEWS, int(manifest["capture"]["frames"]))
    points = _POINT_BYTES * manifest["points"] + _VIEW_BYTES * views
    first = min(size for file, size in files.items() if file.endswith(".glb"))
    return Sample(name, receipt["bytes"], points, first, sum(files.values()), *seconds)
