"""Measuring a thing on its page: known shapes give known figures, by mouse, touch and keys, also in the headset."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import enter, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, stage
from tests.support.sites import Site
from tests.support.things import BLUE, box
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser
SIZE = (0.4, 0.4, 0.4)
QUALITY = {"held_out_mean": 0.001}
"""0.4 mm of 0.4 m: two points are √2 times as far off."""
FRONT = 0.2  # z of the front face
PLACES = """async ([size, points]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { frame } = await import('/web/graphics/scene.js');
    const { left, top, width, height } = document.getElementById('stage').getBoundingClientRect();
    const camera = new THREE.PerspectiveCamera(45, width / height, 0.01, 200);
    frame(camera, size, new THREE.Vector3(0, size[1] / 2, 0));
    camera.updateMatrixWorld();
    const seen = points.map((point) => new THREE.Vector3(...point).project(camera));
    return seen.map(({ x, y }) => [left + width * (1 + x) / 2, top + height * (1 - y) / 2]);
}"""


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small touch screen: the panel leaves room beside it."""
    with without_a_past(browser, {"width": 480, "height": 300}, has_touch=True) as context:
        yield context


def open_panel(page: Page, site: Site, key: str, **manifest: Any) -> Page:
    publish(box("Cube", BLUE, size=SIZE, **{"quality": QUALITY, **manifest}), site.store, key=key)
    page.goto(f"{site.url}/view/{key}")
    await_data(page, loaded="2 1 0")
    page.locator("#measure > summary").click()
    page.wait_for_function("() => document.body.hasAttribute('data-measuring')")
    return page


def places(page: Page, *points: tuple[float, float, float]) -> list[tuple[float, float]]:
    """Where points of the thing are on the page, as it is first shown."""
    return [(x, y) for x, y in page.evaluate(PLACES, [SIZE, points])]


def choose(page: Page, *points: tuple[float, float, float]) -> None:
    for x, y in places(page, *points):
        page.mouse.click(x, y)


def measured(page: Page) -> dict[str, float]:
    told = (page.get_attribute("body", "data-measured") or "").split("; ")
    return {kind: float(value) for kind, value in (each.split() for each in told if each)}


@pytest.mark.essential
def test_a_length_and_an_angle_are_measured_by_mouse(page: Page, site: Site) -> None:
    open_panel(page, site, "measured")
    choose(page, (0.05, 0.1, FRONT), (0.15, 0.1, FRONT))
    assert measured(page) == {"distance": pytest.approx(0.1, rel=0.02)}
    expect(page.locator("#measure-said")).to_have_text("Distance: 10.00 ± 0.06 cm.")
    page.get_by_role("button", name="Angle").click()
    choose(page, (0.15, 0.1, FRONT), (0.05, 0.1, FRONT), (0.05, 0.18, FRONT))
    assert measured(page)["angle"] == pytest.approx(90, abs=1)
    page.get_by_role("button", name="Height").click()
    choose(page, (0.1, 0.12, FRONT))
    assert measured(page)["height"] == pytest.approx(0.12, abs=1e-3)
    expect(page.locator("#measure-list li")).to_have_count(3)
    expect(page.locator("#measure-scale")).to_contain_text("Its size was measured by what captured it.")
    page.get_by_role("button", name="Remove angle").click()
    assert set(measured(page)) == {"distance", "height"}
    page.get_by_role("button", name="Remove all").click()
    assert measured(page) == {}


def test_an_area_is_measured_by_touch_and_a_loop_that_crosses_itself_is_said(page: Page, site: Site) -> None:
    open_panel(page, site, "around")
    page.get_by_role("button", name="Area").tap()
    for x, y in places(page, (0.02, 0.1, FRONT), (0.15, 0.2, FRONT), (0.15, 0.1, FRONT), (0.02, 0.2, FRONT)):
        page.touchscreen.tap(x, y)
    await_data(page, points="4")
    page.get_by_role("button", name="Close the loop").tap()
    expect(page.locator("#measure-said")).to_contain_text("cross")
    page.get_by_role("button", name="Take the last point back").tap()
    page.get_by_role("button", name="Close the loop").tap()
    assert measured(page) == {"area": pytest.approx(0.13 * 0.1 / 2, rel=0.02)}
    expect(page.locator("#measure-said")).to_have_text("Area: 65.0 ± 0.5 cm².")


