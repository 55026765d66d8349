"""What the capture page says of photos and films as they are chosen, and which photos the job page says were used."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import BrowserContext, Page, Route, expect

from capture2vr.cli.up import Stack
from tests.support.pages import await_data

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 640, 480
STEP = 60  # pixels from photo to photo


def wall(columns: int) -> np.ndarray:
    """(HEIGHT,columns,3) uint8 with detail of all sizes."""
    rng = np.random.default_rng(3)
    cells = [(HEIGHT // cell + 2, columns // cell + 2, 3) for cell in (4, 12, 40, 120)]
    tones = sum(cv2.resize(rng.normal(size=size), (columns, HEIGHT), interpolation=cv2.INTER_CUBIC) for size in cells)
    return np.clip(128 + 28 * np.asarray(tones), 0, 255).astype(np.uint8)


WALL = wall(WIDTH + 40 * STEP)


def view(number: int) -> np.ndarray:
    return WALL[:, number * STEP : number * STEP + WIDTH]


def save(folder: Path, name: str, rgb: np.ndarray, quality: int = 92) -> Path:
    path = folder / name
    Image.fromarray(rgb.astype(np.uint8)).save(path, quality=quality)
    return path


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A walk along a wall, ten good ones."""
    folder = tmp_path_factory.mktemp("photos")
    return [save(folder, f"good_{number:02}.jpg", view(3 * number)) for number in range(10)]


SPOILT: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "smeared": (lambda rgb: cv2.blur(rgb, (17, 1)), "Blurred"),
    "soft": (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 5), "Blurred"),
    "night": (lambda rgb: rgb * 0.06, "Almost black"),
    "glare": (lambda rgb: np.clip(rgb * 3.0 + 100, 0, 255), "plain white"),
}


def choose(page: Page, *paths: Path, button: str = "Choose files") -> None:
    with page.expect_file_chooser() as chooser:
        page.get_by_text(button, exact=True).click()
    chooser.value.set_files(list(paths))


def looked(page: Page, count: int) -> None:
    await_data(page, looked=str(count))


def degrees(page: Page) -> int:
    found = re.search(r"bout (\d+)° seen", page.locator("#seen").inner_text())
    assert found
    return int(found[1])


def test_good_photos_are_counted_and_none_is_blamed(page: Page, stack: Stack, photos: list[Path]) -> None:
    page.goto(stack.url)
    choose(page, *photos)
    looked(page, 10)
    expect(page.locator("#count")).to_have_text("10 photos")
    expect(page.locator("#advice")).to_contain_text("5 more")
    expect(page.locator("#faulty")).to_be_hidden()
    expect(page.locator("#seen")).to_contain_text("a guess from")
    assert degrees(page) > 200


@pytest.mark.essential
def test_spoilt_photos_are_named_with_their_reasons(
    page: Page, stack: Stack, photos: list[Path], tmp_path: Path
) -> None:
    bad = [save(tmp_path, f"{name}.jpg", spoil(view(31).astype(np.float32))) for name, (spoil, _) in SPOILT.items()]
    page.goto(stack.url)
    choose(page, *photos[:5], *bad, *photos[5:])
    looked(page, 14)
    expect(page.locator("#faults li")).to_have_count(4)
    for name, (_, reason) in SPOILT.items():
        fault = page.locator("#faults li", has_text=f"{name}.jpg")
        expect(fault).to_contain_text(reason)
        assert fault.locator("img").evaluate("image => image.decode().then(() => image.naturalWidth)") == 96


def test_copies_add_nothing_and_can_be_removed_by_keyboard(
    page: Page, stack: Stack, photos: list[Path], tmp_path: Path
) -> None:
    copies = [save(tmp_path, f"copy_{quality}.jpg", view(3), quality) for quality in (50, 80)]
    page.goto(stack.url)
    choose(page, *photos)
    looked(page, 10)
    before = degrees(page)
    choose(page, *photos, *copies)
    looked(page, 12)
    assert degrees(page) <= before + 10
    expect(page.locator("#faults li")).to_have_count(2)
    expect(page.locator("#faults")).to_contain_text("the same as good_01.jpg")
    page.get_by_role("button", name="Remove copy_50.jpg").press("Enter")
    expect(page.locator("#count")).to_have_text("11 photos")
    expect(page.get_by_role("button", name="Remove copy_80.jpg")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#faulty")).to_be_hidden()
    expect(page.locator("#guide")).to_be_focused()
    expect(page.locator("#chosen")).to_contain_text("10 files")


def test_more_photos_are_added_and_all_faulty_ones_removed_at_once(
    page: Page, stack: Stack, photos: list[Path], tmp_path: Path
) -> None:
    page.goto(stack.url)
    choose(page, *photos)
    choose(page, save(tmp_path, "image.jpg", view(1) * 0.06), button="Take photos")
    choose(page, save(tmp_path, "other.jpg", view(2) * 0.06), button="Take photos")
    looked(page, 12)
    expect(page.locator("#faulty-count")).to_have_text("2 photos may do harm")
    page.get_by_role("button", name="Remove all of these").click()
    expect(page.locator("#count")).to_have_text("10 photos")


def test_what_the_browser_cannot_show_is_left_to_the_server(page: Page, stack: Stack, tmp_path: Path) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + bytes(100))
    page.goto(stack.url)
    choose(page, tmp_path / "IMG_1.HEIC")
    expect(page.locator("#advice")).to_contain_text("1 cannot be looked at in this browser")
    expect(page.locator("#faulty")).to_be_hidden()


