"""The viewer, on a screen and in an emulated headset."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, Page, Route, expect

from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, drawn, expect_picture, stage
from tests.support.sites import Site

pytestmark = pytest.mark.browser
KEY = "bowl"
LONGER_MS = 10_000
"""Longer than pages wait before they ask again for what did not come, or may have changed."""


@pytest.fixture(scope="module")
def store(site: Site) -> LocalStore:
    """The store that the running gateway serves."""
    return site.store


@pytest.fixture(autouse=True)
def published(store: LocalStore, bundle: Bundle) -> None:
    """At least one version of the bowl stands in the catalogue."""
    publish(bundle, store, key=KEY, job="first")


def test_each_module_of_the_page_is_asked_for_once(page: Page, site: Site) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if request.url.endswith(".js") else None)
    page.goto(f"{site.url}/view/{KEY}")
    await_data(page, loaded="2 1 0")
    own = [address for address in asked if "service-worker" not in address]
    assert f"{site.url}/web/vendor/three-0.187.0.core.js" in own
    assert len(own) == len(set(own))


@pytest.mark.essential
def test_all_levels_come_and_distance_chooses_among_them(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view/{KEY}")
    await_data(page, loaded="2 1 0")
    await_data(page, lod="0")
    assert drawn(stage(page)) > 0.05
    page.mouse.move(160, 240)
    page.mouse.wheel(0, 24_000)
    await_data(page, lod="2")


def test_points_stand_for_the_thing_until_its_mesh_is_there(page: Page, site: Site) -> None:
    page.clock.install()
    page.route("**/lod*", lambda route: route.abort())
    page.goto(f"{site.url}/view/{KEY}")
    await_data(page, hints="512")
    await_frames(page)
    assert drawn(stage(page)) > 0.01
    page.unroute("**/lod*")
    page.clock.fast_forward(LONGER_MS)
    await_data(page, loaded="2 1 0")
    assert drawn(stage(page)) > 0.05


@pytest.mark.parametrize(
    ("origin", "said"),
    [("guess", "A guess from one photo"), ("generated", "Generated from one photo, not measured")],
)
def test_what_was_not_measured_says_so(
    page: Page, site: Site, store: LocalStore, bundle: Bundle, origin: str, said: str
) -> None:
    publish(replace(bundle, manifest={**bundle.manifest, "origin": origin}), store, key=origin, job=origin)
    page.goto(f"{site.url}/view/{origin}")
    expect(page.locator("#said")).to_contain_text(said)
    page.goto(f"{site.url}/view/{KEY}")
    expect(page.locator("#said")).to_contain_text("triangles")
    expect(page.locator("#said")).not_to_contain_text("one photo")


def test_a_level_that_was_lost_on_the_way_is_fetched_again(page: Page, site: Site) -> None:
    lost: list[str] = []

    def lose_once(route: Route) -> None:
        if lost:
            return route.continue_()
        lost.append(route.request.url)
        return route.abort()

    page.clock.install()
    page.route("**/lod1.*", lose_once)
    with page.expect_event("requestfailed"):
        page.goto(f"{site.url}/view/{KEY}")
    page.clock.fast_forward(LONGER_MS)
    await_data(page, loaded="2 1 0")
    await_data(page, state="preview")
    assert lost


def test_the_person_reads_name_size_and_state(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view/{KEY}")
    expect(page.locator("#label")).to_have_text("Bowl")
    expect(page.locator("#said")).to_contain_text("51 cm")  # half a metre, on a coarse grid
    expect(page.locator("#said")).to_contain_text("triangles")


@pytest.mark.essential
def test_an_unknown_key_is_said_not_shown(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view/nothing-here")
    await_data(page, state="error")
    expect(page.locator("#said")).to_contain_text("nothing-here")
    assert drawn(stage(page)) == 0


def test_a_refined_version_replaces_the_preview_while_it_is_shown(
    page: Page, site: Site, store: LocalStore, bundle: Bundle
) -> None:
    page.clock.install()
    publish(bundle, store, key="growing", job="a")
    page.goto(f"{site.url}/view/growing")
    await_data(page, state="preview", loaded="2 1 0")
    publish(Bundle(state="refined", files=bundle.files, manifest=bundle.manifest), store, key="growing", job="a")
    page.clock.fast_forward(LONGER_MS)
    await_data(page, state="refined")
    await_data(page, version="2")
    assert drawn(stage(page)) > 0.05


@pytest.fixture
def headset(context: BrowserContext, iwer: Path, page: Page) -> Page:
    """The page in an emulated Quest 3 whose wearer stands at the origin, eyes at 1.6 m."""
    context.add_init_script(path=iwer)
    context.add_init_script(
        """
        const device = new IWER.XRDevice(IWER.metaQuest3);
        device.installRuntime({ forceInstall: true });
        device.position.set(0, 1.6, 0);
        device.stereoEnabled = true;
        window.xrDevice = device;
        """
    )
    return page


@pytest.mark.essential
def test_in_vr_it_stands_ahead_at_true_size(headset: Page, site: Site) -> None:
    headset.goto(f"{site.url}/view/{KEY}")
    await_data(headset, loaded="2 1 0")
    headset.get_by_role("button", name="Enter VR").click()
    await_data(headset, xr="on")
    expect(headset.locator("body")).to_have_attribute("data-placed", re.compile(r".+"))
    x, y, z = map(float, headset.locator("body").get_attribute("data-placed").split())
    assert (x**2 + z**2) ** 0.5 == pytest.approx(1.5, abs=0.02)
    assert y == pytest.approx(1.6 * 0.75 - 0.25, abs=0.02), "a half-metre bowl is lifted to a comfortable height"
    await_frames(headset)
    assert drawn(stage(headset)) > 0.02
    headset.evaluate("xrDevice.activeSession.end()")
    await_data(headset, xr="off")
    await_frames(headset)
    assert drawn(stage(headset)) > 0.05, "back on the screen it fills the view again"


def test_without_a_headset_the_page_says_how_to_get_there(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view/{KEY}")
    expect(page.get_by_role("button", name="Enter VR")).to_be_hidden()
    page.get_by_text("Open in a headset").click()
    expect(page.locator("#address")).to_have_text(f"{site.url}/view/{KEY}")
    expect_picture(page, "#qr")
