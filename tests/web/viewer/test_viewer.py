"""The viewer, on a screen and in an emulated headset."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, Page, Route, expect

from services.cli.up import Stack
from services.storage.bundle import Bundle
from services.storage.catalogue.publish import publish
from services.storage.local import LocalStore
from tests.support.screenshots import await_frames, drawn, expect_picture, stage

pytestmark = pytest.mark.browser
KEY = "bowl"


@pytest.fixture(scope="module")
def store(stack: Stack) -> LocalStore:
    """The store that the running gateway serves."""
    return LocalStore(stack.store_root)


@pytest.fixture(autouse=True)
def published(store: LocalStore, bundle: Bundle) -> None:
    """At least one version of the bowl stands in the catalogue."""
    publish(bundle, store, key=KEY, job="first")


def test_all_levels_come_and_distance_chooses_among_them(page: Page, stack: Stack) -> None:
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    expect(page.locator("body")).to_have_attribute("data-lod", "0")
    assert drawn(stage(page)) > 0.05
    page.mouse.move(195, 400)
    for _ in range(60):
        page.mouse.wheel(0, 400)
    expect(page.locator("body")).to_have_attribute("data-lod", "2")


def test_points_stand_for_the_thing_until_its_mesh_is_there(page: Page, stack: Stack) -> None:
    page.route("**/lod*", lambda route: route.abort())
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.locator("body")).to_have_attribute("data-hints", "512")
    await_frames(page)
    assert drawn(stage(page)) > 0.01
    page.unroute("**/lod*")
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    assert drawn(stage(page)) > 0.05


def test_a_guess_is_called_one(page: Page, stack: Stack, store: LocalStore, bundle: Bundle) -> None:
    publish(replace(bundle, manifest={**bundle.manifest, "origin": "guess"}), store, key="guessed", job="one")
    page.goto(f"{stack.url}/view/guessed")
    expect(page.locator("#said")).to_contain_text("A guess from one photo")
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.locator("#said")).to_contain_text("triangles")
    expect(page.locator("#said")).not_to_contain_text("guess")


def test_a_level_that_was_lost_on_the_way_is_fetched_again(page: Page, stack: Stack) -> None:
    lost: list[str] = []

    def lose_once(route: Route) -> None:
        if lost:
            return route.continue_()
        lost.append(route.request.url)
        return route.abort()

    page.route("**/lod1.*", lose_once)
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    expect(page.locator("body")).to_have_attribute("data-state", "preview")
    assert lost


def test_the_person_reads_name_size_and_state(page: Page, stack: Stack) -> None:
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.locator("#label")).to_have_text("Bowl")
    expect(page.locator("#said")).to_contain_text("50 cm")
    expect(page.locator("#said")).to_contain_text("triangles")


def test_an_unknown_key_is_said_not_shown(page: Page, stack: Stack) -> None:
    page.goto(f"{stack.url}/view/nothing-here")
    expect(page.locator("body")).to_have_attribute("data-state", "error")
    expect(page.locator("#said")).to_contain_text("nothing-here")
    assert drawn(stage(page)) == 0


def test_a_refined_version_replaces_the_preview_while_it_is_shown(
    page: Page, stack: Stack, store: LocalStore, bundle: Bundle
) -> None:
    publish(bundle, store, key="growing", job="a")
    page.goto(f"{stack.url}/view/growing")
    expect(page.locator("body")).to_have_attribute("data-state", "preview")
    publish(Bundle(state="refined", files=bundle.files, manifest=bundle.manifest), store, key="growing", job="a")
    expect(page.locator("body")).to_have_attribute("data-state", "refined")
    expect(page.locator("body")).to_have_attribute("data-version", "2")
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


def test_in_vr_it_stands_ahead_at_true_size(headset: Page, stack: Stack) -> None:
    headset.goto(f"{stack.url}/view/{KEY}")
    expect(headset.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    headset.get_by_role("button", name="Enter VR").click()
    expect(headset.locator("body")).to_have_attribute("data-xr", "on")
    expect(headset.locator("body")).to_have_attribute("data-placed", re.compile(r".+"))
    x, y, z = map(float, headset.locator("body").get_attribute("data-placed").split())
    assert (x**2 + z**2) ** 0.5 == pytest.approx(1.5, abs=0.02)
    assert y == pytest.approx(1.6 * 0.75 - 0.25, abs=0.02), "a half-metre bowl is lifted to a comfortable height"
    await_frames(headset)
    assert drawn(stage(headset)) > 0.02
    headset.evaluate("xrDevice.activeSession.end()")
    expect(headset.locator("body")).to_have_attribute("data-xr", "off")
    await_frames(headset)
    assert drawn(stage(headset)) > 0.05, "back on the screen it fills the view again"


def test_without_a_headset_the_page_says_how_to_get_there(page: Page, stack: Stack) -> None:
    page.goto(f"{stack.url}/view/{KEY}")
    expect(page.get_by_role("button", name="Enter VR")).to_be_hidden()
    page.get_by_text("Open in a headset").click()
    expect(page.locator("#address")).to_have_text(f"{stack.url}/view/{KEY}")
    expect_picture(page, "#qr")
