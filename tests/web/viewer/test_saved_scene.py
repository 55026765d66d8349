"""Scenes on the server: saved on one device and opened on another, moved by two at once, added to, deleted, shared."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, Route, expect

from capture2vr.gateway.page_texts import WEB
from capture2vr.storage.catalogue.change_entry import remove, restore
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.scenes.scene import PlacedAsset
from capture2vr.storage.scenes.scene_documents import create_scene, list_scenes, read_scene, replace_scene
from capture2vr.storage.store import Store
from tests.support.headsets import Hand, enter, wear
from tests.support.pages import await_data, open_panel, press_twice, requests_of
from tests.support.patience import PATIENCE_S
from tests.support.screenshots import await_frames, places_of, stage
from tests.support.sites import Site
from tests.support.things import BLUE, RED, box
from tests.web.conftest import SMALL, GuardedSite, without_a_past

pytestmark = pytest.mark.browser

LEFT = PlacedAsset("left", "red", (-0.5, 0.0, 0.0))
RIGHT = PlacedAsset("right", "blue", (0.5, 0.0, 0.0), (0.0, 0.7071068, 0.0, 0.7071068), 1.5)
GONE = PlacedAsset("gone", "nowhere", (0.0, 0.0, 1.0))


@pytest.fixture(scope="module", autouse=True)
def published(site: Site) -> None:
    """A red and a blue box."""
    publish_boxes(site.store)


def publish_boxes(store: Store) -> None:
    publish(box("Red box", RED), store, key="red")
    publish(box("Blue box", BLUE), store, key="blue")


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small wide window."""
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        yield context


SEE_FAR_LEFT = """() => new MutationObserver(() => {
    window.seen ||= Number.parseFloat(document.body.dataset.moved) < -1;
}).observe(document.body, { attributes: true })"""


COUNT_VERSIONS = """window.EventSource = class extends EventSource {
    constructor(url) {
        super(url);
        this.addEventListener('scene', ({ lastEventId }) => (document.body.dataset.heard = lastEventId));
    }
}"""


def places(page: Page) -> list[tuple[float, ...]]:
    """Where the things stand in the scene (m), and their scales."""
    told = page.get_attribute("body", "data-moved") or ""
    return [tuple(map(float, each.split())) for each in told.split("; ")]


def await_things(page: Page, count: int) -> None:
    """Until so many things are shown, as fine as they need to be."""
    page.wait_for_function("count => document.body.dataset.loaded?.split('; ').length === count", arg=count)


def until_saved(page: Page, scene: str, version: int) -> None:
    await_data(page, scene=f"{scene} {version}", saved="yes")


def press(page: Page, name: str, key: str) -> None:
    """Move a thing by a key."""
    page.locator("#things").get_by_role("button", name=name, exact=True).click()
    page.locator("#stage").focus()
    page.keyboard.press(key)


def save(site: Site, scene: str, version: int, *items: PlacedAsset, name: str = "Room") -> None:
    """Save a version by another device, over that which it knows."""
    body = {"name": name, "items": [asdict(item) for item in items]}
    answer = httpx.put(f"{site.url}/v1/scenes/{scene}", json=body, headers={"If-Match": f'"{version}"'})
    assert answer.status_code == 200, answer.text


def quicker(context: BrowserContext, module: str, constant: str, milliseconds: int) -> None:
    """Have the pages of a browser load one of the modules of scenes with another constant."""
    text = (WEB / "scenes" / module).read_text()
    changed, count = re.subn(rf"const {constant} = \d+;", f"const {constant} = {milliseconds};", text)
    assert count == 1, f"{module} has no {constant}"
    context.route(f"**/scenes/{module}", lambda route: route.fulfill(body=changed, content_type="text/javascript"))


def middle_of(page: Page, channel: int) -> tuple[float, float]:
    """The middle of the red (0) or the blue (2) thing on the page, in its pixels."""
    pixels = np.asarray(Image.open(io.BytesIO(stage(page))).convert("RGB")).astype(int)
    others = np.delete(pixels, channel, axis=2).max(axis=2)
    rows, columns = np.nonzero((pixels[..., channel] > 60) & (pixels[..., channel] > 1.5 * others))
    found: Any = page.locator("#stage").bounding_box()
    return found["x"] + float(np.median(columns)), found["y"] + float(np.median(rows))


