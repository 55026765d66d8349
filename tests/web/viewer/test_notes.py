"""Notes that are pinned to a thing: by who manages it, on its page; read by all who see it, in the headset too."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.notes_update import add_note
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.store import Store
from tests.support.headsets import enter, wear
from tests.support.pages import await_data, press_twice, requests_of
from tests.support.screenshots import await_frames, halves, stage
from tests.support.sites import Site
from tests.support.things import BLUE, box
from tests.web.conftest import GuardedSite, without_a_past

pytestmark = pytest.mark.browser
HOSTILE = '<img src=x onerror="document.body.dataset.bad=1">'
BOUNDS = [[-0.2, 0, -0.2], [0.2, 0.4, 0.2]]


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small window: the panel leaves room beside it."""
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        yield context


def publish_cube(store: Store, key: str) -> None:
    publish(box("Cube", BLUE, bounds_m=BOUNDS), store, key=key, visibility=Visibility.PUBLIC)


def pin(store: Store, key: str, text: str, at: tuple[float, float, float] = (0, 0.3, 0.2)) -> None:
    add_note(store, key, text=text, at=at, normal=(0, 0, 1), author="Ada")


@pytest.mark.essential
def test_a_note_is_pinned_shown_changed_and_removed(page: Page, site: Site) -> None:
    publish_cube(site.store, "noted")
    page.goto(f"{site.url}/view/noted")
    await_data(page, loaded="2 1 0", notes="0")
    page.locator("#notes > summary").click()
    page.get_by_role("button", name="Pin a note").click()
    page.keyboard.press("Enter")  # the middle of the view
    page.get_by_label("The note").fill(HOSTILE)
    posts, deletions = requests_of(page, "POST"), requests_of(page, "DELETE")
    press_twice(page.get_by_role("button", name="Save note"))
    await_data(page, notes="1")
    assert len(posts) == 1
    (note,) = read_entry(site.store, "noted").notes
    assert note.text == HOSTILE
    assert max(abs(value - middle) for value, middle in zip(note.at, (0, 0.2, 0), strict=True)) == pytest.approx(
        0.2, abs=0.01
    ), "on the cube's surface"
    expect(page.locator("#notes-list .text")).to_have_text(HOSTILE)
    await_frames(page)
    closed = dark(stage(page))
    page.get_by_role("button", name="Show note 1").click()
    await_data(page, note=note.id)
    await_frames(page)
    assert dark(stage(page)) > closed + 200, "its text stands in the scene, on its ground"
    page.get_by_role("button", name="Change note 1").click()
    page.get_by_label("The note").fill("Clean")
    page.get_by_role("button", name="Save note").click()
    expect(page.locator("#notes-list .text")).to_have_text("Clean")
    press_twice(page.get_by_role("button", name="Remove note 1"))
    await_data(page, notes="0")
    assert len(deletions) == 1
    assert read_entry(site.store, "noted").notes == ()
    assert page.locator("body").get_attribute("data-bad") is None


def test_a_tap_on_a_pin_shows_its_note(page: Page, site: Site) -> None:
    publish_cube(site.store, "tapped")
    pin(site.store, "tapped", "In the middle", (0, 0.2, 0))
    page.goto(f"{site.url}/view/tapped")
    await_data(page, loaded="2 1 0", notes="1")
    page.mouse.click(240, 150)
    (note,) = read_entry(site.store, "tapped").notes
    await_data(page, note=note.id)
    expect(page.locator("#notes")).to_have_attribute("open", "")
    page.keyboard.press("Escape")
    expect(page.locator("#notes")).not_to_have_attribute("open", "")


def test_a_visitor_reads_them_and_cannot_pin(context: BrowserContext, guarded: GuardedSite) -> None:
    publish_cube(guarded.store, "lent")
    pin(guarded.store, "lent", "A stain")
    publish(box("Cube", BLUE, size=(0.5, 0.5, 0.5)), guarded.store, key="lent", job="another")
    page = context.new_page()
    page.goto(f"{guarded.url}/view/lent?tenant=ada")
    await_data(page, loaded="2 1 0", notes="1")
    page.locator("#notes > summary").click()
    expect(page.locator("#notes-list")).to_contain_text("A stain")
    expect(page.locator("#notes-list")).to_contain_text("pinned on version 1: it may be displaced")
    expect(page.locator("#notes-list")).not_to_contain_text("Ada")
    expect(page.get_by_role("button", name="Pin a note")).to_be_hidden()
    expect(page.get_by_role("button", name="Remove note 1")).to_have_count(0)
    publish_cube(guarded.store, "bare")
    page.goto(f"{guarded.url}/view/bare?tenant=ada")
    await_data(page, loaded="2 1 0", notes="0")
    expect(page.locator("#notes")).to_be_hidden()


def test_in_the_headset_the_note_is_read(context: BrowserContext, iwer: Path, page: Page, site: Site) -> None:
    publish_cube(site.store, "worn-note")
    wear(context, iwer)
    seen = []
    for text in ("", "A stain here, of wine."):
        if text:
            pin(site.store, "worn-note", text)
        page.goto(f"{site.url}/view/worn-note")
        await_data(page, loaded="2 1 0", notes="1" if text else "0")
        enter(page)
        seen.append([light(eye) for eye in halves(stage(page))])
        page.evaluate("xrDevice.activeSession.end()")
        await_data(page, xr="off")
    assert all(after > before + 20 for before, after in zip(*seen, strict=True)), f"its letters, for both eyes: {seen}"


def light(png: bytes) -> int:
    """Pixels of letters' grey in the middle of a picture, where the cube is."""
    middle = _middle(png)
    return int(((middle.min(axis=2) > 100) & (np.ptp(middle, axis=2) < 40)).sum())


def dark(png: bytes) -> int:
    """Pixels of the letters' ground in the middle of a picture of the page, which is light."""
    return int((_middle(png).max(axis=2) < 90).sum())


def _middle(png: bytes) -> np.ndarray:
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    rows, columns = pixels.shape[0] // 5, pixels.shape[1] // 5
    return pixels[rows:-rows, columns:-columns]
