"""The viewer's own controls: keys, the turntable, the full screen, the poster, what a screen reader hears."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, difference, stage
from tests.support.sites import Site
from tests.support.things import GREEN, RED, box, picture_of

pytestmark = pytest.mark.browser
KEY = "turned"


@pytest.fixture
def viewer(page: Page, site: Site) -> Page:
    """The page of a red box."""
    publish(box("Red box", RED, size=(0.6, 0.3, 0.3)), site.store, key=KEY)
    page.goto(f"{site.url}/view/{KEY}")
    await_data(page, loaded="2 1 0", geometries="4")  # with its shadow
    return page


def picture(page: Page) -> bytes:
    await_frames(page)
    return stage(page)


@pytest.mark.essential
def test_keys_turn_it_bring_it_closer_and_show_all_of_it(viewer: Page) -> None:
    stage_, said = viewer.locator("#stage"), viewer.locator("#view")
    stage_.press("Home")  # with the ring around what has the focus, as all pictures below
    first = picture(viewer)
    stage_.press("ArrowRight")
    stage_.press("ArrowRight")
    expect(said).to_have_text("Seen from the front right.")
    for _ in range(3):
        stage_.press("ArrowUp")
    expect(said).to_have_text("Seen from the front right, from above.")
    turned = picture(viewer)
    assert difference(first, turned) > 0.02
    stage_.press("+")
    stage_.press("+")
    assert difference(turned, picture(viewer)) > 0.02
    stage_.press("Home")
    assert difference(first, picture(viewer)) < 0.01


def test_a_screen_reader_hears_what_is_shown(viewer: Page) -> None:
    canvas = viewer.locator("#stage")
    expect(canvas).to_have_role("application")
    expect(canvas).to_have_accessible_name(re.compile(r"Red box: 60 cm × 30 cm × 30 cm"))
    expect(canvas).to_have_accessible_description(re.compile("Arrow keys turn it"))


def test_every_control_is_reached_by_tab_and_shows_the_focus(viewer: Page) -> None:
    reached: list[str] = []
    for _ in range(30):
        viewer.keyboard.press("Tab")
        outline = "getComputedStyle(document.activeElement).outlineStyle"
        focused = viewer.evaluate(
            f"[document.activeElement.id || document.activeElement.textContent.trim(), {outline}]"
        )
        assert focused[0] == "" or focused[1] != "none" or viewer.evaluate("document.activeElement === document.body")
        reached.append(focused[0])
    assert {"stage", "Name it", "Download", "About", "move", "reset", "turn", "backdrop"} <= set(reached)


def test_the_turntable_turns_until_it_is_touched(viewer: Page) -> None:
    button = viewer.get_by_role("button", name="Turn", exact=True)
    first = picture(viewer)
    assert difference(first, picture(viewer)) == 0, "it rests until it is asked to"
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    viewer.wait_for_function("() => new Promise((done) => setTimeout(() => done(true), 0))")
    while difference(first, picture(viewer)) < 0.01:
        pass
    viewer.mouse.click(160, 240)
    expect(button).to_have_attribute("aria-pressed", "false")


def test_who_wants_less_motion_gets_steps(viewer: Page) -> None:
    viewer.emulate_media(reduced_motion="reduce")
    button = viewer.get_by_role("button", name="Turn", exact=True)
    first = picture(viewer)
    button.click()
    expect(button).to_have_attribute("aria-pressed", "false")
    turned = picture(viewer)
    assert difference(first, turned) > 0.02
    assert difference(turned, picture(viewer)) == 0
    for _ in range(7):
        button.click()
    assert difference(first, picture(viewer)) < 0.01, "eight steps are a whole turn"


def test_full_screen_and_back(viewer: Page) -> None:
    button = viewer.get_by_role("button", name="Full screen")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    assert viewer.evaluate("document.fullscreenElement === document.documentElement")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "false")


def test_the_poster_stands_for_the_thing_until_its_mesh_is_there(page: Page, site: Site) -> None:
    files = {"thumbnail.webp": picture_of(GREEN)}
    publish(box("Green box", GREEN, files=files), site.store, key="postered")
    page.clock.install()
    page.route("**/lod*", lambda route: route.abort())
    page.goto(f"{site.url}/view/postered")
    poster = page.locator("#poster")
    expect(poster).to_be_visible()
    assert poster.evaluate("image => image.decode().then(() => image.naturalWidth)") == 32
    page.unroute("**/lod*")
    page.clock.fast_forward(10_000)
    await_data(page, loaded="2 1 0")
    expect(poster).to_be_hidden()