def until_moved(page: Page, before: str) -> None:
    """Until things are not where they were."""
    page.wait_for_function("before => document.body.dataset.moved !== before", arg=before)


def hide(page: Page, hidden: bool) -> None:
    """Have the page believe that its tab is, or is not, behind another one."""
    page.evaluate("hidden => Object.defineProperty(document, 'hidden', { value: hidden, configurable: true })", hidden)
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")


def until(holds: Callable[[], bool]) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def listeners(site: Site) -> float:
    """How many event streams the gateway has."""
    page = httpx.get(f"{site.url}/metrics").text
    return float(next(line.split()[1] for line in page.splitlines() if line.startswith("capture2vr_event_listeners ")))


@pytest.mark.essential
def test_what_is_saved_as_a_scene_opens_elsewhere_as_it_was(
    browser: Browser, context: BrowserContext, page: Page, site: Site
) -> None:
    page.goto(f"{site.url}/view?key=red&key=blue")
    await_things(page, 2)
    press(page, "Red box", "PageUp")
    open_panel(page, "Scene")
    page.get_by_label("Name of the scene").fill("Living room")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url("**/scene/scn_*")
    await_things(page, 2)
    expect(page.locator("#label")).to_have_text("Living room")
    expect(page.locator("#said")).to_contain_text("2 objects")
    assert places(page)[0][1] == 0.05
    with without_a_past(browser) as elsewhere:
        other = elsewhere.new_page()
        other.goto(page.url)
        await_things(other, 2)
        assert places(other) == places(page)


def test_a_scene_is_saved_with_what_is_still_on_its_way(page: Page, site: Site) -> None:
    held: list[Route] = []
    page.route("**/v1/assets/blue", lambda route: held.append(route), times=1)
    page.goto(f"{site.url}/view?key=red&key=blue")
    await_things(page, 1)
    expect(page.locator("#said")).to_contain_text("1 more on the way")
    open_panel(page, "Scene")
    page.get_by_role("button", name="Save").click()
    held[0].continue_()
    page.wait_for_url("**/scene/scn_*")
    stored = read_scene(site.store, page.url.rpartition("/")[2])
    assert [each.asset for each in stored.items] == ["red", "blue"]
    assert stored.items[0].position_m[0] < stored.items[1].position_m[0], "side by side"


def test_a_scene_is_not_saved_without_what_cannot_be_loaded(page: Page, site: Site) -> None:
    before = len(list_scenes(site.store)[0])
    page.route("**/v1/assets/blue", lambda route: route.abort())
    page.goto(f"{site.url}/view?key=red&key=blue")
    await_things(page, 1)
    open_panel(page, "Scene")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#scene-trouble")).to_contain_text("Not loaded yet: blue.")
    assert len(list_scenes(site.store)[0]) == before
    open_panel(page, "Scene")
    page.get_by_role("button", name="Take blue away").click()
    open_panel(page, "Scene")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url("**/scene/scn_*")
    stored = read_scene(site.store, page.url.rpartition("/")[2])
    assert [each.asset for each in stored.items] == ["red"]


