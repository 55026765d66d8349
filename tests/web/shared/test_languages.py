"""A browser that prefers German gets German pages: their texts, their scripts' sentences, the guard of their start."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from capture2vr.gateway.page_texts import german_texts
from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data
from tests.support.sites import Site
from tests.support.things import GREEN, box
from tests.web.conftest import PHONE, without_a_past

pytestmark = pytest.mark.browser


@pytest.fixture
def german(browser: Browser) -> Iterator[Page]:
    """A page of a phone whose browser prefers German to English."""
    with without_a_past(browser, PHONE, has_touch=True, locale="de-DE") as context:
        yield context.new_page()


def english_left(page: Page) -> list[str]:
    """What of a German page is still English: lines and names that the table has a translation for."""
    lines = page.locator("body").inner_text().splitlines()
    names = page.evaluate("[...document.querySelectorAll('[aria-label], [title]')].map((e) => e.ariaLabel || e.title)")
    table = german_texts()
    return [text for text in map(str.strip, [*lines, *names]) if table.get(text, text) != text]


@pytest.mark.essential
def test_the_viewer_speaks_german(german: Page, site: Site) -> None:
    publish(box("Schale", GREEN), site.store, key="german-bowl")
    german.goto(f"{site.url}/view/german-bowl")
    await_data(german, loaded="2 1 0")
    expect(german.locator("#said")).to_have_text("40 cm × 40 cm × 40 cm · 768 Dreiecke · verfeinert, Version 1")
    german.get_by_text("Über das Ding", exact=True).click()
    expect(german.locator("#about-text")).to_contain_text("Version 1, verfeinert, vom ")
    german.locator("#about > summary").click()
    german.locator("#downloads > summary").click()
    expect(german.locator("#downloads-list")).to_contain_text("Für fast jedes 3D-Programm")
    german.locator("#downloads > summary").click()
    german.get_by_role("button", name="Hintergrund").click()
    expect(german.locator("#notice")).to_contain_text("Hintergrund:")
    assert english_left(german) == []


def test_the_other_pages_speak_german(german: Page, site: Site) -> None:
    publish(box("Schale", GREEN), site.store, key="german-bowl")
    german.goto(f"{site.url}/browse/default?words=german-bowl")
    await_data(german, state="shown")
    expect(german.locator("#said")).to_have_text(re.compile(r"^\d+ Dinge?$"))
    assert english_left(german) == []
    german.goto(f"{site.url}/")
    await_data(german, started="yes")
    german.locator("#files").set_input_files({"name": "schale.ply", "mimeType": "", "buffer": bytes(1_500_000)})
    expect(german.locator("#chosen")).to_have_text("1 Datei, 1,5 MB")
    assert english_left(german) == []
    for path in ("/login", "/pair", "/edit/german-bowl", "/s/none"):
        german.goto(f"{site.url}{path}")
        await_data(german, started="yes")
        assert english_left(german) == [], path


ALIGNED = (
    "the photos form separate groups of 5 and 4 without overlap; only the largest was used, "
    "without a.jpg, b.jpg and 3 more"
)
NOT_BETTER = (
    "training did not improve on the preview: the refined surface covers fewer points, has more separate pieces: "
    "mean distance to 1,000 held-out points 0.00200, was 0.00100 (± 0.00010); coverage 0.980, was 0.990; "
    "pieces 3, was 1"
)
CONTRADICTED = (
    "The camera poses contradict the depth images: by these poses, the cameras see through 45% of what their "
    "neighbours saw. They were not used: the camera's way was computed from the images."
)
OF_MANY = " and ".join(["code"] * 60) + ".jpg: has no points"
"""A file may be named so: each of its words is one that a sentence may quote."""
SIDE = "Shoot from behind on the left, higher up, as seen in the first picture: 12% of the thing is seen too little."


def test_what_the_server_says_is_said_in_german(german: Page, site: Site) -> None:
    """What it quotes too; a file's name and what is not known stay as they are."""
    told = box(
        "Schale",
        GREEN,
        warnings=[
            "schale.ply: has no points",
            NOT_BETTER,
            ALIGNED,
            CONTRADICTED,
            OF_MANY,
            "It is cracked and has no name.",
        ],
        capture={"unseen": [{"advice": SIDE, "share": 0.12, "direction": [0, 0, 1]}]},
        preset="standard",
        preset_because="1,200 points are too few to train on",
    )
    publish(told, site.store, key="german-told")
    german.goto(f"{site.url}/view/german-told")
    await_data(german, loaded="2 1 0")
    german.get_by_text("Über das Ding", exact=True).click()
    about = german.locator("#about-text")
    expect(about).to_contain_text("schale.ply: hat keine Punkte")
    expect(about).to_contain_text(
        "das Training hat die Vorschau nicht verbessert: die verfeinerte Oberfläche bedeckt weniger Punkte, hat mehr "
        "einzelne Teile: mittlerer Abstand zu 1.000 zurückgehaltenen Punkten 0,00200, vorher 0,00100 (± 0,00010)"
    )
    expect(about).to_contain_text(
        "getrennte Gruppen von 5 und 4 ohne Überlappung; nur die größte wurde verwendet, ohne"
    )
    expect(about).to_contain_text("a.jpg, b.jpg und 3 weitere")
    expect(about).to_contain_text(
        "Die Kamerastellungen widersprechen den Tiefenbildern: danach sehen die Kameras durch 45%"
    )
    expect(about).to_contain_text("code and code.jpg: hat keine Punkte")
    expect(about).to_contain_text("It is cracked and has no name.")
    expect(about).to_contain_text("Nimm hinten links, von höher oben auf, gesehen wie im ersten Bild")
    expect(about).to_contain_text("1.200 Punkte sind zu wenige zum Trainieren")


def test_what_is_wrong_with_a_capture_is_said_in_german(german: Page, site: Site) -> None:
    german.goto(f"{site.url}/")
    await_data(german, started="yes")
    german.locator("#files").set_input_files({"name": "bild.png", "mimeType": "image/png", "buffer": b"GIF89a" * 99})
    german.get_by_role("button", name="Senden", exact=True).click()
    trouble = german.locator("#trouble")
    expect(trouble).to_contain_text("bild.png: das ist kein lesbares Bild, obwohl der Name es sagt")
    assert english_left(german) == []


def test_a_page_that_does_not_start_says_so_in_german(german: Page, site: Site) -> None:
    german.route("**/web/collection/collection.js", lambda route: route.abort())
    german.goto(f"{site.url}/browse/default", wait_until="commit")  # the guard stops the page, which never ends loading
    expect(german.get_by_role("alert").last).to_contain_text("Diese Seite konnte nicht ganz geladen werden.")
    expect(german.get_by_role("button", name="Noch einmal versuchen")).to_be_visible()


def test_a_browser_of_another_language_gets_english(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/login")
    expect(page.get_by_role("heading", level=1)).to_have_text("Log in")
    assert page.locator("html").get_attribute("lang") == "en"