def test_keys_are_enough(page: Page, site: Site) -> None:
    open_panel(page, site, "by-keys")
    assert page.evaluate("document.activeElement.id") == "stage"
    page.keyboard.press("Enter")
    await_data(page, points="1")
    expect(page.locator("#measure-said")).to_have_text("And the other one.")
    for key in ("Shift+ArrowRight", "Shift+ArrowUp"):
        page.keyboard.press(key)
    expect(page.locator("#cross")).to_be_visible()
    page.keyboard.press("Enter")
    assert 0.005 < measured(page)["distance"] < 0.1
    for _ in range(30):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Enter")
    expect(page.locator("#measure-said")).to_contain_text("There is nothing of it")
    for _ in range(15):
        page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    await_data(page, points="0")
    expect(page.locator("#measure")).to_have_attribute("open", "")
    page.keyboard.press("Escape")
    expect(page.locator("#measure")).not_to_have_attribute("open", "")
    assert page.evaluate("document.activeElement.parentElement.id") == "measure"
    page.mouse.click(240, 150)
    assert len(measured(page)) == 1, "what was measured stays, and no more is"


@pytest.mark.parametrize(
    ("manifest", "text", "sentence"),
    [
        ({"scale_confidence": "unknown"}, "cm ?", "Its true size is not known"),
        ({"scale_confidence": "estimated", "edits": {"length": {"start": [0, 0, 0], "end": [1, 0, 0], "metres": 0.2}}},
         "± ", "a length of 20 cm between two points that a person gave"),
        ({"scale_confidence": "estimated", "scale_by_model": True}, "10 cm", "an estimate of a learned model"),
        ({"origin": "guess", "quality": {}}, "10 cm", "Its shape is a guess from one photo."),
        ({"origin": "generated", "quality": {}}, "10 cm", "Its shape was generated from one photo"),
    ],
)  # fmt: skip
def test_what_is_not_known_of_the_scale_is_said(
    page: Page, site: Site, manifest: dict[str, Any], text: str, sentence: str
) -> None:
    open_panel(page, site, "scaled", **manifest)
    choose(page, (0.05, 0.1, FRONT), (0.15, 0.1, FRONT))
    expect(page.locator("#measure-said")).to_contain_text(text)
    expect(page.locator("#measure-scale")).to_contain_text(sentence)
    assert ("±" in page.locator("#measure-said").inner_text()) == ("±" in text)


def test_in_the_headset_the_figures_stand_in_the_scene(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    wear(context, iwer)
    open_panel(page, site, "worn")
    choose(page, (0.03, 0.3, FRONT), (0.18, 0.3, FRONT))
    await_frames(page)
    assert orange(stage(page)) > 20
    page.keyboard.press("Escape")  # the panel closes, and the buttons below are there again
    enter(page)
    for eye in halves(stage(page)):
        assert orange(eye) > 8, "the line and its ends, in an eye of 240 pixels"
        assert dark_ground(eye) > 100, "the label"
    page.evaluate("xrDevice.activeSession.end()")
    await_data(page, xr="off")
    page.locator("#measure > summary").click()
    page.get_by_role("button", name="Remove all").click()
    await_frames(page)
    assert orange(stage(page)) == 0


def orange(png: bytes) -> int:
    """Pixels of the marks' colour."""
    red, green, blue = np.moveaxis(np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int), 2, 0)
    return int(((red > 180) & (green > 90) & (green < 190) & (blue < 90)).sum())


def dark_ground(png: bytes) -> int:
    """Pixels of a label's ground before the blue cube, whose own are all much bluer."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    middle = pixels[pixels.shape[0] // 4 : -pixels.shape[0] // 4, pixels.shape[1] // 4 : -pixels.shape[1] // 4]
    return int((middle.max(axis=2) < 90).sum())
