"""One photo on the capture page: the outline of what will be made, and the rectangle that says what is meant."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, Request, expect

from capture2vr.cli.up import Stack
from tests.support.pages import await_data
from tests.web.conftest import PHONE, without_a_past

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 800, 600
RED, BLUE = (240, 300), (600, 300)  # centres of two discs, in pixels
RADIUS = 110


@pytest.fixture(scope="module")
def photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red disc and a blue one before a wall, stored sideways, as a phone does that is held upright."""
    rgb = np.clip(np.random.default_rng(0).normal(210, 4, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
    for centre, colour in ((RED, (180, 40, 30)), (BLUE, (30, 60, 170))):
        cv2.circle(rgb, centre, RADIUS, colour, cv2.FILLED, cv2.LINE_AA)
    exif = Image.Exif()
    exif[0x0112] = 6  # turn it clockwise to see it
    path = tmp_path_factory.mktemp("one") / "two discs.jpg"
    Image.fromarray(np.rot90(rgb).copy()).save(path, quality=95, exif=exif)
    return path


def choose(page: Page, stack: Stack, path: Path) -> None:
    page.goto(stack.url)
    page.locator("#files").set_input_files(path)


def outlined(page: Page) -> np.ndarray:
    """The corners of the outline that the page draws, in pixels of the photo; waits for it."""
    page.wait_for_function("() => document.body.dataset.outlined", polling=20)
    numbers = re.findall(r"[\d.e-]+", page.locator("#which-outline").get_attribute("d") or "")
    return np.array(numbers, float).reshape(-1, 2) * [WIDTH, HEIGHT]


def draw(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw a rectangle with the mouse, between two places in pixels of the photo."""
    drawing = page.locator("#which-drawing")
    drawing.scroll_into_view_if_needed()
    area = drawing.bounding_box()
    assert area
    on_page = [
        (area["x"] + x / WIDTH * area["width"], area["y"] + y / HEIGHT * area["height"]) for x, y in (start, end)
    ]
    page.mouse.move(*on_page[0])
    page.mouse.down()
    page.mouse.move(*on_page[1], steps=4)
    page.mouse.up()


def around(centre: tuple[int, int], loose: int = 20) -> tuple[tuple[int, int], tuple[int, int]]:
    reach = RADIUS + loose
    return (centre[0] - reach, centre[1] - reach), (centre[0] + reach, centre[1] + reach)


def test_the_outline_is_shown_and_a_rectangle_says_what_is_meant(page: Page, stack: Stack, photo: Path) -> None:
    choose(page, stack, photo)
    both = outlined(page)
    assert both[:, 0].min() == pytest.approx(RED[0] - RADIUS, abs=8)
    assert both[:, 0].max() == pytest.approx(BLUE[0] + RADIUS, abs=8)
    expect(page.locator("#which-note")).to_contain_text("draw a rectangle")

    draw(page, *around(BLUE))
    one = outlined(page)
    assert one[:, 0].min() == pytest.approx(BLUE[0] - RADIUS, abs=8)
    assert one[:, 1].max() == pytest.approx(BLUE[1] + RADIUS, abs=8)
    expect(page.locator("#which-box")).to_be_visible()

    page.get_by_role("button", name="Without the mark").click()
    assert outlined(page)[:, 0].min() == pytest.approx(RED[0] - RADIUS, abs=8)
    expect(page.locator("#which-box")).to_be_hidden()


def test_the_rectangle_goes_with_the_upload_and_the_job(page: Page, stack: Stack, photo: Path) -> None:
    sent: list[Request] = []
    page.on("request", lambda request: sent.append(request) if request.method == "POST" else None)
    choose(page, stack, photo)
    outlined(page)
    draw(page, *around(BLUE))
    outlined(page)
    page.locator("#preset").select_option("quick")
    page.get_by_role("button", name="Send").click()
    await_data(page, preview="1")  # what was cut out is told with it; textures take as long again
    (upload,) = (request for request in sent if "/v1/captures" in request.url)
    (job,) = (request for request in sent if request.url.endswith("/v1/jobs"))
    box = json.loads(job.post_data or "")["box"]
    (left, top), (right, bottom) = around(BLUE)
    assert np.allclose(np.multiply(box, [WIDTH, HEIGHT] * 2), [left, top, right, bottom], atol=4)
    assert upload.url.endswith(f"/v1/captures?box={','.join(map(str, box))}")
    expect(page.locator("#warnings")).to_contain_text("One photo shows only one side")
    expect(page.locator("#warnings")).not_to_contain_text("Nothing stands out")


def test_a_finger_draws_too_and_does_not_scroll_the_page(page: Page, stack: Stack, photo: Path) -> None:
    choose(page, stack, photo)
    outlined(page)
    page.locator("#which-drawing").scroll_into_view_if_needed()
    area = page.locator("#which-drawing").bounding_box()
    assert area
    scrolled = page.evaluate("scrollY")
    touches = page.context.new_cdp_session(page)
    (x0, y0), (x1, y1) = (
        (area["x"] + x / WIDTH * area["width"], area["y"] + y / HEIGHT * area["height"]) for x, y in around(RED)
    )
    touches.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x0, "y": y0}]})
    touches.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x1, "y": y1}]})
    touches.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    assert outlined(page)[:, 0].max() == pytest.approx(RED[0] + RADIUS, abs=8)
    assert page.evaluate("scrollY") == scrolled


def test_keys_move_and_size_the_rectangle(page: Page, stack: Stack, photo: Path) -> None:
    choose(page, stack, photo)
    outlined(page)
    page.locator("#which-drawing").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    rectangle = page.locator("#which-box")
    drawn = [float(rectangle.get_attribute(name) or "") for name in ("x", "y", "width", "height")]
    assert np.allclose(drawn, [0.27, 0.25, 0.5, 0.52])
    for _ in range(30):
        page.keyboard.press("ArrowRight")
    drawn = [float(rectangle.get_attribute(name) or "") for name in ("x", "width")]
    assert drawn[0] + drawn[1] <= 1
    page.keyboard.press("Delete")
    expect(rectangle).to_be_hidden()


def test_a_tap_takes_the_rectangles_place_and_goes_with_the_job(page: Page, stack: Stack, photo: Path) -> None:
    choose(page, stack, photo)
    outlined(page)
    draw(page, *around(RED))
    outlined(page)
    draw(page, BLUE, BLUE)
    one = outlined(page)
    assert one[:, 0].min() == pytest.approx(BLUE[0] - RADIUS, abs=8)
    assert one[:, 0].max() == pytest.approx(BLUE[0] + RADIUS, abs=8)
    with page.expect_request("**/v1/jobs") as job:
        page.locator("#name").fill("disc")
        page.get_by_role("button", name="Send").click()
    box = json.loads(job.value.post_data or "")["box"]
    assert np.allclose(np.multiply(box, [WIDTH, HEIGHT] * 2), [*BLUE, *BLUE], atol=4)


def test_a_tap_shows_the_outline_in_one_of_several_photos(
    page: Page, stack: Stack, photo: Path, tmp_path: Path
) -> None:
    paths = [tmp_path / f"{number}.jpg" for number in range(3)]
    for path in paths:
        path.write_bytes(photo.read_bytes() + b"\0" * len(path.stem))
    page.goto(stack.url)
    page.locator("#photos").set_input_files(paths)
    await_data(page, looked="3")
    page.get_by_text("Mark the object", exact=True).click()
    page.get_by_role("button", name="Mark the object in 1.jpg").click()
    draw(page, BLUE, BLUE)
    one = outlined(page)
    assert one[:, 0].min() == pytest.approx(BLUE[0] - RADIUS, abs=8)
    assert one[:, 0].max() == pytest.approx(BLUE[0] + RADIUS, abs=8)


def test_where_there_is_nothing_the_page_says_so_before_sending(page: Page, stack: Stack, tmp_path: Path) -> None:
    Image.new("RGB", (400, 300), (3, 3, 3)).save(tmp_path / "black.jpg")
    choose(page, stack, tmp_path / "black.jpg")
    assert len(outlined(page)) == 0
    expect(page.locator("#which-note")).to_contain_text("shows nothing", ignore_case=True)


def test_the_object_is_marked_in_one_of_several_photos(page: Page, stack: Stack, photo: Path, tmp_path: Path) -> None:
    """All have the name that phones' cameras give; the server numbers them, and refuses what shows too little."""
    paths = [tmp_path / str(number) / "image.jpg" for number in range(3)]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(photo.read_bytes() + b"\0" * len(path.parent.name))
    page.goto(stack.url)
    page.locator("#photos").set_input_files(paths)
    expect(page.locator("#which")).to_be_hidden()
    await_data(page, looked="3")
    page.get_by_text("Mark the object", exact=True).click()
    second = page.get_by_role("button", name="Mark the object in image.jpg").nth(1)
    second.click()
    expect(second).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#which-note")).to_contain_text("draw a rectangle")
    draw(page, *around(BLUE))
    expect(page.locator("#which-note")).to_contain_text("without what stands around it")
    (left, top), (right, bottom) = around(BLUE)
    with page.expect_request("**/v1/captures?*") as upload, page.expect_request("**/v1/jobs") as job:
        page.locator("#name").fill("disc")
        page.get_by_role("button", name="Send").click()
    *box, name = json.loads(job.value.post_data or "")["box"]
    assert np.allclose(np.multiply(box, [WIDTH, HEIGHT] * 2), [left, top, right, bottom], atol=4)
    assert name == "image-2.jpg"
    assert upload.value.url.endswith(f"/v1/captures?box={','.join(map(str, box))},photo=image-2.jpg")


def test_two_photos_are_marked_as_several_are(page: Page, stack: Stack, photo: Path, tmp_path: Path) -> None:
    Image.new("RGB", (400, 300), (90, 90, 90)).save(tmp_path / "other.jpg")
    choose(page, stack, photo)
    outlined(page)
    draw(page, *around(BLUE))
    page.locator("#photos").set_input_files(tmp_path / "other.jpg")
    expect(page.locator("#which")).to_be_hidden()
    expect(page.locator("#mark")).to_be_visible()
    expect(page.locator("#advice")).to_contain_text("a guess: 7 more from around")


def test_the_photo_fits_a_phone(browser: Browser, stack: Stack, photo: Path) -> None:
    with without_a_past(browser, PHONE, has_touch=True) as context:
        page = context.new_page()
        choose(page, stack, photo)
        outlined(page)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        area = page.locator("#which-drawing").bounding_box()
        assert area
        assert area["width"] / area["height"] == pytest.approx(WIDTH / HEIGHT, rel=0.01)
        assert area["height"] < 0.61 * PHONE["height"]
