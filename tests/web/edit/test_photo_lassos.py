"""Lassos on the edit page: drawn with a finger, a mouse or the keys, in shares of the photo; saved, and taken away."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from capture2vr.cli.up import Stack
from capture2vr.order.edits import Edits
from tests.support.pages import await_data
from tests.support.patience import PATIENCE_S
from tests.support.two_balls import RED_AT, line_around, picture_name, write_two_balls
from tests.web.conftest import without_a_past
from tests.web.edit.test_edit import open_tab, recipe_of

pytestmark = pytest.mark.browser
KEY = "two-balls"
SIZES = {"upright": {"width": 320, "height": 480}, "level": {"width": 480, "height": 300}}


def make_balls(stack: Stack, folder: Path, key: str) -> str:
    """Have the capture of two balls made into a thing; the capture's id."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(write_two_balls(folder).rglob("*.*")):
            archive.write(path, path.relative_to(folder))
    with httpx.Client(base_url=stack.url, timeout=PATIENCE_S) as client:
        headers = {"Content-Type": "application/zip"}
        capture = client.post("/v1/captures", content=packed.getvalue(), headers=headers).json()["capture"]
        order = {"capture": capture, "asset_key": key, "preset": "quick", "cut": "scene", "fill": "none"}
        job = client.post("/v1/jobs", json=order).json()["id"]
        with client.stream("GET", f"/v1/jobs/{job}/events") as events:
            for _ in events.iter_lines():  # until the job has ended
                pass
        assert client.get(f"/v1/jobs/{job}").json()["state"] == "SUCCEEDED"
    return str(capture)