def test_who_presses_again_saves_one_scene(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/view?key=red&key=blue")
    await_things(page, 2)
    page.route("**/scene/scn_*", lambda route: route.fulfill(status=204))  # its own page never comes
    open_panel(page, "Scene")
    posts = requests_of(page, "POST")
    press_twice(page.get_by_role("button", name="Save"))
    expect(page.locator("#scene-said")).to_have_text("Saved.")
    page.get_by_label("Name of the scene").fill("Hall")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#label")).to_have_text("Hall")
    assert len(posts) == 1
    scene = (page.get_attribute("body", "data-scene") or "").split()[0]
    until_saved(page, scene, 2)
    assert read_scene(site.store, scene).name == "Hall"


def test_two_who_move_things_at_the_same_time_lose_nothing_without_being_told(
    browser: Browser, context: BrowserContext, page: Page, site: Site
) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    assert places(page) == [(-0.5, 0, 0, 1), (0.5, 0, 0, 1.5)]
    far = PlacedAsset("right", "blue", (2.0, 0.0, 0.0))
    replace_scene(site.store, scene.id, 1, "Room", (LEFT, far))
    press(page, "Red box", "PageUp")
    until_saved(page, scene.id, 3)
    assert places(page) == [(-0.5, 0.05, 0, 1), (2, 0, 0, 1)]
    stored = read_scene(site.store, scene.id)
    assert [each.position_m for each in stored.items] == [(-0.5, 0.05, 0), (2, 0, 0)]
    near = PlacedAsset("left", "red", (-3.0, 0.0, 0.0))
    replace_scene(site.store, scene.id, 3, "Room", (near, far))
    page.keyboard.press("PageUp")
    expect(page.locator("#notice")).to_contain_text("Red box was changed by somebody else at the same time")
    until_saved(page, scene.id, 4)
    assert places(page)[0] == (-3, 0, 0, 1)
    page.locator("#stage").focus()
    page.keyboard.press("PageUp")
    until_saved(page, scene.id, 5)
    page.locator("#reset").click()
    until_saved(page, scene.id, 6)
    stored = read_scene(site.store, scene.id)
    assert [each.position_m for each in stored.items] == [(-3, 0, 0), (2, 0, 0)], "what others did is not undone"


def test_a_thing_is_seen_on_its_way_before_it_is_saved(
    browser: Browser, context: BrowserContext, page: Page, site: Site
) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    quicker(context, "live-moves.js", "SILENCE_MS", 300)
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    with without_a_past(browser) as elsewhere:
        other = elsewhere.new_page()
        other.goto(page.url)
        await_things(other, 2)
        before = other.get_attribute("body", "data-moved") or ""
        page.locator("#move").click()
        await_frames(page)
        x, y = middle_of(page, 0)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 40, y, steps=4)
        until_moved(other, before)
        assert other.get_attribute("body", "data-scene") == f"{scene.id} 1"
        assert places(other)[1] == (0.5, 0, 0, 1.5), "and nothing else"
        assert read_scene(site.store, scene.id).version == 1, "on its way nothing is stored"
        await_frames(page)
        assert middle_of(page, 0)[0] > x + 20, "who moves it sees it, too"
        page.mouse.move(x + 60, y, steps=2)
        page.mouse.up()
        until_saved(page, scene.id, 2)
        now = page.get_attribute("body", "data-moved") or ""
        await_data(other, scene=f"{scene.id} 2", moved=now)
        assert places(page)[0][0] > -0.4
        far = {"id": "left", "position_m": [-3, 0, 0], "rotation": [0, 0, 0, 1], "scale": 1}
        page.evaluate(SEE_FAR_LEFT)
        while not page.evaluate("window.seen"):
            told = httpx.post(f"{site.url}/v1/scenes/{scene.id}/moving", json={"sender": "third", "items": [far]})
            assert told.status_code == 204
            await_frames(page)
    await_data(page, moved=now)  # where it was saved, for nothing else was
    assert read_scene(site.store, scene.id).version == 2


def test_an_event_that_overtakes_the_answer_to_a_save_takes_nothing_back(
    context: BrowserContext, page: Page, site: Site
) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    held: list[Route] = []

    def hold(route: Route) -> None:
        if route.request.method == "PUT" and not held:
            held.append(route)
        else:
            route.continue_()

    context.add_init_script(COUNT_VERSIONS)
    context.route(f"**/v1/scenes/{scene.id}", hold)
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    with page.expect_request(lambda request: request.method == "PUT"):
        press(page, "Red box", "PageUp")
    page.keyboard.press("PageUp")
    answer = held[0].fetch()
    await_data(page, heard="2")
    held[0].fulfill(response=answer)
    until_saved(page, scene.id, 3)
    assert places(page)[0][1] == 0.1
    expect(page.locator("#notice")).not_to_contain_text("somebody else")


