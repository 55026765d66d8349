"""The page of a collection: things are found, opened together, kept for later, and never believed unchecked."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.collection import Row, describe_shard, shard_data
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import Index, root_name, sign_index
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.store import IMMUTABLE, NO_CACHE
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.pages import await_data, press_twice, requests_of
from tests.support.screenshots import await_frames
from tests.support.sites import Site, site_at
from tests.support.tenants import make_key
from tests.support.things import BLUE, GREEN, RED, box, graded, moving_picture, picture_of
from tests.web.conftest import PHONE, GuardedSite, with_a_past, without_a_past

pytestmark = pytest.mark.browser
INDEX = root_name("default")
HOSTILE = "<img src=x onerror=alert(1)>"
LONGER_MS = 6_000
"""Longer than a second press counts."""


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A signed collection of a boot, a shoe, a sofa that is a guess, and something hostile; a bag was taken back."""
    folder = tmp_path_factory.mktemp("shelf")
    generate_key(folder / "key")
    keys = Keys((read_signer(folder / "key"),))
    thumbnail = {"thumbnail.webp": picture_of(RED), "preview.png": picture_of(GREEN, kind="PNG")}
    turning = {**thumbnail, "turning.webp": moving_picture([RED, BLUE])}
    preview = {"preview.png": picture_of(GREEN, kind="PNG")}
    with site_at(folder, keys) as site:
        for key, bundle in {
            "boot": box("Walking Boot", RED, files=turning, labels=["footwear", "Leder"], **graded("usable")),
            "shoe": box("Straßenschuh", GREEN, files=preview, labels=["footwear"], state="preview"),
            "sofa": box("Sofa", BLUE, files=thumbnail, labels=["furniture"], origin="guess", **graded("incomplete")),
            "zz": box(HOSTILE, BLUE, labels=[HOSTILE, '"><script>alert(2)</script>']),
            "bag": box("Bag", RED, labels=["footwear"]),
        }.items():
            publish(bundle, site.store, key=key, policy=PublishPolicy(keys))
        remove(site.store, "bag", keys)
        yield site


@pytest.fixture(autouse=True)
def whole(shelf: Site) -> Iterator[None]:
    """The index is as it was when a test is over."""
    before = shelf.store.get(INDEX)
    yield
    replaced(shelf, before)


def replaced(site: Site, index: bytes) -> None:
    site.store.put(INDEX, index, content_type="application/json", cache_control=NO_CACHE)


def shown(page: Page) -> list[str]:
    return [str(each.get_attribute("data-key")) for each in page.locator("#grid > li").all()]


def visit(page: Page, site: Site, query: str = "") -> None:
    page.goto(f"{site.url}/browse/default{query}")
    await_data(page, state="shown")


@pytest.mark.essential
def test_things_are_found_chosen_and_opened_together(page: Page, shelf: Site) -> None:
    visit(page, shelf)
    assert shown(page) == ["boot", "shoe", "sofa", "zz"], "and no bag"
    expect(page.locator("#said")).to_have_text("4 objects")
    expect(page.locator("[data-key=boot]")).to_have_attribute("data-picture", "thumbnail.webp")
    expect(page.locator("[data-key=shoe]")).to_have_attribute("data-picture", "preview.png")
    expect(page.locator("[data-key=zz]")).to_have_attribute("data-picture", "none")
    facts = [page.locator(f"[data-key={key}] .facts").inner_text() for key in ("boot", "shoe", "sofa")]
    sizes = [sum(file["bytes"] for file in read_entry(shelf.store, key).document["files"]) for key in ("boot", "shoe")]
    assert facts == [
        f"refined, {sizes[0] / 1000:.1f} KB",
        f"preview, {sizes[1] / 1000:.1f} KB",
        "a guess from one photo",
    ]
    expect(page.locator("#grid .badge")).to_have_text(["Incomplete"])
    expect(page.locator("[data-key=sofa] .badge")).to_be_visible()
    box_of = page.locator("[data-key=zz]")
    expect(box_of.locator(".name")).to_have_text(HOSTILE)
    assert box_of.locator("script, .name img, .labels img").count() == 0

    searching = page.get_by_role("searchbox", name="Search by name or tag")
    for words, keys in {"leder": ["boot"], "WALK boot": ["boot"], "strassen": [], "straß": ["shoe"]}.items():
        searching.fill(words)
        expect(page.locator("#said")).to_contain_text(words)
        assert shown(page) == keys
    searching.fill("nothing like it")
    expect(page.locator("#said")).to_have_text("Nothing matches “nothing like it”.")
    searching.fill("")
    expect(page.locator("#said")).to_have_text("4 objects")
    page.locator("[data-key=boot]").get_by_role("button", name="footwear").click()
    expect(page.locator("#said")).to_have_text("2 objects for “footwear”")
    assert page.url.endswith("?q=footwear")

    page.get_by_role("checkbox", name="Choose Walking Boot").focus()
    page.keyboard.press("Space")
    page.get_by_role("checkbox", name="Choose Straßenschuh").check()
    expect(page.locator("#count")).to_have_text("2 chosen")
    page.get_by_role("link", name="Open together").click()
    expect(page.locator("#label")).to_have_text("2 objects")
    assert page.url == f"{shelf.url}/view?key=boot&key=shoe"
    page.get_by_role("link", name="All objects").click()
    expect(page.locator("#said")).to_have_text("4 objects")
    page.get_by_role("link", name="Walking Boot", exact=True).click()
    expect(page.locator("#label")).to_have_text("Walking Boot")


