"""What Lighthouse says of the pages on its emulated phone: scores, and the times behind the one for speed.

The product runs as a user starts it, with the sheet of `visit.py` and its pictures. Lighthouse (npm, installed outside
the checkout) drives Debian's Chromium as its default phone: 412 x 823 pixels, 1.6 Mbit/s, 150 ms of latency, a quarter
of this processor's speed. Of three runs the one of the middle score counts. WebGL is drawn in software on the same
cores: the viewer's page is blocked for less where there is a graphics card.
"""

from __future__ import annotations

import json
import socket
import statistics
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from capture2vr.cli.up import run_stack
from capture2vr.edge.mesh.simplify import lods
from capture2vr.edge.render.thumbnail import thumbnail
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.bench.browser.visit import SIDES, painted, sheet_bundle
from tests.bench.delivery import scan
from tests.support.chromium import launch
from tests.support.npm_packages import installed

_AUDITS = Path(__file__).with_name("audits")
_RUNS = 3
_PAGES = {"capture": "/", "collection": "/browse/default", "viewer": "/view/sheet"}
_PATIENCE_S = 300  # of one page


def main(arguments: list[str]) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder, run_stack("127.0.0.1", 0, Path(folder)) as stack:
        publish(_sheet(), LocalStore(stack.store_root), key="sheet")
        print("| page | performance | accessibility | best practices | first s | largest s | blocked ms | shift | KB |")
        print("|---|---|---|---|---|---|---|---|---|")
        for page, path in _PAGES.items():
            print(f"| {page} | {' | '.join(_cells(_middle(stack.url + path)))} |", flush=True)


def _sheet() -> Bundle:
    pictured = [painted(level, side) for level, side in zip(lods(scan()), SIDES, strict=True)]
    bundle = sheet_bundle(pictured)
    return replace(bundle, files={**bundle.files, "thumbnail.webp": thumbnail(pictured[-1])})


def _middle(address: str) -> Mapping[str, Any]:
    """The run of the middle score for speed."""
    runs = _audit([address] * _RUNS)
    score = statistics.median_low([run["scores"]["performance"] for run in runs])
    return next(run for run in runs if run["scores"]["performance"] == score)


def _audit(addresses: Sequence[str]) -> list[dict[str, Any]]:
    """What Lighthouse finds, page by page, each as on a first visit."""
    folder = installed("audits", _AUDITS, ["audit.mjs"], what="Lighthouse")
    with sync_playwright() as playwright:
        port = _free_port()
        browser = launch(playwright, [f"--remote-debugging-port={port}"], composited=True)
        command = ["node", str(folder / "audit.mjs"), str(port), *addresses]
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S * len(addresses), check=True)
        browser.close()
    return [json.loads(line) for line in done.stdout.splitlines()]


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port: int = listening.getsockname()[1]
        return port


def _cells(run: Mapping[str, Any]) -> Iterator[str]:
    scores, metrics = run["scores"], run["metrics"]
    yield str(scores["performance"])
    yield f"{scores['accessibility']}{''.join(f', {fault}' for fault in run['inaccessible'])}"
    yield str(scores["best-practices"])
    yield f"{metrics['first-contentful-paint'] / 1000:.1f}"
    yield f"{metrics['largest-contentful-paint'] / 1000:.1f}"
    yield f"{metrics['total-blocking-time']:.0f}"
    yield f"{metrics['cumulative-layout-shift']:.3f}"
    yield f"{run['bytes'] / 1000:.0f}"