def test_a_server_that_refuses_reports_gets_fewer_of_them(context: BrowserContext, page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    quicker(context, "move-reports.js", "REFUSED_MS", 1000)
    told: list[float] = []

    def refuse(route: Route) -> None:
        told.append(time.monotonic())
        route.fulfill(status=429, json={"code": "REQUESTS_LIMITED", "detail": "more than 1 request a minute"})

    context.route("**/moving", refuse)
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    while len(told) < 2:
        press(page, "Red box", "PageUp")
        await_frames(page)
    assert told[1] - told[0] >= 0.99


def test_without_a_stream_of_events_the_page_asks_now_and_then(context: BrowserContext, page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT,))
    quicker(context, "saved-scene.js", "POLL_MS", 400)
    context.route("**/v1/scenes/*/events?*", lambda route: route.fulfill(status=502))
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 1)
    save(site, scene.id, 1, LEFT, RIGHT)
    await_things(page, 2)


def test_what_others_do_is_seen_and_a_deleted_asset_is_named(page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT, GONE))
    page.goto(f"{site.url}/scene/{scene.id}")
    expect(page.locator("#said")).to_contain_text("Not here any more, deleted or taken back: nowhere")
    await_things(page, 1)
    await_frames(page)
    assert places_of(stage(page), 0)[0] > 0.02
    save(site, scene.id, 1, LEFT, RIGHT, name="Hall")
    await_things(page, 2)
    expect(page.locator("#label")).to_have_text("Hall")
    until(lambda: listeners(site) == 1)  # those of earlier tests leave a little later
    hide(page, True)
    until(lambda: listeners(site) == 0)
    save(site, scene.id, 2, LEFT, RIGHT, name="Attic")
    hide(page, False)
    expect(page.locator("#label")).to_have_text("Attic")
    remove(site.store, "blue")
    try:
        expect(page.locator("#said")).to_contain_text("taken back: blue")
        assert len(read_scene(site.store, scene.id).items) == 2, "its place is kept"
    finally:
        restore(site.store, "blue")


def test_a_hand_moves_a_thing_of_a_saved_scene_and_all_devices_have_it(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    wear(context, iwer)
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    enter(page)
    hand = Hand(page, "right")
    hand.move(-0.5, 1.3, -0.5)
    hand.press()
    with page.expect_request("**/moving") as told:
        hand.move(-0.5, 1.8, -0.5)
    assert told.value.post_data_json["items"][0]["id"] == "left"
    hand.release()
    until_saved(page, scene.id, 2)
    assert read_scene(site.store, scene.id).items[0].position_m == pytest.approx((-0.5, 0.5, 0), abs=0.02)


def test_a_thing_is_added_and_one_taken_away_and_the_scene_is_deleted(page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT,))
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 1)
    page.route("**/v1/collections/*/assets?*", lambda route: route.abort(), times=1)
    page.get_by_text("Add an object", exact=True).click()
    expect(page.locator("#add-trouble")).to_contain_text("The server cannot be reached.")
    page.get_by_text("Add an object", exact=True).click()
    open_panel(page, "Add an object")
    choices = page.locator("#add-list button")
    expect(choices.first).to_be_visible()
    page.get_by_label("Name or tag").fill("blue")
    expect(choices.filter(has_text="Red box")).to_have_count(0)
    choices.filter(has_text="Blue box").click()
    await_things(page, 2)
    until_saved(page, scene.id, 2)
    added = read_scene(site.store, scene.id).items[1]
    assert (added.asset, added.position_m[0]) == ("blue", pytest.approx(0.0, abs=0.01)), "10 cm beside the other"
    open_panel(page, "Add an object")
    page.get_by_role("button", name="Take Red box away").click()
    until_saved(page, scene.id, 3)
    assert [each.asset for each in read_scene(site.store, scene.id).items] == ["blue"]
    open_panel(page, "Scene")
    page.get_by_role("button", name="Delete the scene").click()
    page.get_by_role("button", name="Tap again").click()
    page.wait_for_url("**/browse/default")
    with pytest.raises(FileNotFoundError):
        read_scene(site.store, scene.id)