def test_a_card_leads_to_the_formats_for_other_programs(page: Page, shelf: Site) -> None:
    visit(page, shelf)
    link = page.get_by_role("link", name="Download Walking Boot")
    expect(link).to_have_text("Download")
    page.get_by_role("checkbox", name="Choose Walking Boot").focus()
    page.keyboard.press("Tab")
    expect(link).to_be_focused()
    page.keyboard.press("Enter")
    page.wait_for_url(f"{shelf.url}/view/boot#downloads")
    opened = page.get_by_role("list", name="Formats for other programs")
    expect(opened.get_by_role("button", name="GLB", exact=True)).to_be_visible()
    expect(page.locator("#downloads summary")).to_be_focused()
    page.keyboard.press("Tab")
    expect(opened.get_by_role("button").first).to_be_focused()


def test_a_thing_turns_while_it_is_pointed_at_unless_motion_is_unwelcome(page: Page, shelf: Site) -> None:
    visit(page, shelf)
    expect(page.locator("[data-key=boot]")).to_have_attribute("data-picture", "thumbnail.webp")
    picture = page.locator("[data-key=boot] img")
    still = picture.get_attribute("src")
    page.get_by_role("link", name="Walking Boot", exact=True).focus()
    expect(picture).not_to_have_attribute("src", str(still))
    page.locator("#search").focus()
    expect(picture).to_have_attribute("src", str(still))
    page.emulate_media(reduced_motion="reduce")
    page.locator("[data-key=boot]").hover()
    await_frames(page)
    expect(picture).to_have_attribute("src", str(still))


def refused(context: BrowserContext, site: Site, code: str, words: str) -> None:
    page = context.new_page()
    page.goto(f"{site.url}/browse/default")
    await_data(page, code=code)
    expect(page.locator("#said")).to_contain_text(words)
    assert shown(page) == []
    page.close()


def test_what_is_older_forged_or_changed_is_refused(
    browser: Browser, context: BrowserContext, page: Page, shelf: Site
) -> None:
    before = shelf.store.get(INDEX)
    publish(box("Sofa", RED, labels=["furniture"]), shelf.store, key="sofa", policy=PublishPolicy(shelf.keys))
    now = shelf.store.get(INDEX)
    visit(page, shelf)
    replaced(shelf, before)
    refused(context, shelf, "CATALOGUE_OLDER", "older catalogue than this device has seen")

    envelope = json.loads(now)
    text = json.loads(envelope["signed"])
    forged = {**envelope, "signed": json.dumps({**text, "version": text["version"] + 1})}
    replaced(shelf, json.dumps(forged).encode())
    refused(context, shelf, "CATALOGUE_FORGED", "not signed by whom it was before")

    replaced(shelf, now)
    shard = Path(shelf.store.path(read_root(shelf.store, "default").parts[0].name))
    content = shard.read_bytes()
    shard.chmod(0o644)
    shard.write_bytes(content.replace(b"Walking", b"Running"))
    another = browser.new_context(service_workers="block")  # this one has the shard as it was
    refused(another, shelf, "ASSET_TAMPERED", "not what the catalogue promises")
    another.close()
    shard.write_bytes(content)
    visit(page, shelf)


