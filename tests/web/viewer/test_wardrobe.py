"""The wardrobe: garments of a season on a dress dummy, one after the other, on a phone, by keys and in a headset."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.bundle import State
from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.publish import publish
from tests.support.garments import DRESS, SKIRT, garment
from tests.support.headsets import Hand, enter, frames, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, places_of, stage
from tests.support.sites import Site, site_at
from tests.support.things import BLUE, GREEN, RED, box
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser

WITH_ONE = "7"
"""Geometries on the graphics card once one garment is worn, its shadow and the dummy's parts with it."""


def stock(site: Site, state: State = "refined") -> Site:
    """Three summer garments, of which a skirt is for autumn too, and a box that is none."""
    for key, bundle in {
        "blue": garment("Blue dress", BLUE, DRESS, state=state, labels=["Sommer", "evening"]),
        "green": garment("Green skirt", GREEN, SKIRT, state=state, labels=["summer", "Herbst"]),
        "red": garment("Red dress", RED, DRESS, state=state, labels=["summer", "linen", "long", "new", "party"]),
    }.items():
        publish(bundle, site.store, key=key)
    publish(box("Picnic box", RED, labels=["picnic"]), site.store, key="picnic")
    return site


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with site_at(tmp_path_factory.mktemp("shop")) as site:
        yield stock(site)