def test_a_scene_that_somebody_deletes_can_be_saved_anew(page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT, RIGHT))
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 2)
    open_panel(page, "Scene")
    expect(page.get_by_role("button", name="Delete the scene")).to_be_visible()
    httpx.delete(f"{site.url}/v1/scenes/{scene.id}").raise_for_status()
    expect(page.locator("#notice")).to_contain_text("This scene was deleted.")
    expect(page.get_by_role("button", name="Delete the scene")).to_be_hidden()
    page.get_by_label("Name of the scene").fill("Room, again")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url(re.compile(f"/scene/(?!{scene.id})scn_"))
    again = read_scene(site.store, page.url.rpartition("/")[2])
    assert (again.name, again.items) == ("Room, again", (LEFT, RIGHT))


def test_what_is_saved_at_last_is_no_more_said_to_be_unsaved(page: Page, site: Site) -> None:
    scene = create_scene(site.store, "Room", (LEFT,))
    page.goto(f"{site.url}/scene/{scene.id}")
    await_things(page, 1)
    page.route("**/v1/scenes/*", lambda route: route.abort() if route.request.method == "PUT" else route.continue_())
    page.locator("#move").click()
    page.locator("#stage").focus()
    page.keyboard.press("PageUp")
    expect(page.locator("#notice")).to_contain_text("Not saved yet, trying again:")
    page.unroute("**/v1/scenes/*")
    until_saved(page, scene.id, 2)
    expect(page.locator("#notice")).to_have_text("")


def test_the_page_of_all_things_lists_the_scenes(page: Page, site: Site) -> None:
    hostile = "<img src=x>"
    scene = create_scene(site.store, hostile, (LEFT,))
    page.goto(f"{site.url}/browse/default")
    page.get_by_text("Scenes", exact=True).click()
    page.get_by_role("link", name=hostile).click()
    page.wait_for_url(f"**/scene/{scene.id}")


def test_a_scene_that_there_is_not_says_so(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/scene/scn_{'0' * 24}")
    expect(page.locator("#said")).to_contain_text("There is no scene")
    assert page.request.get(f"{site.url}/scene/room").status == 404


def test_a_scene_is_shared_where_it_was_just_saved(browser: Browser, guarded: GuardedSite) -> None:
    publish_boxes(guarded.store)
    with without_a_past(browser) as context:
        guarded.log_in(context)
        page = context.new_page()
        page.goto(f"{guarded.url}/view?key=red&key=blue")
        await_things(page, 2)
        open_panel(page, "Scene")
        page.get_by_role("button", name="Save").click()
        page.wait_for_url("**/scene/scn_*")
        open_panel(page, "Share")
        page.get_by_role("button", name="Make a link").click()
        expect(page.locator("#links a")).to_be_visible()


def test_a_link_shows_the_scene_to_somebody_without_a_login(browser: Browser, guarded: GuardedSite) -> None:
    publish_boxes(guarded.store)
    scene = create_scene(guarded.store, "Shop window", (LEFT, RIGHT))
    with without_a_past(browser) as own, without_a_past(browser, SMALL) as foreign:
        guarded.log_in(own)
        mine = own.new_page()
        mine.goto(f"{guarded.url}/scene/{scene.id}")
        open_panel(mine, "Share")
        mine.get_by_role("button", name="Make a link").click()
        link: Any = mine.locator("#links a").get_attribute("href")
        page = foreign.new_page()
        page.goto(link)
        page.wait_for_url("**/scene/*")
        await_things(page, 2)
        expect(page.locator("#label")).to_have_text("Shop window")
        for hidden in ("#move", "#scene", "#add", "#share"):
            expect(page.locator(hidden)).to_be_hidden()
        press(mine, "Red box", "PageUp")
        await_data(page, scene=f"{scene.id} 2", moved=mine.get_attribute("body", "data-moved") or "")
        moving = {"id": "left", "position_m": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": 1}
        path = f"{guarded.url}/v1/scenes/{scene.id}/moving?tenant=ada"
        assert page.request.post(path, data={"sender": "visitor", "items": [moving]}).status == 401