def test_a_picture_that_was_changed_is_not_shown(page: Page, shelf: Site) -> None:
    files = read_entry(shelf.store, "shoe").document["files"]
    picture = Path(shelf.store.path(next(file["name"] for file in files if file["file"] == "preview.png")))
    content = picture.read_bytes()
    picture.chmod(0o644)
    picture.write_bytes(picture_of(BLUE, kind="PNG"))
    try:
        visit(page, shelf)
        expect(page.locator("[data-key=shoe] .facts")).to_contain_text("not what the catalogue promises")
        assert page.locator("[data-key=shoe] img").get_attribute("src") is None
    finally:
        picture.write_bytes(content)


def test_a_picture_that_was_changed_on_its_way_is_not_shown(browser: Browser, shelf: Site) -> None:
    with browser.new_context(service_workers="block") as context:  # a worker's own requests pass the route by
        page = context.new_page()
        content = picture_of(BLUE, kind="PNG")
        page.route("**/preview*.png", lambda route: route.fulfill(body=content, content_type="image/png"))
        visit(page, shelf)
        expect(page.locator("[data-key=shoe] .facts")).to_contain_text("not what the catalogue promises")
        assert page.locator("[data-key=shoe] img").get_attribute("src") is None


@pytest.fixture
def page_with_a_past(browser: Browser) -> Iterator[Page]:
    """A page of a browser that keeps what pages keep."""
    with with_a_past(browser) as context:
        yield context.new_page()


def test_after_one_visit_the_page_needs_no_server(page_with_a_past: Page, shelf: Site, tmp_path: Path) -> None:
    page = page_with_a_past
    lamp, policy = box("Lamp", RED, files={"thumbnail.webp": picture_of(RED)}), PublishPolicy(shelf.keys)
    publish(lamp, shelf.store, key="lamp", policy=policy)
    with site_at(tmp_path, shelf.keys) as site:
        publish(lamp, site.store, key="lamp", policy=policy)
        visit(page, site)
        expect(page.locator("[data-key=lamp]")).to_have_attribute("data-picture", "thumbnail.webp")
        await_data(page, offline="ready")
        url = site.url
    page.goto(f"{url}/browse/default")
    expect(page.locator("[data-key=lamp]")).to_have_attribute("data-picture", "thumbnail.webp")
    page.get_by_role("searchbox").fill("lamp")
    expect(page.locator("#said")).to_have_text("1 object for “lamp”")


def test_ten_thousand_things_are_read_as_far_as_they_are_looked_at(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        publish_many(site, 10_000)
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url) if "/shard." in request.url else None)
        page.goto(f"{site.url}/browse/default")
        expect(page.locator("#said")).to_have_text("About 10,000 objects")
        assert (len(asked), len(shown(page))) == (1, 48)
        page.get_by_role("button", name="Next").click()
        expect(page.locator("#where")).to_have_text("Page 2")
        assert shown(page)[0] == "k00048"
        assert len(asked) == 1
        page.get_by_role("searchbox").fill("thing 9999")
        expect(page.locator("#said")).to_have_text("1 object for “thing 9999”")
        assert shown(page) == ["k09999"]
        assert len(asked) == 10
        page.goto(f"{site.url}/browse/default?page=209")
        expect(page.locator("#where")).to_have_text("Page 209 of 209")
        assert len(shown(page)) == 16


