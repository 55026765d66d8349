"""What the viewer says about a thing in plain words, and the refined version beside its preview."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data, open_panel
from tests.support.screenshots import await_frames, places_of, stage
from tests.support.sites import Site
from tests.support.things import GREEN, RED, box

pytestmark = pytest.mark.browser
FRAME = np.eye(4).ravel().tolist()
FIGURES = {"held_out": 900, "held_out_mean": 0.001, "coverage": 0.95, "components": 1, "boundary_loops": 0}
ORIGINS = {"measured": 0.75, "proposed": 0.05, "filled": 0.2}
HOSTILE = '<img src=x onerror="document.body.dataset.bad=1">'


def test_quality_warnings_advice_and_origin_are_told(page: Page, site: Site) -> None:
    told = box(
        "Cup",
        RED,
        quality={**FIGURES, "origins": ORIGINS},
        warnings=[HOSTILE],
        capture={
            "kind": "photos",
            "format": "photos",
            "frames": 20,
            "photos": [{"name": "a.jpg", "verdict": "blur", "advice": ""}],
            "unseen": [{"advice": "Shoot from behind."}],
            "cut": {"kept": "object", "because": "photos were taken around it"},
            "up": {"source": "plane", "confidence": 0.9},
        },
        preset="standard",
        preset_because="900 points on a CPU",
    )
    publish(told, site.store, key="told")
    page.goto(f"{site.url}/view/told")
    await_data(page, loaded="2 1 0")
    open_panel(page, "About")
    await_data(page, about="1")
    about = page.locator("#about-text")
    for sentence in (
        "It follows most of what was captured: 95 % of points that were kept aside to test it lie on it",
        "On average they are 0.40 mm, 0.10 % of its size, away from it.",
        "Of its surface 75 % was measured, 5 % is a guess, and 20 % was filled in.",
        "It has 1 piece and no open borders.",
        HOSTILE,
        "Shoot from behind.",
        "Made from 20 photos. 1 of them could not be used.",
        "Kept: the object without its surroundings; photos were taken around it.",
        "Which way is up was told by what it stands on, with 90 % confidence.",
        "Preset standard, as 900 points on a CPU.",
    ):
        expect(about).to_contain_text(sentence)
    assert page.locator("body").get_attribute("data-bad") is None


def test_what_does_not_come_is_told_at_the_next_opening(page: Page, site: Site) -> None:
    publish(box("Cup", RED, warnings=["It is cracked."]), site.store, key="cracked")
    page.goto(f"{site.url}/view/cracked")
    await_data(page, loaded="2 1 0")
    page.route("**/viewer/about.js", lambda route: route.abort(), times=1)
    page.get_by_text("About", exact=True).click()
    expect(page.locator("#about-text")).to_contain_text("The server cannot be reached.")
    page.get_by_text("About", exact=True).click()
    open_panel(page, "About")
    expect(page.locator("#about-text")).to_contain_text("It is cracked.")


def test_the_panel_of_a_real_thing_is_all_on_the_page(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="bowl")
    page.goto(f"{site.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    open_panel(page, "About")
    expect(page.locator("#about-text")).to_contain_text("Made from a scan (ply).")
    panel, shown = page.locator("#about").bounding_box(), page.viewport_size
    assert panel is not None
    assert shown is not None
    assert panel["y"] + panel["height"] <= shown["height"], "all of it can be scrolled to"
    assert panel["x"] + panel["width"] <= shown["width"]


def test_the_refined_version_beside_its_preview(page: Page, site: Site) -> None:
    preview = box("Cup", RED, state="preview", capture_to_asset=FRAME)
    publish(preview, site.store, key="cup", job="a")
    publish(replace(box("Cup", GREEN), manifest=preview.manifest), site.store, key="cup", job="a")
    page.goto(f"{site.url}/view/cup")
    await_data(page, loaded="2 1 0", state="refined")
    button, slider = page.get_by_role("button", name="Compare"), page.locator("#split-at")
    expect(slider).to_be_hidden()
    button.click()
    await_data(page, compared="1")
    expect(page.locator("#split")).to_contain_text("Refined Preview")
    await_frames(page)
    _, green_from, green_to = places_of(stage(page), 1)
    _, red_from, red_to = places_of(stage(page), 0)
    assert green_from < green_to <= red_from + 0.02 < red_to, "one on each side of the line"
    slider.press("Home")
    await_frames(page)
    assert places_of(stage(page), 1)[0] == 0
    button.click()
    expect(slider).to_be_hidden()
    await_frames(page)
    assert places_of(stage(page), 0)[0] == 0


def test_a_thing_that_never_was_a_preview_has_nothing_to_be_compared_with(page: Page, site: Site) -> None:
    publish(box("Plate", RED, capture_to_asset=FRAME), site.store, key="plate", job="a")
    publish(box("Plate", GREEN, capture_to_asset=FRAME), site.store, key="plate", job="b")
    page.goto(f"{site.url}/view/plate")
    await_data(page, loaded="2 1 0", version="2")
    expect(page.get_by_role("button", name="Compare")).to_be_hidden()