@pytest.fixture(scope="module")
def balls(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The capture of two balls that stands under `KEY`."""
    return make_balls(stack, tmp_path_factory.mktemp("balls"), KEY)


@pytest.fixture(params=SIZES)
def phone(request: pytest.FixtureRequest, browser: Browser) -> Iterator[Page]:
    with without_a_past(browser, SIZES[request.param], has_touch=True) as context:
        yield context.new_page()


def open_photos(page: Page, stack: Stack, photo: str) -> None:
    page.goto(f"{stack.url}/edit/{KEY}")
    await_data(page, state="ready")
    open_tab(page, "Photos")
    page.get_by_label("Photo", exact=True).select_option(photo)
    await_data(page, photo=photo)


def places(page: Page, line: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Where the corners of a line are on the page: the photo fills its frame, with bars on two sides."""
    frame = page.locator("#photo-image").bounding_box()
    assert frame is not None
    natural = page.locator("#photo-image").evaluate("image => [image.naturalWidth, image.naturalHeight]")
    scale = min(frame["width"] / natural[0], frame["height"] / natural[1])
    left = frame["x"] + (frame["width"] - scale * natural[0]) / 2
    top = frame["y"] + (frame["height"] - scale * natural[1]) / 2
    return [(left + x * scale * natural[0], top + y * scale * natural[1]) for x, y in line]


def draw_by_finger(page: Page, line: list[tuple[float, float]]) -> None:
    session = page.context.new_cdp_session(page)
    corners = places(page, line)
    for number, (x, y) in enumerate(corners):
        kind = "touchMove" if number else "touchStart"
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def draw_by_mouse(page: Page, line: list[tuple[float, float]]) -> None:
    drag(page, places(page, line))


def drag(page: Page, corners: list[tuple[float, float]]) -> None:
    page.mouse.move(*corners[0])
    page.mouse.down()
    for corner in corners[1:]:
        page.mouse.move(*corner)
    page.mouse.up()


def test_a_finger_draws_a_line_that_is_undone(phone: Page, stack: Stack, balls: str) -> None:
    name = picture_name(3)
    open_photos(phone, stack, name)
    wanted = line_around(RED_AT, 3)
    draw_by_finger(phone, wanted)
    (lasso,) = recipe_of(phone)["lassos"]
    assert lasso["photo"] == name
    low, high = np.min(lasso["line"], axis=0), np.max(lasso["line"], axis=0)
    assert low == pytest.approx(np.min(wanted, axis=0), abs=0.02)
    assert high == pytest.approx(np.max(wanted, axis=0), abs=0.02)
    assert Edits.parse(json.dumps(recipe_of(phone))).as_json == recipe_of(phone), "as the command line reads it"
    expect(phone.get_by_role("button", name="Save as a new version")).to_be_enabled()
    expect(phone.locator("#lassos")).to_contain_text(f"Line 1 in {name}: is left out")
    # Beside depth images the cameras of pictures are in no file, so nothing is shown beforehand.
    expect(phone.locator("#lasso-said")).to_have_text("What these lines leave out is seen once it is saved.")
    overflow = phone.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert overflow <= 0

    phone.get_by_role("button", name="Undo").click()
    assert "lassos" not in recipe_of(phone)
    expect(phone.get_by_role("button", name="Undo")).to_be_disabled()
    open_tab(phone, "Box")
    expect(phone.locator("#photo")).to_be_hidden()


def test_keys_alone_draw_and_remove_lines(page: Page, stack: Stack, balls: str) -> None:
    open_photos(page, stack, picture_name(0))
    page.get_by_label("The next line goes round").select_option("keep")
    page.get_by_label("Also what is hidden in this photo").check()
    page.locator("#photo-lines").focus()
    for key in ("Space", *5 * ["ArrowRight"], "Space", *5 * ["ArrowDown"], "Space", "Space", "Backspace", "Enter"):
        page.keyboard.press(key)
    (lasso,) = recipe_of(page)["lassos"]
    assert lasso == {
        "photo": picture_name(0), "line": [[0.5, 0.5], [0.6, 0.5], [0.6, 0.6]], "keeps": True, "through": True,
    }  # fmt: skip
    for key in ("Space", "Shift+ArrowLeft", "Space", "Enter"):  # two corners go round nothing
        page.keyboard.press(key)
    assert len(recipe_of(page)["lassos"]) == 1
    page.get_by_role("button", name="The next photo").click()
    await_data(page, photo=picture_name(1))
    page.get_by_role("button", name="Show line 1").click()
    await_data(page, photo=picture_name(0))
    page.get_by_role("button", name="Remove line 1").click()
    assert "lassos" not in recipe_of(page)


def test_no_line_is_drawn_in_a_photo_that_is_not_there_yet(page: Page, stack: Stack, balls: str) -> None:
    open_photos(page, stack, picture_name(3))
    held: list[Route] = []
    page.route("**/pictures/4", lambda route: held.append(route))
    corners = places(page, line_around(RED_AT, 3))
    with page.expect_request("**/pictures/4"):
        page.get_by_role("button", name="The next photo").click()
    drag(page, corners)
    assert "lassos" not in recipe_of(page)
    assert page.locator("#photo-image").evaluate("image => image.naturalWidth") == 0, "the photo before is gone"
    held[0].continue_()
    await_data(page, photo=picture_name(4))
    draw_by_mouse(page, line_around(RED_AT, 4))
    assert [lasso["photo"] for lasso in recipe_of(page)["lassos"]] == [picture_name(4)]


def test_a_lasso_is_saved_and_is_there_again(page: Page, stack: Stack, balls: str) -> None:
    open_photos(page, stack, picture_name(3))
    page.get_by_label("Also what is hidden in this photo").check()
    draw_by_mouse(page, line_around(RED_AT, 3))
    drawn = recipe_of(page)["lassos"]
    before = httpx.get(f"{stack.url}/v1/assets/{KEY}").json()
    page.get_by_role("button", name="Save as a new version").click()
    await_data(page, changed="no")
    after = httpx.get(f"{stack.url}/v1/assets/{KEY}").json()
    assert after["version"] > before["version"]
    manifests = [httpx.get(each["manifest"]["url"]).json() for each in (before, after)]
    assert manifests[1]["edits"]["lassos"] == drawn
    assert manifests[1]["points"] < manifests[0]["points"]
    assert recipe_of(page)["lassos"] == drawn
    expect(page.locator("#lassos")).to_contain_text(f"Line 1 in {picture_name(3)}: is left out")


def test_photos_that_there_are_not_are_told(page: Page, stack: Stack, balls: str) -> None:
    def answer(pictures: list[Any]) -> None:
        page.unroute_all()
        page.route("**/pictures", lambda route: route.fulfill(json={"pictures": pictures, "films": []}))

    answer([])
    page.goto(f"{stack.url}/edit/{KEY}")
    await_data(page, state="ready")
    open_tab(page, "Photos")
    expect(page.locator("#trouble")).to_contain_text("no photos that a line can be drawn in")
    expect(page.locator("#photo")).to_be_hidden()
    answer([{"name": "a.jpg", "url": "/v1/captures/none/pictures/0"}])
    page.goto(f"{stack.url}/edit/{KEY}")
    await_data(page, state="ready")
    open_tab(page, "Photos")
    expect(page.locator("#lasso-said")).to_have_text("This photo cannot be shown. Choose another one.")
    expect(page.locator("#photo-lines")).to_be_hidden()
