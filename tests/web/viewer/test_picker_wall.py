"""The wall in the headset: opened by a button or a panel, pages, labels; what is chosen stands before the wearer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, Route

from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.scenes.scene import PlacedAsset
from capture2vr.storage.scenes.scene_documents import create_scene, list_scenes, read_scene
from tests.support.headsets import Hand, enter, frames, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, places_of, stage
from tests.support.sites import Site
from tests.support.things import GREEN, RED, box, picture_of
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser

THINGS = [f"thing{number:02}" for number in range(14)]
AWAY_M = 1.3  # of the wall


@pytest.fixture(scope="module", autouse=True)
def published(site: Site) -> None:
    """A red box, and fourteen green ones on a shelf of their own, of which the last is for the winter."""
    publish(box("Red box", RED), site.store, key="red")
    for key in THINGS:
        files = {"preview.png": picture_of(GREEN, kind="PNG")}
        labels = ["winter"] if key == THINGS[11] else []
        publish(box(key, GREEN, files=files, labels=labels), site.store, key=key, collection="shelf")


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        yield context


def await_wall(page: Page, name: str) -> None:
    """Until something can be pressed in the room."""
    page.wait_for_function("name => JSON.parse(document.body.dataset.wall ?? '{}')[name]", arg=name)


def names_on(page: Page) -> list[str]:
    return list(json.loads(page.get_attribute("body", "data-wall") or "{}"))


def press(page: Page, hand: Hand, name: str) -> None:
    """Point at a part of the wall, which faces the wearer, and press."""
    await_wall(page, name)
    x, y, z = json.loads(page.get_attribute("body", "data-wall") or "{}")[name]
    assert z == pytest.approx(-AWAY_M, abs=0.01)
    hand.move(x, y, z + 0.9)
    hand.press()
    hand.release()


def visit(page: Page, address: str) -> None:
    page.goto(address)
    page.wait_for_function("() => document.body.dataset.loaded")
    enter(page)
    await_wall(page, "open")


def test_a_thing_of_the_wall_stands_before_the_wearer_and_in_the_saved_scene(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    scene = create_scene(site.store, "Room", (PlacedAsset("a", THINGS[0], (0.5, 0.0, 0.0)),))
    wear(context, iwer)
    visit(page, f"{site.url}/scene/{scene.id}")
    hand = Hand(page, "right")
    hand.press("a-button")
    hand.release("a-button")
    await_wall(page, f"thing {THINGS[0]}")
    assert [name for name in names_on(page) if name.startswith("thing ")] == [f"thing {key}" for key in THINGS[:12]]
    press(page, hand, "next")
    await_wall(page, f"thing {THINGS[13]}")
    press(page, hand, "previous")
    press(page, hand, "label winter")
    page.wait_for_function("() => !document.body.dataset.wall.includes('thing00')")
    press(page, hand, f"thing {THINGS[11]}")
    await_data(page, scene=f"{scene.id} 2", saved="yes")
    added = read_scene(site.store, scene.id).items[1]
    # The scene stands 1.5 m ahead: an arm's length from the wearer and half the box is 0.6 m nearer.
    assert (added.asset, added.position_m) == (THINGS[11], pytest.approx((0, 0, 0.6), abs=0.02))
    assert not any(name.startswith("thing ") for name in names_on(page)), "the wall has closed"
    frames(page)
    assert all(places_of(eye, 1)[0] > 0.02 for eye in halves(stage(page)))


def test_bare_hands_open_the_wall_by_its_panel_and_save_what_stands_there(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    wear(context, iwer)
    page.goto(f"{site.url}/view/red")
    page.wait_for_function("() => document.body.dataset.loaded")
    page.evaluate("xrDevice.primaryInputMode = 'hand'")
    enter(page)
    await_wall(page, "open")
    hand = Hand(page, "right", bare=True)
    x, y, z = json.loads(page.get_attribute("body", "data-wall") or "{}")["open"]
    hand.move(x, y, z + 0.3)
    hand.press()
    hand.release()
    before = {scene.id for scene in list_scenes(site.store)[0]}
    held: list[Route] = []
    page.route("**/v1/scenes", lambda route: held.append(route))
    for _ in range(2):
        press(page, hand, "save")
    (order,) = held
    order.continue_()
    page.wait_for_function("() => document.body.dataset.saved === 'yes'")
    (saved,) = [scene for scene in list_scenes(site.store)[0] if scene.id not in before]
    assert [each.asset for each in saved.items] == ["red"]
    assert page.url.endswith(f"/scene/{saved.id}")
    press(page, hand, "close")
    assert names_on(page) == ["open"]


def test_a_reset_of_the_view_stands_the_scene_ahead_again(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    wear(context, iwer)
    visit(page, f"{site.url}/view/red")
    start = page.get_attribute("body", "data-placed")
    Hand(page, "left").stick(0, -1, 10)
    assert page.get_attribute("body", "data-placed") != start
    hand = Hand(page, "right")
    hand.press("a-button")
    hand.release("a-button")
    press(page, hand, "reset view")
    await_data(page, placed=start or "")
    await_frames(page)
