"""Where the seconds of one job go: its trace, as gateway and worker send it to a collector, drawn as a waterfall.

`python -m tests.bench trace`: a gateway and a worker as processes of their own, one real capture (RGB-D of a living
room, or `--capture NAME` of the test data), and the spans that both send by OTLP. No Jaeger is needed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import httpx

from capture2vr.cli.progress import StageBar
from capture2vr.cli.remote.push import follow, upload
from capture2vr.cli.up import free_port
from capture2vr.process.traces import trace_id
from tests.bench.data_files import PICTURES, data_file
from tests.support.gateway_process import running
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.workers.trace_collector import Span, TraceCollector, collecting

PICTURE = PICTURES / "trace.png"
_PATIENCE_S = 600.0  # of the whole job; draft takes 20 s on idle cores
_COLOURS = {"gateway": "#4477aa", "worker": "#ee8866", "stage of the run": "#f6c3a3"}
_BLANK = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}  # behind figures that a line crosses
_PROCESSES = {"capture2vr-gateway": "gateway", "capture2vr-edge": "worker"}


def main(arguments: list[str]) -> None:
    """Print the table of the spans, and draw them."""
    options = _parser().parse_args(arguments)
    source = data_file(options.capture)
    with tempfile.TemporaryDirectory(prefix="bench-trace-") as scratch, collecting() as collector:
        capture, state = _reconstruct(source, options.preset, Path(scratch), collector)
        spans = collector.of_capture(capture)
    print(f"Capture `{options.capture}`, preset `{options.preset}`, {state}; trace id `{trace_id(capture)}`.\n")
    print("\n".join(table(spans)))
    waterfall(spans, f"{options.capture}, preset {options.preset}", options.picture)


def table(spans: Sequence[Span]) -> Iterator[str]:
    """The spans as a table in Markdown, indented by what lies in what; `spans` are in the order of their starts."""
    began, whole = spans[0].start_s, max(span.end_s for span in spans) - spans[0].start_s
    yield "| span | of | from, s | seconds | share |\n|---|---|---|---|---|"
    for span in spans:
        name = f"{'· ' * depth(span, spans)}{span.name}{' (failed)' if span.failed else ''}"
        share = f"{span.seconds / whole:.0%}"
        yield f"| {name} | {_PROCESSES[span.service]} | {span.start_s - began:.2f} | {span.seconds:.2f} | {share} |"
    yield f"| from the upload's first byte to the end of the job | | 0.00 | {whole:.2f} | 100% |"


def depth(span: Span, spans: Sequence[Span]) -> int:
    """How many other spans a span lies in. A capture's own root, in which all lie, is no span."""
    around = next((each for each in spans if each.id == span.parent), None)
    return 0 if around is None else 1 + depth(around, spans)


def waterfall(spans: Sequence[Span], title: str, path: Path) -> None:
    """Draw a line for each span, from its start to its end, in the order of their starts."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    began, whole = spans[0].start_s, max(span.end_s for span in spans) - spans[0].start_s
    figure, axes = plt.subplots(figsize=(10.5, 1.3 + 0.33 * len(spans)), layout="constrained")
    for y, span in enumerate(spans):
        start = span.start_s - began
        colour = _COLOURS["stage of the run" if depth(span, spans) else _PROCESSES[span.service]]
        width = max(span.seconds, 0.002 * whole)  # so that a short one is seen
        axes.barh(y, width, left=start, height=0.72, color=colour, edgecolor="#444444", linewidth=0.5)
        axes.text(start + width + 0.006 * whole, y, f"{span.seconds:.2f} s", va="center", fontsize=9, bbox=_BLANK)
        if span.name == "PUBLISHING":
            axes.axvline(span.end_s - began, color="#228833", linewidth=1.0, linestyle="--", zorder=0)
            axes.text(span.end_s - began, -0.75, "published ", color="#228833", fontsize=9, ha="right", va="center")
    axes.set_yticks(range(len(spans)), [span.name for span in spans], fontsize=9)
    axes.set_ylim(len(spans) - 0.4, -1.2)
    axes.legend([plt.Rectangle((0, 0), 1, 1, color=each) for each in _COLOURS.values()], _COLOURS, loc="lower left")
    axes.set_xlim(0, 1.1 * whole)  # with room for the last figures
    axes.set_xlabel("seconds since the upload's first byte")
    axes.set_title(f"One trace: {title}", fontsize=11, loc="left")
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _reconstruct(source: Path, preset: str, folder: Path, collector: TraceCollector) -> tuple[str, str]:
    """Upload a capture and have it reconstructed; the capture's id, and how its job ended."""
    port = free_port()
    edge = ServiceProcess(
        "capture2vr.edge",
        folder / "edge.log",
        EDGE_PORT=port,
        EDGE_SCRATCH=folder / "scratch",
        STORAGE_ROOT=folder / "objects",
        **collector.variables,
    )
    with (
        killed_at_the_end(edge),
        running(folder, workers=f"127.0.0.1:{port}", **collector.variables) as gateway,
        httpx.Client(base_url=gateway.url, timeout=_PATIENCE_S, trust_env=False) as client,
        StageBar() as bar,
    ):
        _wait(
            lambda: bool(client.get("/readyz").is_success)
        )  # with a worker: otherwise its start would be in the picture
        capture = str(upload(client, source, bar)["capture"])
        body = {"capture": capture, "asset_key": "bench", "preset": preset}
        job = client.post("/v1/jobs", json=body).raise_for_status().json()
        for state in follow(client, job["id"]):
            job = state
        # Sent when they end, which for the run and its supervision is just now.
        _wait(lambda: {"run job", "reconstruct"} <= {span.name for span in collector.of_capture(capture)})
    return capture, str(job["state"])


def _wait(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while not holds():
        if time.monotonic() > deadline:
            raise SystemExit(f"not within {_PATIENCE_S:g} s")
        time.sleep(0.05)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench trace", description=__doc__)
    parser.add_argument("--capture", default="rgbd_livingroom", help="file or folder of the test data")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--picture", type=Path, default=PICTURE)
    return parser
