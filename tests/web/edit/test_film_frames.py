"""Key frames of films on the edit page: decoded by the browser from a stored capture, and lines drawn in them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from capture2vr.cli.up import Stack
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support.captures import turn_film
from tests.support.pages import await_data
from tests.support.patience import PATIENCE_S
from tests.web.edit.test_edit import open_tab, recipe_of
from tests.web.edit.test_lasso_preview import balls_bundle
from tests.web.edit.test_photo_lassos import draw_by_mouse, make_balls

pytestmark = pytest.mark.browser
KEY = "balls-filmed"
RATE, FRAMES = 30, 60
FILMS = {"round.mp4": "libx264", "back.webm": "libvpx-vp9", "upright.mp4": "libx264"}
TURNED = "upright.mp4"
"""Its phone was held upright: its pictures are to be turned clockwise by a quarter."""
SHOWN = (0, 10, 20, 41)
"""Frames that are key frames: 10/30 s is written 0.33 s, when the frame before it is still shown; 20/30 s is 0.67 s."""


def key_frame(film: str, number: int) -> str:
    return f"{film} at {number / RATE:.2f} s"


def level(film: str, number: int) -> int:
    """How bright the left half of a frame is, as it is stored; the right half is as much darker than white."""
    return 200 - 3 * number if film == "back.webm" else 20 + 3 * number


def write(path: Path, codec: str) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, options={"g": "24"})
        stream.width, stream.height, stream.pix_fmt, stream.time_base = 320, 240, "yuv420p", Fraction(1, RATE)
        for number in range(FRAMES):
            picture = np.empty((240, 320, 3), np.uint8)
            picture[:, :160], picture[:, 160:] = level(path.name, number), 255 - level(path.name, number)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return turn_film(path, 1) if path.name == TURNED else path


@pytest.fixture(scope="module")
def films(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A stored capture of films; a thing under `KEY` has cameras named after their frames."""
    folder = tmp_path_factory.mktemp("films")
    make_balls(stack, folder / "balls", KEY)
    names = [key_frame(film, number) for film in FILMS for number in SHOWN]
    publish(balls_bundle(names), LocalStore(stack.store_root), key=KEY)
    with httpx.Client(base_url=stack.url, timeout=PATIENCE_S) as client:
        parts = [("files", (name, write(folder / name, codec).read_bytes())) for name, codec in FILMS.items()]
        answer = client.post("/v1/captures", files=parts)
        assert answer.status_code == 201, answer.text
        return str(answer.json()["capture"])


def open_film(page: Page, stack: Stack, films: str) -> None:
    """Open the photos as if the thing had been made from the films."""
    listed = f"{stack.url}/v1/captures/{films}/pictures"
    page.route("**/pictures", lambda route: route.fulfill(response=route.fetch(url=listed)))
    page.goto(f"{stack.url}/edit/{KEY}")
    await_data(page, state="ready")
    open_tab(page, "Photos")
    expect(page.get_by_label("Photo", exact=True).locator("option")).to_have_count(len(FILMS) * len(SHOWN))


def test_key_frames_are_shown_and_take_lines(page: Page, stack: Stack, films: str) -> None:
    open_film(page, stack, films)
    choice = page.get_by_label("Photo", exact=True)
    wanted = [key_frame(film, number) for film in sorted(FILMS) for number in SHOWN]
    expect(choice.locator("option")).to_have_text(wanted)
    for film in FILMS:
        for number in reversed(SHOWN):
            choice.select_option(key_frame(film, number))
            await_data(page, photo=key_frame(film, number))
            halves = page.locator("#photo-image").evaluate(
                """(image, places) => {
                    const { naturalWidth: width, naturalHeight: height } = image;
                    const drawing = Object.assign(document.createElement('canvas'), { width, height }).getContext('2d');
                    drawing.drawImage(image, 0, 0);
                    return places.map(([x, y]) => drawing.getImageData(x * width, y * height, 1, 1).data[0]);
                }""",
                [[0.5, 0.25], [0.5, 0.75]] if film == TURNED else [[0.25, 0.5], [0.75, 0.5]],
            )
            assert halves == pytest.approx([level(film, number), 255 - level(film, number)], abs=1.4), (film, number)
    line = [(0.2, 0.2), (0.4, 0.2), (0.4, 0.6), (0.2, 0.6), (0.2, 0.25)]
    draw_by_mouse(page, line)
    (lasso,) = recipe_of(page)["lassos"]
    assert lasso["photo"] == key_frame(TURNED, 0)
    assert np.min(lasso["line"], axis=0) == pytest.approx([0.2, 0.2], abs=0.02)


def test_who_steps_on_quickly_sees_the_last_frame_asked_for(page: Page, stack: Stack, films: str) -> None:
    open_film(page, stack, films)
    for _ in range(5):
        page.get_by_role("button", name="The next photo").press("Enter")
    last = page.get_by_label("Photo", exact=True).input_value()
    await_data(page, photo=last)
    expect(page.locator("#photo-image")).to_have_attribute("alt", last)


def test_a_film_that_the_browser_cannot_decode_is_told(page: Page, stack: Stack, films: str) -> None:
    page.route("**/films/*", lambda route: route.fulfill(body=b"no film", content_type="video/mp4"))
    open_film(page, stack, films)
    expect(page.locator("#lasso-said")).to_contain_text("This browser cannot show the video")
    page.unroute("**/films/*")
    page.get_by_role("button", name="The next photo").click()
    await_data(page, photo=key_frame("back.webm", 10))
    expect(page.locator("#lasso-said")).to_have_text("")
