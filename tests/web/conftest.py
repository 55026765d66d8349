"""The whole product on free ports, and a headless Chromium to look at it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, ViewportSize, expect, sync_playwright

from capture2vr.cli.up import Stack, run_stack
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant
from tests.conftest import missing
from tests.support.chromium import chromium, launch
from tests.support.npm_packages import installed
from tests.support.page_scripts import PageScripts
from tests.support.page_scripts import running as running_scripts
from tests.support.photos.small_pictures import draw_small
from tests.support.repository import ROOT
from tests.support.sites import Site, site_at
from tests.support.tenants import make_key

PATIENCE_MS = 180_000  # a whole reconstruction fits, on a busy two-core machine
expect.set_options(timeout=PATIENCE_MS)

BRIEF = """
summary = "a training of seconds"
resolution = 32

[fit]
warm_start = 10
steps = 60
batch = 100
pool = 5_000
"""

QUICK = """
summary = "no training, and a coarse mesh"
resolution = 32
"""

# Python, but for the worker: that one draws small pictures, which otherwise are two thirds of a small job's seconds.
PYTHON = f"""#!/bin/sh
cd {ROOT}
[ "$3" = edge ] && set -- -m tests.support.workers.hasty_worker edge
exec {sys.executable} "$@"
"""

PHONE = {"width": 390, "height": 844}
SMALL = {"width": 320, "height": 480}
"""The smallest phone: a page is drawn in software, and every pixel costs."""


@pytest.fixture(scope="package")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Gateway, worker and embedded store, with a preset whose training takes seconds, and one without any."""
    presets = tmp_path_factory.mktemp("presets")
    (presets / "brief.toml").write_text(BRIEF)
    (presets / "quick.toml").write_text(QUICK)
    python = presets / "python"
    python.write_text(PYTHON)
    python.chmod(0o755)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("EDGE_PRESETS", str(presets))
        environment.setenv("OMP_NUM_THREADS", "1")  # Chromium draws on the other core; torch's threads would spin
        environment.setattr(sys, "executable", str(python))
        with run_stack("127.0.0.1", 0, tmp_path_factory.mktemp("stack")) as stack:
            environment.undo()  # the services have it
            yield stack


@pytest.fixture(scope="package")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A gateway whose worker only inspects, for tests that publish what they look at."""
    with site_at(tmp_path_factory.mktemp("site")) as site:
        yield site


@dataclass(frozen=True, slots=True)
class GuardedSite:
    """A gateway that asks for keys, and a key of the tenant ada that may do everything within it."""

    site: Site
    key: str
    data_dir: Path

    @property
    def url(self) -> str:
        return self.site.url

    @property
    def store(self) -> Store:
        """The objects of the tenant."""
        return store_of_tenant(self.site.store, "ada")

    def log_in(self, context: BrowserContext) -> None:
        """Give a browser the session cookie that the login page would get."""
        answer = context.request.post(f"{self.url}/v1/session", data={"key": self.key})
        assert answer.ok, answer.text()


@pytest.fixture(scope="package")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedSite]:
    """A gateway without a worker that asks for keys."""
    folder = tmp_path_factory.mktemp("guarded")
    key = make_key(folder / "data", "ada", ALL_SCOPES - {Scope.OPERATE})
    with site_at(folder) as site:
        yield GuardedSite(site, key, folder / "data")


@pytest.fixture(scope="session")
def bundle() -> Bundle:
    """A bowl of one metre, made by the product."""
    direction = np.random.default_rng(0).normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = -np.abs(direction[:, 1])
    rgb = ((direction * 0.5 + 0.5) * 255).astype(np.uint8)
    capture = Capture("points", "ply", Cloud(direction * 0.5, rgb), scale_confidence="metric")
    with pytest.MonkeyPatch.context() as patch:
        draw_small(patch)
        steps = reconstruct(capture, replace(load_preset("draft"), resolution=32), JobOptions(names=AssetNames("Bowl")))
        return next(step for step in steps if isinstance(step, Bundle))


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, until this folder's last test: beside Playwright's loop no asynchronous test runs."""
    if chromium() is None:
        missing("Chromium")
    with sync_playwright() as playwright:
        browser = launch(playwright)
        yield browser
        browser.close()


@pytest.fixture(scope="package")
def scripts() -> Iterator[PageScripts]:
    """Where modules of the pages run that need no page."""
    with running_scripts() as scripts:
        yield scripts


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small touch screen of a browser without a past."""
    with without_a_past(browser, has_touch=True) as context:
        yield context


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


@contextmanager
def without_a_past(
    browser: Browser, size: ViewportSize = SMALL, *, has_touch: bool = False, locale: str = "en-GB"
) -> Iterator[BrowserContext]:
    """A window of a browser that keeps nothing. Without service workers, whose requests no test could intercept."""
    with browser.new_context(
        viewport=size, has_touch=has_touch, locale=locale, device_scale_factor=1, service_workers="block"
    ) as context:
        context.set_default_timeout(PATIENCE_MS)
        yield context


@contextmanager
def with_a_past(browser: Browser) -> Iterator[BrowserContext]:
    """A small window of a browser that keeps what pages keep, from visit to visit."""
    with browser.new_context(viewport=SMALL, device_scale_factor=1) as context:
        context.set_default_timeout(PATIENCE_MS)
        yield context
