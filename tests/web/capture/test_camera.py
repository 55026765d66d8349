"""The camera in the page, on a film of somebody who walks around a thing: real photos, with steps, rests and faults."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from capture2vr.edge.arrays import Bytes
from capture2vr.gateway.jobs.capture_objects import capture_name
from tests.support.chromium import launch_with_camera
from tests.support.pages import await_data
from tests.support.photos.camera_films import middle_of, rest, step, view_of, write_film
from tests.support.sites import Site
from tests.web.conftest import PATIENCE_MS, without_a_past

pytestmark = [pytest.mark.browser, pytest.mark.data]

VIEWS = (1, 3, 4, 9, 13)  # of the photos of fruit, each a step or more from the one before


@dataclass(frozen=True, slots=True)
class Walk:
    """A film, and the views (HEIGHT,WIDTH,3) in it where the camera rests and nothing is wrong."""

    film: Path
    views: tuple[Bytes, ...]


@pytest.fixture(scope="module")
def walk(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Five views with steps between them; the camera finds its focus late in the last one, and ends in the dark."""
    photos = sorted((data_dir / "photos_fruit" / "images").iterdir())
    views = [view_of(photos[number]) for number in VIEWS]
    rng = np.random.default_rng(0)
    frames: list[Bytes] = []
    for view, following in pairwise(views):
        frames += [*rest(view, 2.2, rng), *step(view, following, rng)]
    frames += rest(cv2.GaussianBlur(views[-1], (0, 0), 5), 2.0, rng)
    frames += rest(views[-1], 4.0, rng)
    frames += rest((views[-1] * 0.05).astype(np.uint8), 1.5, rng)
    film = write_film(tmp_path_factory.mktemp("films") / "walk.y4m", frames)
    return Walk(film, tuple(map(middle_of, views)))


@pytest.fixture(scope="module")
def camera_browser(browser: Browser, walk: Walk) -> Iterator[Browser]:
    """A browser with a camera that shows the walk."""
    with launch_with_camera(browser, walk.film) as opened:
        yield opened


@pytest.fixture
def page(camera_browser: Browser) -> Iterator[Page]:
    """A phone's page, whose scripts must not fail."""
    with without_a_past(camera_browser, {"width": 390, "height": 844}, has_touch=True) as context:
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page
        assert errors == []


def open_camera(page: Page, url: str) -> None:
    page.goto(url)
    page.get_by_role("button", name="Guided camera").click()
    await_data(page, camera="open")


def await_taken(page: Page, count: int) -> None:
    page.wait_for_function("count => Number(document.body.dataset.taken) >= count", arg=count, timeout=3 * PATIENCE_MS)


def sent_photos(page: Page, site: Site, name: str) -> list[Bytes]:
    """Send what the page has, and return the pictures that the gateway has stored, in their order."""
    page.locator("#name").fill(name)
    with page.expect_response("**/v1/captures") as answer:
        page.get_by_role("button", name="Send").click()
    with zipfile.ZipFile(io.BytesIO(site.store.get(capture_name(answer.value.json()["capture"])))) as archive:
        return [np.asarray(Image.open(archive.open(each)).convert("RGB")) for each in sorted(archive.namelist())]


def small(picture: Bytes) -> np.ndarray:
    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (96, 72), interpolation=cv2.INTER_AREA).astype(np.float32)


def view_in(photo: Bytes, walk: Walk) -> int:
    """Which view a photo shows, and shows as sharply; -1: none."""
    differences = [float(np.abs(small(photo) - small(view)).mean()) for view in walk.views]
    best = int(np.argmin(differences))
    sharp = [cv2.Laplacian(picture, cv2.CV_32F).var() for picture in (photo, walk.views[best])]
    return best if differences[best] < 8 and sharp[0] > 0.5 * sharp[1] else -1


def test_photos_are_taken_where_the_phone_rests_and_blurred_ones_again(page: Page, site: Site, walk: Walk) -> None:
    open_camera(page, site.url)
    expect(page.locator("#automatic")).to_have_attribute("aria-pressed", "true")
    page.wait_for_function("() => document.body.dataset.refused?.startsWith('Blurred')", timeout=3 * PATIENCE_MS)
    expect(page.locator("#cue")).to_contain_text("Not kept. Blurred")
    await_taken(page, 5)
    page.get_by_role("button", name="Done").click()
    await_data(page, camera="closed", looked="5")
    expect(page.locator("#count")).to_have_text("5 photos")
    expect(page.locator("#faulty")).to_be_hidden()
    shown = [view_in(photo, walk) for photo in sent_photos(page, site, "Fruit")]
    assert sorted(shown) == [0, 1, 2, 3, 4], "each view once, none of a step, none blurred or dark"


def test_by_hand_a_photo_is_taken_on_a_tap_and_copies_are_refused(page: Page, site: Site) -> None:
    open_camera(page, site.url)
    page.get_by_role("button", name="Auto").click()
    expect(page.locator("#automatic")).to_have_attribute("aria-pressed", "false")
    shutter = page.get_by_role("button", name="Take a photo")
    expect(shutter).to_be_enabled()
    before = page.evaluate("() => Number(document.body.dataset.taken)")
    while not (page.get_attribute("body", "data-refused") or "").startswith("Shows the same"):  # the film begins again
        shutter.click()
        expect(shutter).to_be_enabled()
    expect(page.locator("#cue")).to_contain_text("Not kept. Shows the same as")
    assert page.evaluate("() => Number(document.body.dataset.taken)") >= max(1, before)
    expect(page.locator("#cue")).to_contain_text("use the button")
    page.keyboard.press("Escape")
    await_data(page, camera="closed")
    assert page.locator("#viewfinder").evaluate("video => video.srcObject === null"), "the camera's light goes out"
    expect(page.locator("#name")).to_have_value("")