def test_scans_are_not_guided(page: Page, stack: Stack, photos: list[Path], tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("{}")
    page.goto(stack.url)
    choose(page, *photos, tmp_path / "transforms.json")
    expect(page.locator("#chosen")).to_contain_text("11 files")
    expect(page.locator("#guide")).to_be_hidden()


def test_the_page_goes_on_while_photos_are_looked_at(page: Page, stack: Stack, tmp_path: Path) -> None:
    """Large photos cost the page's own thread a fifth of the CPU time that they cost it without a worker."""
    large = cv2.resize(WALL, (4000, 3000))
    paths = [save(tmp_path, f"large_{number}.jpg", np.roll(large, 300 * number, axis=1)) for number in range(4)]
    devtools = page.context.new_cdp_session(page)
    devtools.send("Performance.enable", {"timeDomain": "threadTicks"})  # CPU time, which other programs do not lengthen

    def worked_s() -> float:
        told = {each["name"]: each["value"] for each in devtools.send("Performance.getMetrics")["metrics"]}
        return float(told["TaskDuration"] - told["DevToolsCommandDuration"])

    def look_s() -> float:
        page.goto(stack.url)
        began = worked_s()
        choose(page, *paths)
        looked(page, 4)
        return worked_s() - began

    with_worker = look_s()
    page.add_init_script("delete window.OffscreenCanvas")
    assert with_worker < 0.5 * look_s()


@pytest.mark.parametrize("lost", ["canvas", "script"])
def test_without_a_worker_photos_are_seen_all_the_same(page: Page, stack: Stack, photos: list[Path], lost: str) -> None:
    if lost == "canvas":
        page.add_init_script("delete window.OffscreenCanvas")
    else:
        page.route("**/photo-quality-worker.js", lambda route: route.abort())
    page.goto(stack.url)
    choose(page, *photos)
    looked(page, 10)
    choose(page, photos[0], button="Take photos")
    looked(page, 11)
    expect(page.locator("#faults")).to_contain_text("the same as good_00.jpg")


def test_the_compass_is_asked_on_a_tap_and_fills_the_ring(
    context: BrowserContext, page: Page, stack: Stack, photos: list[Path]
) -> None:
    """A phone that is held upright and turned by a quarter of a circle from photo to photo."""
    page.add_init_script(
        """
        window.asked = 0;
        DeviceOrientationEvent.requestPermission = async () => { window.asked++; return 'granted'; };
        window.alpha = 0;
        setInterval(() => {
          for (const kind of ['deviceorientation', 'deviceorientationabsolute']) {
            window.dispatchEvent(new DeviceOrientationEvent(kind, { alpha: window.alpha, beta: 80, gamma: 0 }));
          }
        }, 50);
        """
    )
    page.goto(stack.url)
    assert page.evaluate("window.asked") == 0
    page.get_by_role("button", name="Use the compass").click()
    expect(page.get_by_role("button", name="The compass is used")).to_be_disabled()
    assert page.evaluate("window.asked") == 1
    for number in range(4):
        page.evaluate(f"window.alpha = {90 * number}")
        choose(page, photos[number], button="Take photos")
        expect(page.locator("#count")).to_have_text("1 photo" if number == 0 else f"{number + 1} photos")
    looked(page, 4)
    expect(page.locator("#seen")).to_contain_text("by the compass")
    assert degrees(page) == 100  # four photos, 24 degrees each, rounded
    assert page.locator("#guide .arcs circle").count() == 5  # that to the north lies on both ends


def test_a_film_is_offered_and_explained(page: Page, stack: Stack, photos: list[Path], tmp_path: Path) -> None:
    page.goto(stack.url)
    film = page.locator("#film")
    assert (film.get_attribute("accept"), film.get_attribute("capture")) == ("video/*", "environment")
    page.get_by_text("How to walk around it").click()
    expect(page.get_by_text("the same walk in 20 to 60 seconds, slowly")).to_be_visible()
    (tmp_path / "walk.mp4").write_bytes(bytes(1000))
    choose(page, tmp_path / "walk.mp4", button="Take a video")
    expect(page.locator("#count")).to_have_text("1 video")
    expect(page.locator("#ring")).to_be_hidden()
    choose(page, photos[0], button="Take photos")
    choose(page, photos[1], button="Take photos")
    choose(page, photos[2], button="Take photos")
    expect(page.locator("#advice")).to_contain_text("the video is not used")


def cancel_job(page: Page) -> None:
    """Cancel the job, and wait until it has ended: the next test's job needs its place."""
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("alert")).to_contain_text("The job was cancelled.")


