"""Several things in one scene: side by side, each for itself, within a budget, and gone without a trace."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import Hand, enter, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, places_of, stage
from tests.support.sites import Site
from tests.support.things import BLUE, GREEN, RED, box, bundle_of, picture_of, textured_glb
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module", autouse=True)
def published(site: Site) -> None:
    """A red and a blue box."""
    publish(box("Red box", RED), site.store, key="red")
    publish(box("Blue box", BLUE, size=(0.6, 0.3, 0.3)), site.store, key="blue")


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small wide window."""
    with without_a_past(browser, {"width": 480, "height": 240}) as context:
        yield context


def both(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view?key=red&key=blue&key=red")
    await_data(page, loaded="2 1 0; 2 1 0")
    await_frames(page)


def test_two_stand_side_by_side_and_each_is_taken_for_itself(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    wear(context, iwer)
    both(page, site)
    expect_side_by_side(stage(page), slanting=0.05)
    expect(page.locator("#label")).to_have_text("2 objects")
    enter(page)
    for eye in halves(stage(page)):
        expect_side_by_side(eye)
    red, blue = page.get_attribute("body", "data-moved").split("; ")
    hand = Hand(page, "right")
    hand.move(float(blue.split()[0]), 1.2, -0.5)
    hand.press()
    hand.move(float(blue.split()[0]), 1.7, -0.5)
    hand.release()
    assert page.get_attribute("body", "data-moved").split("; ")[0] == red
    assert float(page.get_attribute("body", "data-moved").split("; ")[1].split()[1]) == pytest.approx(0.5, abs=0.01)


def expect_side_by_side(png: bytes, slanting: float = 0.0) -> None:
    """slanting: share of the width by which a view from the side may let one cover the other."""
    (reds, _, red_ends), (blues, blue_begins, _) = places_of(png, 0), places_of(png, 2)
    assert min(reds, blues) > 0.004
    assert red_ends < blue_begins + slanting


def test_what_is_taken_away_leaves_the_address_and_the_memory(page: Page, site: Site) -> None:
    both(page, site)
    with_both = int(page.get_attribute("body", "data-geometries"))
    page.get_by_role("button", name="Take Red box away").click()
    expect(page.locator("#label")).to_have_text("Blue box")
    expect(page.locator("#things")).to_be_hidden()
    assert page.url == f"{site.url}/view?key=blue"
    await_frames(page)
    assert int(page.get_attribute("body", "data-geometries")) < with_both
    assert places_of(stage(page), 0)[0] == 0
    assert places_of(stage(page), 2)[0] > 0.02


def test_finer_levels_are_given_up_from_afar(page: Page, site: Site) -> None:
    page.clock.install()
    page.goto(f"{site.url}/view/red")
    await_data(page, loaded="2 1 0")
    assert len(page.workers) == 2, "meshes are unpacked beside the page"
    page.mouse.move(240, 120)
    page.mouse.wheel(0, 24_000)
    await_data(page, lod="2")
    page.clock.fast_forward(10_000)  # longer than what is too fine is kept
    await_data(page, geometries="2")  # the coarsest level and its shadow
    page.mouse.wheel(0, -24_000)
    await_data(page, lod="0")


def test_a_new_version_takes_the_place_of_the_old_one_where_that_was_put(page: Page, site: Site) -> None:
    page.clock.install()
    publish(box("Kite", RED, state="preview"), site.store, key="kite", job="a")
    page.goto(f"{site.url}/view/kite")
    await_data(page, loaded="2 1 0")
    page.get_by_role("button", name="Move", exact=True).click()
    page.locator("#stage").focus()
    page.keyboard.press("PageUp")
    put = page.get_attribute("body", "data-moved")
    assert put.split()[1] == "0.050"
    publish(box("Kite", GREEN), site.store, key="kite", job="a")
    page.clock.fast_forward(4000)  # longer than until the page asks again, and shorter than its notice is shown
    expect(page.locator("#notice")).to_contain_text("The refined version of Kite took its place: version 2")
    await_data(page, loaded="2 1 0")
    await_frames(page)
    assert page.get_attribute("body", "data-moved") == put
    assert places_of(stage(page), 0)[0] == 0
    assert places_of(stage(page), 1)[0] > 0.02
    assert int(page.get_attribute("body", "data-geometries")) <= 4, "the old version is gone from memory"


def test_what_its_owner_took_back_goes_while_the_rest_stays(page: Page, site: Site) -> None:
    publish(box("Leaver", GREEN, state="preview"), site.store, key="leaver")
    page.goto(f"{site.url}/view?key=red&key=leaver&key=nowhere")
    await_data(page, loaded="2 1 0; 2 1 0")
    expect(page.locator("#said")).to_contain_text("1 more on the way")
    remove(site.store, "leaver")
    expect(page.locator("#notice")).to_contain_text("Leaver was taken back")
    await_frames(page)
    assert places_of(stage(page), 0)[0] > 0.01
    assert places_of(stage(page), 1)[0] == 0


def test_a_picture_in_the_file_is_its_colour_and_leaves_with_it(page: Page, site: Site) -> None:
    glbs = {f"lod{level}.glb": textured_glb(GREEN) for level in (0, 1)}
    usdz = {"asset.usdz": b"PK", "preview.png": picture_of(GREEN, kind="PNG")}
    publish(bundle_of("Painted", glbs, [12, 12], (0.4, 0.4, 0.4), files=usdz), site.store, key="painted")
    page.add_init_script("DOMTokenList.prototype.supports = (word) => word === 'ar';")
    page.goto(f"{site.url}/view?key=painted&key=red")
    await_data(page, loaded="1 0; 2 1 0")
    await_frames(page)
    assert places_of(stage(page), 1)[0] > 0.02
    assert int(page.get_attribute("body", "data-textures")) >= 1
    expect(page.locator("#quick-look")).to_be_hidden()
    page.get_by_role("button", name="Take Red box away").click()
    link = page.get_by_role("link", name="See it in your room")
    expect(link).to_have_attribute("rel", "ar")
    assert link.get_attribute("href").endswith(".usdz")
    assert link.evaluate("link => [...link.children].map((child) => child.tagName)") == ["IMG"]


def test_keys_that_are_none_are_refused_by_the_server(page: Page, site: Site) -> None:
    for address in ("/view?key=red&key=-x", "/view?key=..%2Fx", "/view", "/view?" + "&".join(["key=a"] * 25)):
        answer = page.request.get(f"{site.url}{address}")
        assert answer.status in (404, 422), address


def test_a_name_is_only_a_name(page: Page, site: Site) -> None:
    hostile = "<img src=x onerror=alert(1)>"
    publish(replace(box("x", RED), manifest={**box("x", RED).manifest, "label": hostile}), site.store, key="hostile")
    page.goto(f"{site.url}/view?key=hostile&key=red")
    expect(page.locator("#things li").first).to_contain_text(hostile)
    assert page.locator("#things img").count() == 0
