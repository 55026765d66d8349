"""A browser that prefers German gets German pages: their texts, their scripts' sentences, the guard of their start."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from capture2vr.gateway.languages import in_language
from capture2vr.gateway.page_texts import german_texts
from capture2vr.sentences.sentence import capitalised, in_row, say
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


ALIGNED = say(
    "without_left_out",
    what=say("photos_form_separate_groups_without", sizes=say("one_and_more", what=5, more=4)),
    left_out=say("names_and_more", names="a.jpg, b.jpg", count=3),
)
NOT_BETTER = say(
    "training_did_not_improve",
    why=say(
        "refined_surface",
        faulty=in_row(", ", (say("covers_fewer_points"), say("has_more_separate_pieces"))),
        figures=say(
            "mean_distance_to_coverage_pieces",
            count=1000,
            which=say("held_out_points"),
            number=0.002,
            before=0.001,
            error=0.0001,
            coverage=0.98,
            earlier=0.99,
            pieces=3,
            pieces_before=1,
        ),
    ),
)
CONTRADICTED = say(
    "they_not_used_camera_way", fault=capitalised(say("camera_poses_contradict_depth_images", share=0.45))
)
OF_MANY = in_row(": ", ("has no points.jpg", say("has_no_points")))
"""A file may be named so: as a sentence that is translated elsewhere."""
SIDE = say(
    "shoot_from_as_seen",
    side=say("higher_up", side=say("behind_on_left")),
    reason=say("thing_seen_too_little", share=0.12),
)
STORED = (ALIGNED, NOT_BETTER, CONTRADICTED, OF_MANY, SIDE, say("noise_point_spacings_hides_finer", noise=0.5))


def test_what_the_server_says_is_said_in_german(german: Page, site: Site) -> None:
    """What it quotes too; a file's name and what is not known stay as they are."""
    told = box(
        "Schale",
        GREEN,
        warnings=[
            in_row(": ", ("schale.ply", say("has_no_points"))),
            NOT_BETTER,
            ALIGNED,
            CONTRADICTED,
            OF_MANY,
            "It is cracked and has no name.",
        ],
        capture={"unseen": [{"advice": SIDE, "share": 0.12, "direction": [0, 0, 1]}]},
        preset="standard",
        preset_because=say("points_too_few_to_train", count=1200),
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
    expect(about).to_contain_text("has no points.jpg: hat keine Punkte")
    expect(about).to_contain_text("It is cracked and has no name.")
    expect(about).to_contain_text("Nimm hinten links, von höher oben auf, gesehen wie im ersten Bild")
    expect(about).to_contain_text("1.200 Punkte sind zu wenige zum Trainieren")


def test_a_page_and_the_gateway_translate_alike(german: Page, site: Site) -> None:
    """The scripts fill in the values as Python does, whose formats the catalogue has."""
    german.goto(f"{site.url}/login")
    told = german.evaluate(
        """async (sentences) => {
            const { loadSentences, stored } = await import('/web/shared/stored-sentences.js');
            await loadSentences();
            return sentences.map(({ text, ...coded }) => stored(text, coded));
        }""",
        [{"text": each.english, **each.coded} for each in STORED],
    )
    assert told == [in_language(each, "de") for each in STORED]


def test_stored_sentences_stay_english_where_the_catalogue_does_not_come(german: Page, site: Site) -> None:
    publish(box("Schale", GREEN, warnings=[say("has_no_points")]), site.store, key="german-alone")
    german.route("**/web/sentences/*", lambda route: route.abort())
    german.goto(f"{site.url}/view/german-alone")
    await_data(german, loaded="2 1 0")
    german.get_by_text("Über das Ding", exact=True).click()
    expect(german.locator("#about-text")).to_contain_text("has no points")


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
