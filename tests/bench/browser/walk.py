"""Minutes of walking through a scene in tiles, in an emulated headset: what the page keeps, and the first picture.

The scene is hills of 64 m in 1,365 tiles of 2,048 triangles, 2.1 million at the finest, each with 512² texels:
2 GB on the graphics card, were all of them kept. The wearer walks by thumbstick and turns now and then. Chromium draws
in software on the same cores: frames are slow, bytes are what they are.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import BrowserContext, CDPSession, Page, sync_playwright

from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.texture.bake import jpeg_of
from capture2vr.storage.catalogue.publish import publish
from tests.bench.browser.visit import LINK, photo_like
from tests.support.chromium import launch
from tests.support.headsets import Hand, enter, wear
from tests.support.npm_packages import installed
from tests.support.repository import ROOT
from tests.support.sites import site_at
from tests.support.tilesets import hill_bundle

_KEY = "hills"
_LEVELS, _SIZE_M, _CELLS = 6, 64.0, 32
_SAMPLE_S = 30.0
_STRIDE = 40  # frames with the stick forward, 6 m at most, before a turn by 30 degrees: a circle within the hills
_PATIENCE_MS = 300_000


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench walk", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long to walk")
    options = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory() as folder,
        site_at(Path(folder)) as site,
        sync_playwright() as playwright,
    ):
        publish(hill_bundle(_LEVELS, _SIZE_M, _CELLS, _with_picture(512))[0], site.store, key=_KEY)
        chromium = launch(playwright)
        context = chromium.new_context(viewport={"width": 640, "height": 400})
        emulator = installed("iwer", ROOT / "tests" / "web", what="the WebXR emulator")
        wear(context, emulator / "node_modules" / "iwer" / "build" / "iwer.min.js")
        _walk(context, f"{site.url}/view/{_KEY}", options.minutes)
        chromium.close()


def _with_picture(side: int) -> Callable[[Mesh], TexturedMesh]:
    """A function that gives a tile a picture, seen from above, that compresses as a photo does."""
    jpeg = jpeg_of(photo_like(side), 80)

    def dress(mesh: Mesh) -> TexturedMesh:
        corner, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
        uv = ((mesh.vertices - corner) / size)[:, [0, 2]].clip(0, 1)
        return TexturedMesh(replace(mesh, rgb=None), uv, jpeg, side)

    return dress


def _walk(context: BrowserContext, address: str, minutes: float) -> None:
    page = context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    devtools = context.new_cdp_session(page)
    devtools.send("Network.emulateNetworkConditions", LINK)
    page.goto(address)
    page.wait_for_function("() => document.body?.dataset.loaded")
    print(f"first picture {_first_picture_ms(page):.0f} ms after the catalogue, on 20 Mbit/s\n")
    page.wait_for_function("() => Number(document.body.dataset.tiles) > 0")
    devtools.send("Network.emulateNetworkConditions", {**LINK, "downloadThroughput": -1, "latency": 0})
    enter(page)
    print("| minutes | m walked | tiles drawn | triangles drawn | MB of tiles kept | MB of JavaScript's heap |")
    print("|---|---|---|---|---|---|", flush=True)
    left, right = Hand(page, "left"), Hand(page, "right")
    began = sampled = time.monotonic()
    _print(0.0, 0.0, page, devtools)
    walked, here = 0.0, _place(page)
    while time.monotonic() - began < 60 * minutes:
        left.stick(0, -1, _STRIDE)
        right.stick(1, 0, 2)
        before, here = here, _place(page)
        walked += float(np.hypot(*(here - before)[[0, 2]]))
        if time.monotonic() - sampled >= _SAMPLE_S:
            sampled = time.monotonic()
            _print((sampled - began) / 60, walked, page, devtools)


def _first_picture_ms(page: Page) -> float:
    entries: list[dict[str, Any]] = page.evaluate(
        "() => performance.getEntriesByType('resource').map(({ name, responseEnd }) => ({ name, responseEnd }))"
    )
    catalogue = next(entry["responseEnd"] for entry in entries if f"/v1/assets/{_KEY}" in entry["name"])
    return float(page.evaluate("() => performance.now()")) - float(catalogue)


def _place(page: Page) -> np.ndarray[Any, Any]:
    """(3,) where the scene is in the wearer's room, in metres."""
    return np.array(page.evaluate("document.body.dataset.placed").split(), dtype=float)


def _print(minutes: float, walked_m: float, page: Page, devtools: CDPSession) -> None:
    devtools.send("HeapProfiler.collectGarbage")
    heap = float(devtools.send("Runtime.getHeapUsage")["usedSize"]) / 1e6
    data = page.evaluate("({ ...document.body.dataset })")
    kept = int(data["bytes"]) / 1e6
    drawn = f"{data['tiles']} | {int(data['triangles']):,}"
    print(f"| {minutes:.1f} | {walked_m:.0f} | {drawn} | {kept:.1f} | {heap:.1f} |", flush=True)
