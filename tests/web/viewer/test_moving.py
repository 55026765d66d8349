"""Taking hold of things: in the headset with controllers and bare hands, on the page with the mouse and keys."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import Hand, enter, frames, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, places_of, stage
from tests.support.sites import Site
from tests.support.things import RED, box
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser
KEY = "cube"
# The cube of 0.4 m stands 1.5 m ahead, its middle at three quarters of the eyes' height.
MIDDLE = (0.0, 1.2, -1.5)


@pytest.fixture(scope="module")
def viewer(site: Site) -> str:
    """The address of a red cube."""
    publish(box("Cube", RED), site.store, key=KEY)
    return f"{site.url}/view/{KEY}"


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small window: what counts here is where things are."""
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        yield context


def moved(page: Page) -> tuple[float, float, float, float]:
    """Where the thing stands against where it would stand by itself (m), and its scale."""
    x, y, z, scale = map(float, (page.get_attribute("body", "data-moved") or "").split())
    return x, y, z, scale


def visit(page: Page, address: str) -> None:
    page.goto(address)
    await_data(page, loaded="2 1 0")


def near(*numbers: float) -> object:
    return pytest.approx(numbers, abs=0.012)


@pytest.mark.essential
def test_what_a_hand_holds_goes_where_the_hand_goes(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    visit(page, viewer)
    enter(page)
    for eye in halves(stage(page)):
        share, first, last = places_of(eye, 0)
        assert share > 0.01, "both eyes see the red cube"
        assert first < 0.6, "and it is ahead of them"
        assert last > 0.4

    right = Hand(page, "right")
    right.move(0.1, 1.2, -0.5)  # a metre away, pointing at it
    right.press()
    right.move(0.4, 1.3, -0.7)
    right.release()
    assert moved(page) == near(0.3, 0.1, -0.2, 1)

    right.move(0.3, 1.3, -1.7)  # inside it; this time with the grip
    right.press("squeeze")
    right.move(0.0, 1.2, -1.5)
    right.release("squeeze")
    assert moved(page) == near(0, 0, 0, 1)

    left = Hand(page, "left")
    left.move(-0.1, 1.2, -1.5)
    right.move(0.1, 1.2, -1.5)
    left.press("squeeze")
    right.press("squeeze")
    left.move(-0.2, 1.2, -1.5)
    right.move(0.2, 1.2, -1.5)
    right.release("squeeze")
    left.release("squeeze")
    # Twice the size about the middle between the hands: the floor under it goes down by half its height.
    assert moved(page) == near(0, -0.2, 0, 2)

    right.press("b-button")
    right.release("b-button")
    assert moved(page) == near(0, 0, 0, 1)


def test_bare_hands_pinch_and_a_place_outlives_the_visit(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    visit(page, viewer)
    page.evaluate("xrDevice.primaryInputMode = 'hand'")
    enter(page)
    hand = Hand(page, "right", bare=True)
    hand.move(*MIDDLE)
    hand.press()
    hand.move(0.25, 1.4, -1.5)
    hand.release()
    assert moved(page) == near(0.25, 0.2, 0, 1)
    visit(page, viewer)
    assert moved(page) == near(0.25, 0.2, 0, 1), "as it was left, on the page too"
    page.evaluate("xrDevice.primaryInputMode = 'hand'")
    enter(page)
    hand.move(-1.0, 1.2, -0.5)  # beside it
    hand.press()
    page.wait_for_function("() => document.body.dataset.moved === '0.000 0.000 0.000 1.000'")
    hand.release()
    assert page.evaluate("localStorage.getItem('capture2vr:placed')") == "[]"


def test_among_small_things_one_goes_where_one_points_on_the_floor(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    visit(page, viewer)
    enter(page)
    right = Hand(page, "right")
    right.move(0.5, 1.5, 0, down=50)  # beside the cube
    right.stick(0, -1, 10)
    x, y, z = map(float, (page.get_attribute("body", "data-placed") or "").split())
    assert (x, y) == (pytest.approx(-0.5, abs=0.02), pytest.approx(1.0, abs=0.02)), "the scene goes by, at its height"
    assert z == pytest.approx(-1.5 + 1.5 / np.tan(np.radians(50)), abs=0.05)


def test_the_thumbstick_pushes_away_and_turns_what_is_held(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    visit(page, viewer)
    enter(page)
    right = Hand(page, "right")
    right.move(0.0, 1.2, -0.5)
    right.press()
    right.stick(0, -1, 5)
    right.release()
    x, y, z, scale = moved(page)
    assert z < -0.02, "pushed away"
    assert (x, y, scale) == near(0, 0, 1)


def test_on_the_page_the_mouse_moves_lifts_scales_and_turns(page: Page, viewer: str) -> None:
    visit(page, viewer)
    assert moved(page) == near(0, 0, 0, 1)
    page.get_by_role("button", name="Move", exact=True).click()
    expect(page.locator("#notice")).to_contain_text("Drag an object")
    drag(page, (240, 150), (300, 150))
    x, y, z, _ = moved(page)
    assert abs(x) + abs(z) > 0.05
    assert y == pytest.approx(0), "along the floor"
    page.get_by_role("button", name="Reset").click()
    assert moved(page) == near(0, 0, 0, 1)
    page.keyboard.down("Shift")
    drag(page, (240, 150), (240, 70))
    lifted = moved(page)[1]
    assert lifted > 0.1, "lifted"
    page.get_by_role("button", name="Reset").click()
    drag(page, (240, 150), (240, 150 - round(80 * 0.03 / lifted)))
    page.keyboard.up("Shift")
    assert moved(page) == near(0, 0, 0, 1), "3 cm above the floor it is meant to stand on it"
    page.get_by_role("button", name="Reset").click()
    page.mouse.move(240, 150)
    page.mouse.wheel(0, -400)
    page.wait_for_function("() => Number(document.body.dataset.moved.split(' ')[3]) > 1.3")
    page.locator("#stage").focus()
    for key in ("PageUp", "-", "-", "-", "-", "."):
        page.keyboard.press(key)
    _, y, _, scale = moved(page)
    assert y == pytest.approx(0.05, abs=0.001)
    assert scale < 1.3
    page.reload()
    await_data(page, loaded="2 1 0")
    assert moved(page)[1:] == near(y, 0, scale)


def test_beside_a_thing_and_without_the_button_the_mouse_moves_the_camera(page: Page, viewer: str) -> None:
    visit(page, viewer)
    drag(page, (240, 150), (340, 170))
    assert moved(page) == near(0, 0, 0, 1)
    before = stage(page)
    page.get_by_role("button", name="Move", exact=True).click()
    drag(page, (20, 150), (140, 150))
    assert moved(page) == near(0, 0, 0, 1)
    await_frames(page)
    assert stage(page) != before, "the view has turned"


def test_two_fingers_scale_and_turn(context: BrowserContext, page: Page, viewer: str) -> None:
    visit(page, viewer)
    page.get_by_role("button", name="Move", exact=True).click()
    touch = context.new_cdp_session(page)

    def fingers(kind: str, *places: tuple[int, int]) -> None:
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", (230, 150))
    fingers("touchStart", (230, 150), (250, 150))
    fingers("touchMove", (225, 150), (255, 150))
    fingers("touchMove", (220, 150), (260, 150))
    fingers("touchEnd")
    x, _, z, scale = moved(page)
    assert scale == pytest.approx(2, abs=0.1), "twice as far apart"
    assert (x, z) == pytest.approx((0, 0), abs=0.05)


def drag(page: Page, start: tuple[int, int], end: tuple[int, int]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=3)
    page.mouse.up()


MEDDLED = [
    "not json",
    '{"cube": 1}',
    '[["cube", [1, 2, 3]]]',
    '[["cube", [1e9, 0, 0, 0, 0, 0, 1, 1]]]',
    '[["cube", [0, 0, 0, 0, 0, 0, 0, 1]]]',
    '[["cube", [0, 0, 0, 0, 0, 0, 1, 1000]]]',
    '[["cube", [null, 0, 0, 0, 0, 0, 1, 1]]]',
    '["cube", 7, null]',
]


def test_what_the_browser_remembers_is_checked_and_bounded(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/browse/default")
    read = """async (kept) => {
        const { loadPlacement } = await import('/web/scenes/saved-placement.js');
        localStorage.setItem('capture2vr:placed', kept);
        return loadPlacement('cube');
    }"""
    assert [page.evaluate(read, kept) for kept in MEDDLED] == [None] * len(MEDDLED)
    good = '[["cube", [1, 0, -1, 0, 1, 0, 0, 2]]]'
    assert page.evaluate(read, good) == {"offset_m": [1, 0, -1], "turn": [0, 1, 0, 0], "scale": 2}
    many = """async () => {
        const { loadPlacement, savePlacement } = await import('/web/scenes/saved-placement.js');
        const placement = { offset_m: [0, 0, 0], turn: [0, 0, 0, 1], scale: 1 };
        for (let each = 0; each < 300; each++) savePlacement(`k${each}`, placement);
        const kept = JSON.parse(localStorage.getItem('capture2vr:placed'));
        return [loadPlacement('k0'), loadPlacement('k299').scale, kept.length];
    }"""
    assert page.evaluate(many) == [None, 1, 200]


def test_a_headset_that_refuses_is_said(context: BrowserContext, iwer: Path, page: Page, viewer: str) -> None:
    wear(context, iwer)
    visit(page, viewer)
    page.evaluate("() => { navigator.xr.requestSession = () => Promise.reject(new Error('the door is open')); }")
    page.get_by_role("button", name="Enter VR").click()
    expect(page.locator("#said")).to_contain_text("the door is open")
    expect(page.get_by_role("button", name="Enter VR")).to_be_enabled()


def test_passthrough_has_no_floor_and_no_background(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    visit(page, viewer)
    assert clear_share(page, "VR") == 0, "in VR there is a floor and a background everywhere"
    page.evaluate("xrDevice.activeSession.end()")
    expect(page.get_by_role("button", name="Enter AR")).to_be_visible()
    assert clear_share(page, "AR") > 0.5
    expect(page.get_by_role("button", name="Leave AR")).to_be_visible()
    expect(page.get_by_role("button", name="Leave VR")).to_be_hidden()


def clear_share(page: Page, mode: str) -> float:
    """Share of the drawn picture through which the room is seen."""
    enter(page, mode)
    frames(page)
    share = page.evaluate(
        """() => new Promise((done) => xrDevice.activeSession.requestAnimationFrame(() => requestAnimationFrame(() => {
            const canvas = document.getElementById('stage');
            const gl = canvas.getContext('webgl2');
            const pixels = new Uint8Array(4 * canvas.width * canvas.height);
            gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
            let clear = 0;
            for (let place = 3; place < pixels.length; place += 4) clear += pixels[place] === 0;
            done(clear / (pixels.length / 4));
        })))"""
    )
    return float(share)