@pytest.fixture
def losing(tmp_path: Path) -> Iterator[Site]:
    """Another one, for a test that takes something from it: pages ask for newer versions of previews more often."""
    with site_at(tmp_path) as site:
        yield stock(site, "preview")


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small touch screen of somebody who wants less motion: pictures of it can be compared."""
    with without_a_past(browser, has_touch=True) as context:
        yield context


@pytest.fixture
def page(page: Page) -> Page:
    page.emulate_media(reduced_motion="reduce")
    return page


def share_of(page: Page, channel: int) -> float:
    """Of the picture, in this colour."""
    await_frames(page)
    return places_of(stage(page), channel)[0]


def test_garments_of_a_season_come_one_after_the_other_by_buttons_and_keys(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/wardrobe/default?season=summer")
    await_data(page, worn="blue")
    expect(page.locator("#label")).to_have_text("Blue dress")
    expect(page.locator("#wardrobe-count")).to_have_text("1 of 3")
    expect(page.locator("#view")).to_have_text("Blue dress, 1 of 3")  # what a screen reader says
    assert share_of(page, 2) > 0.01
    await_data(page, preloaded="green")
    page.get_by_role("button", name="Next garment").tap()
    await_data(page, worn="green")
    assert share_of(page, 1) > 0.01
    assert share_of(page, 2) == 0
    await_data(page, lod="0", geometries=WITH_ONE)
    for worn in ("red", "blue", "green"):
        page.keyboard.press("ArrowRight")
        await_data(page, worn=worn)
    await_data(page, lod="0", geometries=WITH_ONE)  # what is gone is freed
    page.keyboard.press("ArrowLeft")
    await_data(page, worn="blue")
    expect(page.get_by_role("link", name="This one alone")).to_have_attribute("href", "/view/blue")
    expect(page.get_by_role("button", name="Move")).to_be_hidden()


def test_another_choice_stands_in_the_address_and_keeps_what_is_worn(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/wardrobe/default?season=summer")
    await_data(page, worn="blue")
    page.keyboard.press("ArrowRight")
    await_data(page, worn="green")
    page.get_by_label("Which garments").select_option("Autumn")
    expect(page.locator("#wardrobe-count")).to_have_text("1 of 1")
    assert page.url.endswith("?season=autumn")
    assert page.get_attribute("body", "data-worn") == "green"
    page.get_by_label("Which garments").select_option("Winter")
    expect(page.locator("#said")).to_have_text(
        "No garment has a tag of this season: Winter. Choose another one, or all garments."
    )
    assert share_of(page, 1) == 0
    page.get_by_label("Which garments").select_option("evening")
    await_data(page, worn="blue")
    page.reload()
    await_data(page, worn="blue")
    expect(page.get_by_label("Which garments")).to_have_value("label:evening")
    page.get_by_label("Which garments").select_option("All garments")
    expect(page.locator("#wardrobe-count")).to_have_text("1 of 3")


def test_what_nobody_wears_stands_on_a_plinth_at_its_true_size(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/wardrobe/default?label=picnic")
    await_data(page, worn="picnic")
    _, height, _, scale = (page.get_attribute("body", "data-moved") or "").split()
    assert (float(height), float(scale)) == (0.7, 1.0)
    page.goto(f"{shop.url}/wardrobe/default?season=autumn")
    await_data(page, worn="green")
    assert (page.get_attribute("body", "data-moved") or "").endswith(" 1.000")


def test_without_a_choice_it_is_this_season_where_the_reader_lives(browser: Browser, shop: Site) -> None:
    with browser.new_context(
        timezone_id="Australia/Sydney", locale="de-DE", reduced_motion="reduce", service_workers="block"
    ) as context:
        page = context.new_page()
        page.clock.set_fixed_time(datetime(2026, 4, 15, 12))
        page.goto(f"{shop.url}/wardrobe/default")
        await_data(page, worn="green")
        expect(page.get_by_label("Welche Kleidungsstücke")).to_have_value("autumn")
        expect(page.locator("#wardrobe-count")).to_have_text("1 von 1")


def test_garments_change_by_themselves_until_somebody_stops_it(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/wardrobe/default?season=summer&every=2")
    await_data(page, worn="green")
    await_data(page, worn="red")
    rotate = page.get_by_role("button", name="Change by itself")
    expect(rotate).to_have_attribute("aria-pressed", "true")
    rotate.tap()
    expect(rotate).to_have_attribute("aria-pressed", "false")


def test_what_was_deleted_is_said_and_the_next_one_comes(page: Page, losing: Site) -> None:
    page.goto(f"{losing.url}/wardrobe/default?season=summer")
    await_data(page, worn="blue", preloaded="green")
    remove(losing.store, "green")
    page.keyboard.press("ArrowRight")
    await_data(page, worn="red")
    expect(page.locator("#notice")).to_contain_text("Green skirt: ")
    expect(page.locator("#wardrobe-count")).to_have_text("2 of 2")
    remove(losing.store, "red")  # while it is worn: a poll tells it
    await_data(page, worn="blue")
    expect(page.locator("#notice")).to_contain_text("Red dress: ")
    page.get_by_label("Which garments").select_option("All garments")
    expect(page.locator("#wardrobe-count")).to_have_text("1 of 1")


def test_a_file_that_is_broken_is_said_and_the_next_one_comes(page: Page, losing: Site) -> None:
    (level,) = [head.name for head in losing.store.list("assets/blue/") if head.name.endswith(".glb")]
    (losing.store.root / level).write_bytes(b"broken")
    page.goto(f"{losing.url}/wardrobe/default?season=summer")
    await_data(page, worn="green")
    expect(page.locator("#notice")).to_contain_text("Blue dress: ")


def test_without_a_connection_what_was_loaded_ahead_comes_and_then_stays(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/wardrobe/default?season=summer")
    await_data(page, worn="blue", preloaded="green")
    page.context.set_offline(True)
    page.keyboard.press("ArrowRight")
    await_data(page, worn="green")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#notice")).to_contain_text("Red dress: ")
    expect(page.locator("#label")).to_have_text("Green skirt")
    expect(page.locator("#wardrobe-count")).to_have_text("2 of 3")
    page.context.set_offline(False)
    page.keyboard.press("ArrowRight")
    await_data(page, worn="red")


def test_the_page_of_the_collection_leads_to_it(page: Page, shop: Site) -> None:
    page.goto(f"{shop.url}/browse/default")
    page.get_by_role("link", name="Wardrobe").click()
    page.wait_for_url("**/wardrobe/default*")
    expect(page.get_by_label("Which garments")).to_be_visible()


def press(page: Page, hand: Hand, name: str) -> None:
    """Press a part of the board, from 20 cm before it."""
    page.wait_for_function("name => JSON.parse(document.body.dataset.wall ?? '{}')[name]", arg=name)
    x, y, z = json.loads(page.get_attribute("body", "data-wall") or "{}")[name]
    hand.move(x, y, z + 0.2)
    hand.press()
    hand.release()


@pytest.fixture
def worn(browser: Browser, iwer: Path, shop: Site) -> Iterator[Page]:
    """The wardrobe, in a headset whose wearer wants less motion."""
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        wear(context, iwer)
        page = context.new_page()
        page.emulate_media(reduced_motion="reduce")
        page.goto(f"{shop.url}/wardrobe/default?season=summer")
        await_data(page, worn="blue")
        yield page


def test_a_wearer_chooses_the_season_and_the_garment(worn: Page) -> None:
    enter(worn)
    hand = Hand(worn, "right")
    press(worn, hand, "next")
    await_data(worn, worn="green")
    press(worn, hand, "all")
    worn.wait_for_function("() => location.search === '?season=all'")
    hand.move(0.4, 1.0, 0.4)
    hand.stick(1, 0, 10)
    await_data(worn, worn="red")  # the next one alone, however long the stick is held
    frames(worn)
    assert all(places_of(eye, 0)[0] > 0.005 for eye in halves(stage(worn)))
    hand.press("a-button")
    hand.release("a-button")
    worn.wait_for_function("() => document.body.dataset.wall === '{}'")


def test_a_wearer_chooses_a_label_of_many(worn: Page) -> None:
    enter(worn)
    hand = Hand(worn, "right")
    press(worn, hand, "label:long")
    await_data(worn, worn="red")
    worn.wait_for_function("() => location.search === '?label=long'")
    press(worn, hand, "other labels")
    frames(worn)
    press(worn, hand, "label:picnic")
    await_data(worn, worn="picnic")
    press(worn, hand, "other labels")
    press(worn, hand, "label:evening")  # the first ones again
    await_data(worn, worn="blue")


def test_bare_hands_press_the_board_and_pinch_the_garment(worn: Page) -> None:
    worn.evaluate("xrDevice.primaryInputMode = 'hand'")
    enter(worn)
    hand = Hand(worn, "right", bare=True)
    press(worn, hand, "previous")
    await_data(worn, worn="red")
    hand.move(0, 1.0, -0.6)  # at what the dummy wears
    hand.press()
    hand.release()
    await_data(worn, worn="blue")
