"""The edit page: a box cuts a stored capture, in the capture's frame; versions are compared, and one is restored."""

from __future__ import annotations

import io
import json
import re
import time
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import httpx
import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Page, Route, expect

from capture2vr.cli.up import Stack
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from tests.support.clouds import write_ply
from tests.support.pages import await_data, press_twice
from tests.support.patience import PATIENCE_S
from tests.support.screenshots import await_frames
from tests.support.sites import Site

pytestmark = pytest.mark.browser
RADIUS, ABOVE, TABLE = 0.2, 0.5, 1.0
"""In the capture's units: a ball's radius, its middle above a table that reaches so far to every side."""
LONGEST_M = 1.4142 * TABLE
"""The table's diagonal, by which a unit is half a metre."""


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud whose Z axis is up, in units of half a metre: a ball over a table."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(4_000, 3))
    ball = RADIUS * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0, ABOVE]
    table = np.column_stack([rng.uniform(-TABLE, TABLE, (6_000, 2)), np.zeros(6_000)])
    path = tmp_path_factory.mktemp("captures") / "ball.ply"
    rgb = np.repeat([[200, 60, 40], [120, 120, 120]], [4_000, 6_000], axis=0).astype(np.uint8)
    write_ply(path, np.concatenate([ball, table]), rgb=rgb)
    return path


def made(stack: Stack, scan: Path, key: str) -> dict[str, Any]:
    """The job that has made a thing of the scan, once it has ended."""
    with httpx.Client(base_url=stack.url, timeout=PATIENCE_S) as client:
        capture = client.post("/v1/captures", files={"files": (scan.name, scan.read_bytes())}).json()["capture"]
        order = {"capture": capture, "asset_key": key, "preset": "quick", "longest_m": LONGEST_M}
        job = client.post("/v1/jobs", json={**order, "edits": {"up": [0, 0, 1]}}).json()
        deadline = time.monotonic() + PATIENCE_S
        while job["state"] not in ("SUCCEEDED", "FAILED") and time.monotonic() < deadline:
            time.sleep(0.05)
            job = client.get(f"/v1/jobs/{job['id']}").json()
        assert job["state"] == "SUCCEEDED", job
        return dict(job)


@pytest.fixture(scope="module")
def ball(stack: Stack, scan: Path) -> dict[str, Any]:
    return made(stack, scan, "ball")


def recipe_of(page: Page) -> dict[str, Any]:
    """What the link downloads."""
    address = page.locator("#recipe").get_attribute("href") or ""
    recipe: dict[str, Any] = json.loads(unquote(address.partition(",")[2]))
    return recipe


def slide(page: Page, side: str, share: float) -> None:
    slider = page.locator("#box-sides label", has_text=side).locator("input")
    slider.evaluate("(input, value) => { input.value = value; input.dispatchEvent(new Event('input')); }", share)


def open_tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name).click()


def test_a_box_is_saved_compared_downloaded_and_undone(page: Page, stack: Stack, scan: Path, tmp_path: Path) -> None:
    first = made(stack, scan, "cut")
    page.goto(f"{stack.url}/edit/cut")
    await_data(page, state="ready", kept="1.000")
    page.get_by_label("Keep only what is inside a box").check()
    expect(page.get_by_role("button", name="Save as a new version")).to_be_enabled()
    slide(page, "Bottom", 0.3)
    page.wait_for_function("Number(document.body.dataset.kept) < 0.9")
    crop = recipe_of(page)["crop"]
    low = crop["centre"][2] - crop["size"][1] / 2  # the box's second axis is the page's up, the capture's Z
    assert 0.05 < low < ABOVE - RADIUS
    assert crop["size"][0] == pytest.approx(2 * TABLE, rel=0.2), "in the capture's units"

    page.get_by_role("button", name="Save as a new version").click()
    expect(page.locator("#bar")).to_be_visible()
    await_data(page, changed="no", shown="2", kept="1.000")
    document = httpx.get(f"{stack.url}/v1/assets/cut").json()
    assert max(document["size_m"]) == pytest.approx(RADIUS, abs=0.05), "only the ball is left, of half a metre a unit"
    edits = httpx.get(document["manifest"]["url"]).json()["edits"]
    assert (edits["crop"], edits["up"], edits["capture"]) == (crop, [0, 0, 1], first["capture"])
    expect(page.get_by_label("Keep only what is inside a box")).to_be_checked()

    open_tab(page, "Versions")
    page.get_by_role("button", name="Compare: version 1", exact=True).click()
    await_data(page, compared="1")
    expect(page.get_by_label("Where the one version ends")).to_be_visible()
    opened = page.get_by_label("Download: version 1", exact=True)
    opened.press("Enter")
    button = page.get_by_role("list", name="Formats for other programs").get_by_role("button", name="STL")
    expect(button).to_have_accessible_description(re.compile("For 3D printing"))
    with page.expect_download() as saving:
        button.press("Enter")
    assert saving.value.suggested_filename == "cut-v1.stl"
    saving.value.save_as(tmp_path / "cut.stl")
    assert np.ptp(trimesh.load(tmp_path / "cut.stl").vertices, axis=0).max() > 1_000 * TABLE * 0.9, (
        "with the table, in mm"
    )
    expect(page.locator("#download-said")).to_have_text("cut-v1.stl is being saved.")

    page.get_by_role("button", name="Restore: version 1", exact=True).click()
    await_data(page, version=str(document["version"] + 1))
    restored = httpx.get(f"{stack.url}/v1/assets/cut").json()
    assert restored["size_m"] == httpx.get(f"{stack.url}/v1/assets/cut/versions/1").json()["size_m"]
    assert restored["versions"][-1]["restored"] == 1


