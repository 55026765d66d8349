"""What a visitor of the viewer waits for: headless Chromium on a throttled link, first, second and third visit.

The asset is the scan-like sheet of `delivery.py` in its levels of 100,000, 25,000 and 5,000 triangles, with colours at
its vertices or with the largest pictures that a target allows. Chromium draws in software on the same cores:
milliseconds are upper bounds, bytes and requests are what they are.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from playwright.sync_api import Browser, BrowserContext, sync_playwright

from capture2vr.cli.up import run_stack
from capture2vr.edge.arrays import Bytes
from capture2vr.edge.asset.target import measure_cost
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.simplify import lods
from capture2vr.edge.render.contact_sheet import render_sheet
from capture2vr.edge.texture.bake import jpeg_of
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.bench.delivery import scan
from tests.support.chromium import launch

_KEY = "sheet"
SIDES = (2048, 1024, 512)
"""Texels of the levels' pictures."""
LINK = {"offline": False, "latency": 20, "downloadThroughput": 20e6 / 8, "uploadThroughput": 5e6 / 8}
_LONG_MS = 50
_PATIENCE_MS = 120_000

# Levels as they come, and tasks that keep the page from answering a touch.
_WATCH = """
window.told = { levels: [], tasks: [] };
new PerformanceObserver((list) => {
    for (const task of list.getEntries()) window.told.tasks.push([task.startTime, task.duration]);
}).observe({ type: 'longtask', buffered: true });
document.addEventListener('DOMContentLoaded', () => new MutationObserver(() => {
    const loaded = document.body.dataset.loaded || '';
    if (loaded && !window.told.levels.some(([levels]) => levels === loaded))
        requestAnimationFrame(() => window.told.levels.push([loaded, performance.now()]));
}).observe(document.body, { attributes: true, attributeFilter: ['data-loaded'] }));
"""
_TOLD = """() => ({ ...window.told, entries: performance.getEntriesByType('resource').map(
    ({ name, responseEnd, transferSize }) => ({ name, responseEnd, transferSize })) })"""


def main(arguments: list[str]) -> None:
    """Print the table."""
    print(
        "| visit | requests | KB | of them assets | first mesh ms after the catalogue | finest ms | longest task ms |"
        " behind the catalogue ms |"
    )
    print("|---|---|---|---|---|---|---|---|")
    levels = lods(scan())
    with sync_playwright() as playwright:
        chromium = launch(playwright, composited=True)
        _visits("colours at vertices", sheet_bundle(levels), chromium)
        pictured = [painted(level, side) for level, side in zip(levels, SIDES, strict=True)]
        _visits("pictures", sheet_bundle(pictured), chromium)
        chromium.close()


def _visits(what: str, bundle: Bundle, chromium: Browser) -> None:
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    context.add_init_script(_WATCH)
    with tempfile.TemporaryDirectory() as folder:
        with run_stack("127.0.0.1", 0, Path(folder)) as stack:
            publish(bundle, LocalStore(stack.store_root), key=_KEY)
            for name in ("first, 20 Mbit/s", "second, 20 Mbit/s"):
                _print(f"{what}: {name}", _visit(context, f"{stack.url}/view/{_KEY}"))
        _print(f"{what}: third, server off", _visit(context, f"{stack.url}/view/{_KEY}"))
    context.close()


def painted(level: Mesh, side: int) -> TexturedMesh:
    """The sheet seen from above, with a picture that compresses as a photo does."""
    jpeg = jpeg_of(photo_like(side), 88)
    return TexturedMesh(replace(level, rgb=None), level.vertices[:, [0, 2]].clip(0, 1), jpeg, side)


def photo_like(side: int) -> Bytes:
    """A picture (side,side,3) that compresses as a photo does."""
    coarse = np.random.default_rng(0).integers(0, 256, (side // 8, side // 8, 3)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC), np.uint8)


def sheet_bundle(levels: Sequence[Mesh | TexturedMesh]) -> Bundle:
    """The sheet as the product would publish it, of these levels, finest first."""
    files = {f"lod{level}.glb": to_glb(each, "meshopt") for level, each in enumerate(levels)}
    costs = [asdict(measure_cost(glb)) for glb in files.values()]
    files["preview.png"] = render_sheet(levels[2])
    manifest: Mapping[str, Any] = {
        "label": "Sheet",
        "size_m": [1.0, 0.3, 1.0],
        "lods": [{"file": f"lod{level}.glb", "level": level, **cost} for level, cost in enumerate(costs)],
    }
    return Bundle("refined", files, manifest)


def _visit(context: BrowserContext, address: str) -> dict[str, Any]:
    """What the page tells of itself once the finest level is there and the service worker has seen all modules."""
    page = context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    context.new_cdp_session(page).send("Network.emulateNetworkConditions", LINK)
    page.goto(address)
    page.wait_for_function("() => window.told.levels.some(([levels]) => levels === '2 1 0')")
    told: dict[str, Any] = page.evaluate(_TOLD)
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.wait_for_timeout(2000)  # the worker goes on keeping what the page was made of
    page.close()
    return told


def _print(name: str, told: Mapping[str, Any]) -> None:
    assets = [entry for entry in told["entries"] if ".glb" in entry["name"]]
    catalogue = max(_catalogue(told["entries"]), default=0.0)
    levels = dict(told["levels"])
    first = min(levels.values())
    sizes = [sum(entry["transferSize"] for entry in entries) / 1e3 for entries in (told["entries"], assets)]
    sent = sum(entry["transferSize"] > 0 for entry in told["entries"])
    figures = f"{sizes[0]:.0f} | {sizes[1]:.0f} | {first - catalogue:.0f} | {levels['2 1 0'] - catalogue:.0f}"
    tasks = " | ".join(_longest(told["tasks"], since) for since in (0.0, catalogue))
    print(f"| {name} | {sent} | {figures} | {tasks} |", flush=True)


def _longest(tasks: list[list[float]], since: float) -> str:
    """Milliseconds of the longest task that began then or later; short ones are not told."""
    longest = max((duration for start, duration in tasks if start >= since), default=0.0)
    return f"{longest:.0f}" if longest else f"under {_LONG_MS}"


def _catalogue(entries: list[dict[str, Any]]) -> Iterator[float]:
    """When the asset's entry and the signed index had come."""
    for entry in entries:
        if f"/v1/assets/{_KEY}" in entry["name"]:
            yield entry["responseEnd"]
            return