def test_a_film_goes_through_gateway_and_worker(page: Page, stack: Stack, tmp_path: Path) -> None:
    path = tmp_path / "walk.mp4"
    with av.open(str(path), "w") as container:
        container.metadata["location"] = "+48.137154+011.575490/"
        stream = container.add_stream("libx264", rate=30, options={"preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(60):
            rgb = np.ascontiguousarray(WALL[:, 12 * number : 12 * number + WIDTH])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    page.goto(stack.url)
    choose(page, path, button="Take a video")
    with page.expect_response(re.compile("/v1/captures$|/capture$")) as answer:
        page.get_by_role("button", name="Send").click()
    receipt = answer.value.json()
    assert (receipt["kind"], receipt["format"], receipt["inspected"]) == ("photos", "video", True)
    assert receipt["frames"] > 3
    assert receipt["files"][0]["stripped"]
    cancel_job(page)


def test_files_that_were_left_out_are_named_with_the_reason(
    page: Page, stack: Stack, photos: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "1.nef").write_bytes(b"II*\0" + bytes(400))
    page.goto(stack.url)
    choose(page, *photos[:3], tmp_path / "1.nef")
    page.get_by_role("button", name="Send").click()
    page.get_by_text("What was removed from your files, or left out").click()
    expect(page.locator("#stripped")).to_contain_text("1.nef: left out: raw photos are not read")
    cancel_job(page)


@pytest.mark.data
def test_twenty_real_photos_are_guided_and_sent(page: Page, stack: Stack, data_dir: Path) -> None:
    page.goto(stack.url)
    choose(page, *sorted((data_dir / "photos_fruit" / "images").iterdir()))
    looked(page, 20)
    expect(page.locator("#advice")).to_have_text("A good number.")
    expect(page.locator("#faulty")).to_be_hidden()
    with page.expect_response(re.compile("/v1/captures$|/capture$")) as answer:
        page.get_by_role("button", name="Send").click()
    receipt = answer.value.json()
    assert (receipt["kind"], receipt["frames"]) == ("photos", 20)
    assert all("BodySerialNumber" in file["stripped"] for file in receipt["files"])
    cancel_job(page)


def test_the_job_page_tells_which_photos_were_used(page: Page, stack: Stack) -> None:
    """A job that is done, as the gateway tells it; the manifest's verdicts and advice are the worker's."""
    verdicts = [{"name": f"{number}.jpg", "verdict": "ok", "advice": ""} for number in range(18)]
    verdicts += [{"name": "19.jpg", "verdict": "blur", "advice": "It is blurred; hold still while taking it."}]
    verdicts += [{"name": "20.jpg", "verdict": "no_overlap", "advice": "Take one between 18.jpg and 19.jpg."}]
    sides = [{"advice": "Shoot from above: 9% of it is seen too little.", "toward": [0, 1, 0], "share": 0.09}]
    version = {"version": 1, "state": "preview"}
    job = {"id": "job_1", "state": "SUCCEEDED", "asset_key": "dress", "warnings": [], "preview": None, "asset": version}
    told = {
        "/v1/jobs/job_1": job,
        "/v1/assets/dress": {**version, "key": "dress", "manifest": {"url": "/told/manifest.json"}, "lods": []},
        "/told/manifest.json": {"quality": {}, "capture": {"kind": "rgbd", "photos": verdicts, "unseen": sides}},
    }

    def tell(path: str) -> Callable[[Route], None]:
        return lambda route: route.fulfill(json=told[path])

    for path in told:
        page.route(f"**{path}", tell(path))
    page.goto(f"{stack.url}/#job=job_1")
    used = page.locator("#used")
    expect(used.locator("summary")).to_have_text("Used 18 of 20 photos")
    used.locator("summary").click()
    expect(used.locator("li")).to_have_count(20)
    expect(used.locator("li").first).to_have_text("19.jpg blurred. It is blurred; hold still while taking it.")
    expect(used.locator("li").nth(1)).to_contain_text("no overlap. Take one between")
    expect(used.locator("li").nth(2)).to_have_text("0.jpg used")
    expect(page.locator("#unseen li")).to_have_text([sides[0]["advice"]])
    expect(page.locator("#unseen li")).to_be_visible()
