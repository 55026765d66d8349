"""The waterfall of a trace: what lies in what, the shares of the whole, and a picture with a line for each span."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from tests.bench.load.trace import depth, table, waterfall
from tests.support.workers.trace_collector import Span

SPANS = [
    Span("capture2vr-gateway", "receive capture", "t", "a", "root", 100.0, 101.0, failed=False),
    Span("capture2vr-gateway", "run job", "t", "b", "root", 102.0, 110.0, failed=False),
    Span("capture2vr-edge", "reconstruct", "t", "c", "root", 102.5, 109.5, failed=True),
    Span("capture2vr-edge", "FITTING", "t", "d", "c", 103.0, 108.0, failed=False),
    Span("capture2vr-edge", "PUBLISHING", "t", "e", "c", 108.0, 109.5, failed=False),
]


def test_stages_lie_in_their_run() -> None:
    assert [depth(span, SPANS) for span in SPANS] == [0, 0, 0, 1, 1]


def test_the_table_tells_when_and_how_long() -> None:
    rows = list(table(SPANS))
    assert rows[1] == "| receive capture | gateway | 0.00 | 1.00 | 10% |"
    assert rows[3] == "| reconstruct (failed) | worker | 2.50 | 7.00 | 70% |"
    assert rows[4] == "| · FITTING | worker | 3.00 | 5.00 | 50% |"
    assert rows[-1].endswith("| 0.00 | 10.00 | 100% |")


def test_the_picture_has_a_bar_of_each_kind(tmp_path: Path) -> None:
    waterfall(SPANS, "a capture", tmp_path / "trace.png")
    with Image.open(tmp_path / "trace.png") as picture:
        counts = {colour: count for count, colour in picture.convert("RGB").getcolors(1 << 24) or []}
    gateway, worker, stage = (counts.get(each, 0) for each in ((68, 119, 170), (238, 136, 102), (246, 195, 163)))
    assert min(gateway, worker, stage) > 1_000
    assert gateway > worker > stage, "as long as their spans are"