def test_of_a_larger_collection_pages_say_how_much_they_have_looked_through(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        publish_many(site, 11_000)
        visit(page, site, "?q=thing+10999")
        large = "The collection is large: only its first 10,000 objects, by key, were looked through."
        expect(page.locator("#said")).to_have_text(f"Nothing matches “thing 10999”. · {large}")
        visit(page, site, "?order=newest&page=209")
        expect(page.locator("#said")).to_have_text(f"About 11,000 objects · {large}")
        expect(page.locator("#where")).to_have_text("Page 209 of 209")
        expect(page.get_by_role("button", name="Next")).to_be_disabled()
        page.goto(f"{site.url}/wardrobe/default")
        expect(page.locator("#notice")).to_have_text(large)


def test_long_names_and_words_stay_on_a_phones_screen(browser: Browser, tmp_path: Path) -> None:
    with site_at(tmp_path) as site, without_a_past(browser, PHONE) as context:
        publish(box("B" * 60, RED, labels=["L" * 60]), site.store, key="k" * 100, collection="c" * 100)
        page = context.new_page()
        page.goto(f"{site.url}/browse/{'c' * 100}")
        await_data(page, state="shown", manages="yes")
        is_within = "document.documentElement.scrollWidth <= innerWidth"
        assert page.evaluate(is_within)
        searching = page.get_by_role("searchbox")
        searching.fill("q" * 100)
        expect(page.locator("#said")).to_contain_text("Nothing matches")
        assert page.evaluate(is_within)
        has_outline = "(each) => getComputedStyle(each).outlineStyle === 'solid'"
        outlined = f"[...document.querySelectorAll('*')].filter({has_outline}).map(({{ id }}) => id)"
        assert page.evaluate(outlined) == ["search"], "what has the focus, and nothing else"
        searching.fill("")
        page.get_by_role("checkbox").check()
        page.route("**/remove", lambda route: route.abort())
        page.get_by_role("button", name="Remove").click()
        expect(page.locator("#said")).to_contain_text("k" * 100)
        assert page.evaluate(is_within)


def test_who_presses_twice_turns_one_page_and_keeps_the_focus(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        publish_many(site, 130)
        visit(page, site, "?page=2")
        number, focused = page.locator("#where"), page.locator(":focus")
        for name, expected in (("Previous", "Page 1 of 3"), ("Next", "Page 2 of 3"), ("Next", "Page 3 of 3")):
            button = page.get_by_role("button", name=name)
            button.focus()
            press_twice(button)
            expect(number).to_have_text(expected)
            expect(focused).to_have_text(name)
            assert len(shown(page)) == (34 if expected.startswith("Page 3") else 48)
        expect(page.get_by_role("button", name="Next")).to_be_disabled()
        page.get_by_role("button", name="Next").press("Enter")
        visit(page, site, "?page=4")
        expect(number).to_have_text("Page 3 of 3")
        assert page.url.endswith("?page=3"), "the last one that there is"


def publish_many(site: Site, count: int) -> None:
    """A collection of assets that have rows and nothing else."""
    keys = [f"k{place:05}" for place in range(count)]
    publish_rows(site, [Row(key, f"Thing {key[1:]}", ("many",), 1, "refined", 0, "0" * 64, "") for key in keys])


def publish_rows(site: Site, rows: list[Row]) -> None:
    """Publish a collection of these rows, which are in the order of their keys, 1,000 a shard."""
    shards = []
    for first in range(0, len(rows), 1000):
        part = rows[first : first + 1000]
        data = shard_data(part, str(first))
        shards.append(describe_shard("default", part, data))
        site.store.put(shards[-1].name, data, content_type="application/json", cache_control=IMMUTABLE)
    replaced(site, sign_index(Index("default", 1, "2026-01-01T00:00:00+00:00", tuple(shards)), ()))


def test_a_collection_that_is_none_is_said(page: Page, shelf: Site) -> None:
    page.goto(f"{shelf.url}/browse/nobodys")
    await_data(page, code="COLLECTION_UNKNOWN")
    expect(page.locator("#said")).to_contain_text("nobodys")
    assert page.request.get(f"{shelf.url}/browse/-x").status == 404


def test_things_are_put_in_order_and_told_apart_by_their_state(page: Page, shelf: Site) -> None:
    visit(page, shelf)
    page.get_by_label("Order").select_option("name")
    expect(page.locator("#grid > li").first).to_have_attribute("data-key", "zz")
    assert shown(page) == ["zz", "sofa", "shoe", "boot"], "<img…, Sofa, Straßenschuh, Walking Boot"
    page.get_by_label("Show").select_option("preview")
    expect(page.locator("#said")).to_have_text("1 object, preview")
    assert shown(page) == ["shoe"]
    assert page.url.endswith("?order=name&state=preview")
    page.reload()
    await_data(page, state="shown")
    assert shown(page) == ["shoe"]


def test_things_are_put_in_the_order_of_their_changes(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        changed = {"first": 1_000_000_000, "last": 1_000_000_002, "middle": 1_000_000_001}
        publish_rows(site, [Row(key, key, (), 1, "refined", when, "0" * 64, "") for key, when in changed.items()])
        visit(page, site, "?order=newest")
        assert shown(page) == ["last", "middle", "first"]
        page.get_by_label("Order").select_option("oldest")
        expect(page.locator("#grid > li").first).to_have_attribute("data-key", "first")
        assert shown(page) == ["first", "middle", "last"]


def test_things_are_found_by_the_day_of_their_change_and_by_their_size(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        sizes = {"small": 10, "large": 3_000_000, "middle": 1_500_000}
        for key, size in sizes.items():
            publish(
                box(key, RED, files={"thumbnail.webp": picture_of(RED), "points.ply": bytes(size)}), site.store, key=key
            )
        visit(page, site)
        page.get_by_label("Order").select_option("largest")
        expect(page.locator("#grid > li").first).to_have_attribute("data-key", "large")
        assert shown(page) == ["large", "middle", "small"]
        page.locator("#limits > summary").press("Enter")  # a click may miss it where the page is still moving
        page.get_by_label("MB from").fill("1")
        page.locator("#most").fill("2.5")
        page.locator("#most").blur()
        expect(page.locator("#said")).to_have_text("1 object")
        assert shown(page) == ["middle"]
        assert page.url.endswith("?order=largest&least=1&most=2.5")
        page.reload()
        await_data(page, state="shown")
        assert shown(page) == ["middle"]
        page.get_by_role("button", name="Any date and size").click()
        expect(page.locator("#said")).to_have_text("3 objects")
        page.get_by_label("Changed from").fill(f"{datetime.now():%Y-%m-%d}")
        expect(page.locator("#said")).to_have_text("3 objects")
        page.locator("#until").fill("2020-02-29")
        expect(page.locator("#said")).to_have_text("Nothing matches; look at “Date and size”.")
        assert shown(page) == []


def test_what_was_chosen_is_not_done_to_the_things_of_another_who_logs_in(page: Page, guarded: GuardedSite) -> None:
    bob = make_key(guarded.data_dir, "bob", ALL_SCOPES - {Scope.OPERATE})
    bobs = store_of_tenant(guarded.site.store, "bob")
    publish(box("Ada's", RED), guarded.store, key="cup")
    publish(box("Bob's", RED), bobs, key="cup")
    guarded.log_in(page.context)
    for press in ("#remove", "#order", ""):
        page.goto(f"{guarded.url}/browse/default")
        await_data(page, state="shown", manages="yes", tenant="ada")
        page.get_by_role("checkbox", name="Choose Ada's").check()
        page.context.request.post(f"{guarded.url}/v1/session", data={"key": bob})
        if press == "#order":
            page.locator(press).select_option("newest")
        elif press:
            page.locator(press).click()
        else:
            page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        await_data(page, state="shown", manages="yes", tenant="bob")
        expect(page.locator("#grid .name")).to_have_text("Bob's")
        expect(page.locator("#chosen")).to_be_hidden()
        guarded.log_in(page.context)
    assert not any(read_entry(store, "cup").removed for store in (guarded.store, bobs))


@pytest.mark.essential
def test_who_manages_things_removes_restores_and_deletes_many_at_once(page: Page, tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        for key in ("a", "b", "c"):
            publish(box(key.upper(), RED), site.store, key=key)
        page.clock.install()
        visit(page, site)

        def do(name: str, *keys: str) -> None:
            for key in keys:
                page.get_by_role("checkbox", name=f"Choose {key}").check()
            page.get_by_role("button", name=name).click()

        posts = requests_of(page, "POST")
        for key in ("A", "B"):
            page.get_by_role("checkbox", name=f"Choose {key}").check()
        page.get_by_role("button", name="Remove").focus()
        press_twice(page.get_by_role("button", name="Remove"))
        expect(page.locator("#said")).to_have_text("2 removed; “Show: removed ones” has them. 1 object")
        assert shown(page) == ["c"]
        expect(page.locator("#said")).to_be_focused()
        assert posts == [f"{site.url}/v1/assets/{key}/remove" for key in ("a", "b")]
        page.get_by_label("Show").select_option("removed")
        expect(page.locator("#said")).to_have_text("2 objects, removed")
        expect(page.get_by_role("link", name="Download")).to_have_count(0)
        expect(page.get_by_role("button", name="Remove")).to_be_hidden()
        do("Restore", "A")
        expect(page.locator("#said")).to_have_text("1 restored. 1 object, removed")
        do("Delete for good", "B")
        assert read_entry(site.store, "b").removed, "once is not enough"
        page.clock.fast_forward(LONGER_MS)
        page.get_by_role("button", name="Delete for good").click()
        assert read_entry(site.store, "b").removed, "the first time was long ago"
        page.get_by_role("button", name="Tap again").click()
        expect(page.locator("#said")).to_have_text("1 deleted for good. There are no removed objects.")
        with pytest.raises(FileNotFoundError):
            read_entry(site.store, "b")
        page.get_by_label("Show").select_option("")
        expect(page.locator("#said")).to_have_text("2 objects")
        assert shown(page) == ["a", "c"]