def test_a_handle_is_dragged(page: Page, stack: Stack, ball: dict[str, Any]) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(f"{stack.url}/edit/{ball['asset_key']}")
    await_data(page, state="ready")
    page.get_by_label("Keep only what is inside a box").check()
    await_data(page, kept="1.000", changed="yes")
    before = recipe_of(page)["crop"]
    x, y = place_of_green(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y + 40, steps=4)
    page.mouse.up()
    after = recipe_of(page)["crop"]
    assert after["size"][1] < before["size"][1] - 0.05, "the side came along"
    assert after["size"][::2] == before["size"][::2], "the others did not"
    bottom = [crop["centre"][2] - crop["size"][1] / 2 for crop in (before, after)]
    assert bottom[0] == pytest.approx(bottom[1], abs=1e-6)


def place_of_green(page: Page) -> tuple[float, float]:
    """Where the handle of the top is on the page: the upper one of the two green ones."""
    pixels = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    green = (pixels[..., 1] > 130) & (pixels[..., 1] > 1.6 * pixels[..., 0]) & (pixels[..., 1] > 1.6 * pixels[..., 2])
    rows, columns = np.nonzero(green)
    top = rows <= rows.min() + 8
    return float(np.median(columns[top])), float(np.median(rows[top]))


def test_planes_up_and_length_are_in_the_frame_of_the_capture(page: Page, stack: Stack, ball: dict[str, Any]) -> None:
    """By keys alone: Enter picks what is at the cross."""
    page.goto(f"{stack.url}/edit/{ball['asset_key']}")
    await_data(page, state="ready")
    assert recipe_of(page)["up"] == pytest.approx([0, 0, 1])

    open_tab(page, "Upright")
    page.get_by_role("button", name="Tip left").click()
    tipped = np.array(recipe_of(page)["up"])
    assert abs(tipped @ [0, 0, 1]) < 1e-6
    page.get_by_role("button", name="Tip right").click()
    assert recipe_of(page)["up"] == pytest.approx([0, 0, 1], abs=1e-6)
    before = recipe_of(page)
    assert "front" not in before
    for _ in range(6):
        page.get_by_role("button", name="Turn left").click()
    assert recipe_of(page)["up"] == pytest.approx([0, 0, 1], abs=1e-6)
    front = np.array(recipe_of(page)["front"])
    assert abs(front @ [0, 0, 1]) < 1e-6, "level"
    for _ in range(6):
        page.get_by_role("button", name="Turn right").click()
    ahead = np.array(recipe_of(page)["front"])
    assert np.cross(ahead, front) == pytest.approx([0, 0, 1], abs=1e-6), "a quarter turn apart"
    page.get_by_role("button", name="As it was found").click()
    assert {"up", "front"}.isdisjoint(recipe_of(page)), "the estimate again"

    open_tab(page, "Size")
    page.get_by_role("button", name="Choose two points").click()
    page.keyboard.press("Enter")
    for _ in range(3):
        page.keyboard.press("Shift+ArrowLeft")
    await_frames(page)
    page.keyboard.press("Enter")
    expect(page.locator("#length-now")).to_contain_text("apart")
    page.get_by_label("in centimetres").fill("30")
    length = recipe_of(page)["length"]
    assert length["metres"] == 0.3
    assert np.linalg.norm(np.subtract(length["start"], length["end"])) > 0.001
    page.get_by_label("in centimetres").fill("0")
    expect(page.get_by_role("button", name="Save as a new version")).to_be_disabled()
    expect(page.locator("#length-now")).to_have_text("A length is from 0.1 centimetres to 100,000.")
    assert "length" not in recipe_of(page)
    page.get_by_label("in centimetres").fill("")
    expect(page.locator("#length-now")).to_contain_text("apart")

    open_tab(page, "Plane")
    page.get_by_role("button", name="Choose a plane").click()
    page.keyboard.press("Enter")
    (plane,) = recipe_of(page)["planes"]
    assert np.linalg.norm(plane["normal"]) == pytest.approx(1, abs=1e-6)
    kept = page.locator("body").get_attribute("data-kept")
    page.get_by_role("button", name="Other side").click()
    assert recipe_of(page)["planes"][0]["normal"] == pytest.approx([-value for value in plane["normal"]], abs=1e-6)
    assert page.locator("body").get_attribute("data-kept") != kept
    page.get_by_role("button", name="Take all edits away").click()
    await_data(page, kept="1.000")
    assert set(recipe_of(page)) == {"schema", "capture"}


