"""The whole product on free ports, and a headless Chromium to look at it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from services.cli.up import Stack, run_stack
from services.edge.capture.nouns import Capture, Cloud
from services.edge.pipeline import reconstruct
from services.edge.preset import load_preset
from services.storage.bundle import Bundle
from tests.conftest import missing
from tests.support.npm_packages import installed
from tests.support.sites import Site, site_at
from tests.support.small_pictures import draw_small

# Software rendering, and none of the connections that a browser opens for itself.
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--use-gl=angle",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--no-first-run",
    "--mute-audio",
]
PATIENCE_MS = 60_000  # a whole reconstruction fits, on a busy two-core machine
expect.set_options(timeout=PATIENCE_MS)

BRIEF = """
summary = "a training of seconds"
resolution = 48

[fit]
warm_start = 30
steps = 150
batch = 200
pool = 20_000
"""

QUICK = """
summary = "no training, and a coarse mesh"
resolution = 48
"""

PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="package")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Gateway, worker and embedded store, with a preset whose training takes seconds, and one without any."""
    presets = tmp_path_factory.mktemp("presets")
    (presets / "brief.toml").write_text(BRIEF)
    (presets / "quick.toml").write_text(QUICK)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("EDGE_PRESETS", str(presets))
        environment.setenv("OMP_NUM_THREADS", "1")  # Chromium draws on the other core; torch's threads would spin
        with run_stack("127.0.0.1", 0, tmp_path_factory.mktemp("stack")) as stack:
            yield stack


@pytest.fixture(scope="package")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A gateway without a worker, for tests that publish what they look at."""
    with site_at(tmp_path_factory.mktemp("site")) as site:
        yield site


@pytest.fixture(scope="session")
def bundle() -> Bundle:
    """A bowl of one metre, made by the product."""
    direction = np.random.default_rng(0).normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = -np.abs(direction[:, 1])
    rgb = ((direction * 0.5 + 0.5) * 255).astype(np.uint8)
    capture = Capture("points", "ply", Cloud(direction * 0.5, rgb), scale_confidence="metric")
    with pytest.MonkeyPatch.context() as patch:
        draw_small(patch)
        steps = reconstruct(capture, load_preset("draft"), label="Bowl")
        return next(step for step in steps if isinstance(step, Bundle))


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, until this folder's last test: beside Playwright's loop no asynchronous test runs."""
    chromium = shutil.which("chromium")
    if chromium is None:
        missing("Chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser without a past, as wide as a phone. Without service workers, whose requests no test could intercept."""
    context = browser.new_context(viewport=PHONE, has_touch=True, device_scale_factor=1, service_workers="block")
    yield context
    context.close()


@pytest.fixture
def page(context: BrowserContext) -> Iterator[Page]:
    """A page whose scripts must not fail: an uncaught error fails the test."""
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.set_default_timeout(PATIENCE_MS)
    yield page
    assert errors == []


@pytest.fixture(scope="session")
def iwer() -> Path:
    """Meta's WebXR emulator, as one script."""
    folder = installed("iwer", Path(__file__).parent, what="the WebXR emulator")
    return folder / "node_modules" / "iwer" / "build" / "iwer.min.js"


def without_a_past(browser: Browser, width: int, height: int) -> Iterator[BrowserContext]:
    """A window of that size in a browser that keeps nothing, without service workers."""
    size = {"width": width, "height": height}
    context = browser.new_context(viewport=size, device_scale_factor=1, service_workers="block")
    context.set_default_timeout(PATIENCE_MS)
    yield context
    context.close()