@pytest.mark.parametrize(
    "lacking", ["delete window.ImageCapture", "ImageCapture.prototype.takePhoto = async () => { throw 1; }"]
)
def test_a_camera_that_takes_no_photos_gives_frames_of_its_film(
    page: Page, site: Site, walk: Walk, lacking: str
) -> None:
    page.add_init_script(lacking)
    open_camera(page, site.url)
    await_taken(page, 1)
    page.get_by_role("button", name="Done").click()
    photos = sent_photos(page, site, "Frames")
    assert view_in(photos[0], walk) >= 0


def test_a_photo_that_takes_long_is_refused_when_the_phone_moves_meanwhile(page: Page, site: Site) -> None:
    page.add_init_script(
        """
        const { takePhoto } = ImageCapture.prototype;
        ImageCapture.prototype.takePhoto = async function (...settings) {
          while (document.body.dataset.cue === 'take') await new Promise((resolve) => setTimeout(resolve, 20));
          return takePhoto.apply(this, settings);
        };
        """
    )
    open_camera(page, site.url)
    page.wait_for_function("() => document.body.dataset.refused?.startsWith('You moved while it was taken.')")


def test_light_and_locks_are_offered_where_the_camera_has_them(page: Page, site: Site) -> None:
    open_camera(page, site.url)
    for name in ("torch", "lock"):
        expect(page.locator(f"#{name}")).to_be_hidden()
    page.add_init_script(
        """
        window.wishes = [];
        MediaStreamTrack.prototype.getCapabilities = () => (
          { torch: true, exposureMode: ['continuous', 'manual'], whiteBalanceMode: ['continuous'] }
        );
        MediaStreamTrack.prototype.applyConstraints = async ({ advanced }) => { wishes.push(...advanced); };
        """
    )
    open_camera(page, site.url)
    for name in ("Light", "Lock exposure"):
        for pressed in ("true", "false"):
            page.get_by_role("button", name=name).click()
            expect(page.get_by_role("button", name=name)).to_have_attribute("aria-pressed", pressed)
    wishes = page.evaluate("() => wishes")
    assert wishes == [{"torch": True}, {"torch": False}, {"exposureMode": "manual"}, {"exposureMode": "continuous"}]


def test_without_https_there_is_a_sentence_and_files_can_be_chosen(page: Page, site: Site, tmp_path: Path) -> None:
    page.goto(site.url.replace("127.0.0.1", "camera.local"))
    page.get_by_role("button", name="Guided camera").click()
    expect(page.get_by_role("alert")).to_contain_text("Browsers open the camera only for pages with an https address.")
    expect_choice_works(page, tmp_path)


def expect_choice_works(page: Page, folder: Path) -> None:
    """A sentence says what to do instead, and a file can be chosen."""
    expect(page.get_by_role("alert")).to_contain_text("Take the photos with the phone’s own camera instead")
    Image.new("RGB", (64, 48), "teal").save(folder / "one.jpg")
    page.locator("#files").set_input_files(folder / "one.jpg")
    expect(page.locator("#chosen")).to_contain_text("1 file")
    expect(page.get_by_role("button", name="Send")).to_be_enabled()


def test_without_permission_there_is_a_sentence_and_files_can_be_chosen(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    with launch_with_camera(browser, None) as refusing, without_a_past(refusing) as context:
        page = context.new_page()
        page.goto(site.url)
        page.get_by_role("button", name="Guided camera").click()
        expect(page.get_by_role("alert")).to_contain_text("This page is not allowed to use the camera.")
        expect_choice_works(page, tmp_path)


def test_without_a_camera_there_is_a_sentence_and_files_can_be_chosen(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    with without_a_past(browser) as context:
        page = context.new_page()
        page.goto(site.url)
        page.get_by_role("button", name="Guided camera").click()
        expect(page.get_by_role("alert")).to_contain_text("No camera was found.")
        expect_choice_works(page, tmp_path)


def test_the_compass_fills_the_ring_and_a_camera_that_stops_is_said(page: Page, site: Site) -> None:
    """A phone that is turned slowly all the time, until its camera is taken away."""
    page.add_init_script(
        """
        let alpha = 360;
        setInterval(() => {
          alpha = (alpha + 359.5) % 360;
          for (const kind of ['deviceorientation', 'deviceorientationabsolute']) {
            window.dispatchEvent(new DeviceOrientationEvent(kind, { alpha, beta: 80, gamma: 0 }));
          }
        }, 50);
        """
    )
    open_camera(page, site.url)
    expect(page.locator("#looking")).to_be_visible()
    await_taken(page, 3)
    page.evaluate("() => viewfinder.srcObject.getVideoTracks()[0].dispatchEvent(new Event('ended'))")
    await_data(page, camera="closed")
    expect(page.get_by_role("alert")).to_contain_text("The camera has stopped.")
    expect(page.locator("#seen")).to_contain_text("by the compass")