def test_a_refusal_is_said_and_nothing_is_lost(page: Page, stack: Stack, ball: dict[str, Any]) -> None:
    problem = {"status": 422, "code": "EDITS_OTHER_CAPTURE", "detail": "edits: of another capture", "hints": ["again"]}

    def refuse(route: Route) -> None:
        route.fulfill(status=422, content_type="application/problem+json", body=json.dumps(problem))

    page.route("**/again", refuse)
    page.goto(f"{stack.url}/edit/{ball['asset_key']}")
    await_data(page, state="ready")
    page.get_by_label("Keep only what is inside a box").check()
    slide(page, "Left", 0.4)
    before = recipe_of(page)
    page.get_by_role("button", name="Save as a new version").click()
    expect(page.locator("#trouble")).to_have_text("Edits: of another capture. Again.")
    assert recipe_of(page) == before

    slide(page, "Bottom", 0.97)
    slide(page, "Left", 0.97)
    expect(page.locator("#said")).to_have_text("Nothing of it is left.")
    expect(page.get_by_role("button", name="Save as a new version")).to_be_disabled()


def test_who_saves_again_before_there_is_an_answer_starts_one_job(
    page: Page, stack: Stack, ball: dict[str, Any]
) -> None:
    keys: list[str] = []

    def lose(route: Route) -> None:
        keys.append(route.request.headers["idempotency-key"])
        route.abort()

    page.route("**/again", lose)
    page.goto(f"{stack.url}/edit/{ball['asset_key']}")
    await_data(page, state="ready")
    page.get_by_label("Keep only what is inside a box").check()
    save = page.get_by_role("button", name="Save as a new version")
    press_twice(save)
    expect(page.locator("#trouble")).to_contain_text("The server cannot be reached.")
    with page.expect_event("requestfailed"):
        save.click()
    assert len(keys) == 2
    assert keys[0] == keys[1]
    slide(page, "Left", 0.4)
    with page.expect_event("requestfailed"):
        save.click()
    assert keys[2] != keys[0], "another recipe"


def test_what_was_made_elsewhere_cannot_be_edited(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="elsewhere")
    page.goto(f"{site.url}/edit/elsewhere")
    await_data(page, state="ready")
    expect(page.locator("#trouble")).to_contain_text("No capture of this object is stored here")
    page.get_by_label("Keep only what is inside a box").check()
    expect(page.get_by_role("button", name="Save as a new version")).to_be_disabled()
    open_tab(page, "Photos")
    expect(page.locator("#trouble")).to_contain_text("No capture of this object is stored here")
    page.goto(f"{site.url}/edit/nothing-here")
    await_data(page, state="error")
    expect(page.locator("#trouble")).to_contain_text("nothing-here")


def test_the_viewer_leads_to_it(page: Page, stack: Stack, ball: dict[str, Any]) -> None:
    page.goto(f"{stack.url}/view/{ball['asset_key']}")
    page.get_by_role("link", name="Edit").click()
    await_data(page, state="ready")
    page.get_by_role("link", name="Back").click()
    page.wait_for_url(f"**/view/{ball['asset_key']}")
