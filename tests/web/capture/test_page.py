"""The capture page, by what a person clicks."""

from __future__ import annotations

import json
import re
import time
import urllib.request
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from capture2vr.cli.up import Stack
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data
from tests.support.patience import PATIENCE_S
from tests.support.screenshots import await_frames, difference, drawn, expect_picture, stage
from tests.support.sites import Site
from tests.support.things import GREEN, RED, box, graded

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def bowl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coloured bowl of 2,000 points, 20 cm wide, as a phone's scanning app would export it."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = -np.abs(direction[:, 1])
    xyz, rgb = direction * 0.1, ((direction * 0.5 + 0.5) * 255).astype(int)
    path = tmp_path_factory.mktemp("captures") / "blue_bowl.ply"
    header = ["ply", "format ascii 1.0", f"element vertex {len(xyz)}"]
    header += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    rows = [" ".join(map(str, [*p, *c])) for p, c in zip(xyz.round(6), rgb, strict=True)]
    path.write_text("\n".join([*header, "end_header", *rows]) + "\n")
    return path


def choose(page: Page, path: Path) -> None:
    with page.expect_file_chooser() as chooser:
        page.get_by_text("Choose files").click()
    chooser.value.set_files(path)
    page.locator("#preset").select_option("quick")  # the automatic choice trains for a minute


@pytest.mark.essential
def test_from_the_phone_to_the_viewer(page: Page, stack: Stack, bowl: Path) -> None:
    page.goto(stack.url)
    expect(page.get_by_role("button", name="Send")).to_be_disabled()
    choose(page, bowl)
    expect(page.locator("#chosen")).to_contain_text("1 file")
    expect(page.locator("#name")).to_have_value("blue bowl")
    page.locator("#name").fill("My blue bowl")
    expect(page.locator("#key")).to_have_text("My-blue-bowl")
    page.get_by_text("Description, tags").click()
    page.get_by_label("A description").fill("Thrown in Wales.\nBlue.")
    page.get_by_label("Tags, with commas").fill("kitchen, , <b>blue</b>")
    page.get_by_label("The collection that lists it").fill("pottery")
    page.get_by_label("For which device").select_option("quest3")
    page.get_by_role("button", name="Send").click()

    await_data(page, state="working")
    assert page.locator("#bar").evaluate("bar => bar.value") < 0.9, "the upload's bar stands for the job's"
    await_data(page, state="done")
    expect(page.locator("body")).to_have_attribute("data-preview", re.compile(r"\d+"))
    canvas = page.locator("#preview")
    canvas.scroll_into_view_if_needed()
    await_frames(page)
    first = canvas.screenshot()
    assert drawn(first) > 0.1
    until = time.monotonic() + PATIENCE_S
    while difference(first, canvas.screenshot()) < 0.01:
        assert time.monotonic() < until, "the preview does not turn"
    expect(page.locator("#link")).to_have_text(f"{stack.url}/view/My-blue-bowl")
    expect_picture(page, "#qr")

    page.get_by_role("link", name="View", exact=True).click()
    expect(page).to_have_url(f"{stack.url}/view/My-blue-bowl")
    expect(page.locator("#label")).to_have_text("My blue bowl")
    expect(page.locator("#description")).to_have_text("Thrown in Wales.\nBlue.")
    assert drawn(stage(page)) > 0.03
    entry = httpx.get(f"{stack.url}/v1/assets/My-blue-bowl").json()
    assert (entry["labels"], entry["collections"]) == (["kitchen", "<b>blue</b>"], ["pottery"])

    with urllib.request.urlopen(f"{stack.url}/v1/assets/My-blue-bowl") as answer:
        entry = json.load(answer)
    assert entry["label"] == "My blue bowl"
    assert max(entry["size_m"]) == pytest.approx(0.2, abs=0.01)


@pytest.mark.essential
def test_a_reloaded_page_goes_on_watching(page: Page, stack: Stack, bowl: Path) -> None:
    page.goto(stack.url)
    choose(page, bowl)
    page.get_by_role("button", name="Send").click()
    page.wait_for_url("**/#job=*")
    page.reload()
    await_data(page, state="done")


def test_a_proxys_error_in_mid_job_does_not_end_the_watching(page: Page, stack: Stack, bowl: Path) -> None:
    refused: list[str] = []

    def refuse_once(route: Route) -> None:
        if refused:
            return route.continue_()
        refused.append(route.request.url)
        return route.fulfill(status=502, body="bad gateway")

    page.route("**/events*", refuse_once)
    page.goto(stack.url)
    choose(page, bowl)
    page.get_by_role("button", name="Send").click()
    await_data(page, state="done")
    assert refused


def test_what_cannot_be_drawn_is_ready_all_the_same(page: Page, stack: Stack, bowl: Path) -> None:
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(stack.url)
    choose(page, bowl)
    page.get_by_role("button", name="Send").click()
    await_data(page, state="done")
    expect(page.locator("#undrawn")).to_be_visible()
    expect(page.get_by_role("alert")).to_be_hidden()
    expect_picture(page, "#qr")


def test_what_is_no_capture_is_told_with_its_name(page: Page, stack: Stack, tmp_path: Path) -> None:
    bad = tmp_path / "not-a-scan.ply"
    bad.write_text("this is a shopping list\n" * 100)
    page.goto(stack.url)
    choose(page, bad)
    page.get_by_role("button", name="Send").click()
    trouble = page.get_by_role("alert")
    expect(trouble).to_be_visible()
    expect(trouble).to_contain_text("not-a-scan.ply")
    page.get_by_role("button", name="Choose again").click()
    await_data(page, state="choosing")


def test_a_name_from_any_script_cannot_break_the_key(page: Page, stack: Stack, bowl: Path) -> None:
    page.goto(stack.url)
    choose(page, bowl)
    page.locator("#name").fill("Éléphant / ../ 象 <b>")
    expect(page.locator("#key")).to_have_text("Elephant-..-b")
    page.locator("#name").fill("象")
    expect(page.get_by_role("button", name="Send")).to_be_disabled()


def test_photos_can_be_taken_and_the_page_fits_a_phone(page: Page, stack: Stack) -> None:
    page.goto(stack.url)
    photos = page.locator("#photos")
    assert photos.get_attribute("capture") == "environment"
    assert photos.get_attribute("accept") == "image/*"
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


# What the page says while a job runs, however briefly.
SAYINGS = """() => {
    const detail = document.getElementById('detail');
    window.sayings = [];
    new MutationObserver(() => sayings.push(detail.textContent)).observe(detail, { childList: true });
}"""


def test_a_training_is_seen_and_its_certificate_read(page: Page, stack: Stack, bowl: Path) -> None:
    page.goto(stack.url)
    choose(page, bowl)
    options = page.locator("#preset option")
    expect(options.first).to_contain_text("Automatic")
    published = page.locator("#preset optgroup[label='Methods from the literature'] option")
    expect(published.filter(has_text="CAP-UDF")).to_contain_text("takes 4 hours to a day on two cores")
    assert "brief" not in " ".join(published.all_text_contents())
    page.locator("#preset").select_option("brief")
    page.locator("#name").fill("trained bowl")
    page.evaluate(SAYINGS)
    page.get_by_role("button", name="Send").click()

    expect(page.locator("#view")).to_be_visible()  # the preview's, while the training goes on
    await_data(page, shown="preview")
    expect(page.locator("#curve")).to_be_visible()
    expect(page.locator("#certificate")).to_contain_text("Pieces")

    await_data(page, state="done")
    assert any("step " in saying for saying in page.evaluate("window.sayings"))
    expect(page.locator("#coming")).to_be_hidden()
    with urllib.request.urlopen(f"{stack.url}/v1/assets/trained-bowl") as answer:
        state = json.load(answer)["state"]
    expect(page.locator("body")).to_have_attribute("data-shown", state)
    page.get_by_text("How good it is").click()
    if state == "refined":
        expect(page.locator("#ready")).to_contain_text("refined")
        expect(page.locator("#figures tr").first).to_have_text("PreviewRefined")
    else:
        expect(page.locator("#warnings")).to_contain_text("the preview was kept")


@pytest.mark.parametrize("ending", ["SUCCEEDED", "FAILED"])
def test_the_points_are_shown_until_there_is_a_mesh(page: Page, stack: Stack, bowl: Path, ending: str) -> None:
    """The time between them is short here, and stretched: the page hears of a mesh only when the test lets it."""
    held = True
    unmade = {"state": "RUNNING", "preview": None, "asset": None}

    def before_the_mesh(route: Route) -> None:
        answer = route.fetch()
        changed = unmade if held else {**unmade, "state": "FAILED"} if ending == "FAILED" else {}
        return route.fulfill(response=answer, json={**answer.json(), **changed})

    def only_to_the_anchors(route: Route) -> None:
        if not held:
            return route.continue_()
        told = route.fetch().text().replace("\r\n", "\n").split("\n\n")  # ends with the job
        events = [each for each in told if "event: progress" in each or "event: anchors" in each]
        return route.fulfill(body="\n\n".join([*events, ""]), content_type="text/event-stream")

    page.route(re.compile(r"/v1/jobs/job_[0-9a-f]+$"), before_the_mesh)
    page.route("**/events*", only_to_the_anchors)
    page.goto(stack.url)
    choose(page, bowl)
    page.locator("#name").fill("pointed bowl")
    page.get_by_role("button", name="Send").click()
    await_data(page, points="512")
    expect(page.locator("#pointed")).to_be_visible()
    expect(page.locator("#ready")).to_be_hidden()
    expect(page.locator("#view")).to_be_hidden()
    page.locator("#preview").scroll_into_view_if_needed()
    await_frames(page)
    assert drawn(page.locator("#preview").screenshot()) > 0.05
    held = False
    if ending == "FAILED":
        await_data(page, state="trouble")
        expect(page.locator("#result")).to_be_hidden()
        return
    await_data(page, state="done")
    expect(page.locator("body")).to_have_attribute("data-preview", re.compile(r"\d+"))
    expect(page.locator("#pointed")).to_be_hidden()
    expect(page.locator("#view")).to_be_visible()


def test_a_failure_behind_the_preview_leaves_it_on_show(page: Page, stack: Stack, bowl: Path) -> None:
    """The worker's story is the page's to tell; a job that fails so is told here by hand."""

    def fail(route: Route) -> None:
        answer = route.fetch()
        job = {**answer.json(), "state": "FAILED", "asset": None}
        if not job["preview"]:
            return route.fulfill(response=answer)
        hints = ["use draft", "the preview stays published, as version 1"]
        job["error"] = {"code": "GPU_OOM", "detail": "the GPU is full", "hints": hints}
        return route.fulfill(response=answer, json=job)

    page.route(re.compile(r"/v1/jobs/job_[0-9a-f]+$"), fail)
    page.goto(stack.url)
    choose(page, bowl)
    page.locator("#name").fill("half done")
    page.get_by_role("button", name="Send").click()
    trouble = page.get_by_role("alert")
    expect(trouble).to_contain_text("the preview stays published")
    expect(page.locator("#view")).to_be_visible()
    expect(page.locator("body")).to_have_attribute("data-preview", re.compile(r"\d+"))


def test_a_bad_capture_is_told_first_and_published_on_a_tap(page: Page, site: Site) -> None:
    """A job that is done, as the gateway tells it."""
    publish(box("An urn", GREEN), site.store, key="urn")
    held = publish(box("An urn", RED, **graded("shoot again")), site.store, key="urn", job="job_1")
    asset = {"version": held.version, "state": "refined", "held": True, **graded("shoot again")["quality"]}
    warning = "Shoot it again: the surface is in shreds. Make it matt."
    job = {"id": "job_1", "state": "SUCCEEDED", "asset_key": "urn", "label": "An urn", "preview": None, "asset": asset}
    job |= {"warnings": [warning, "Its scale is a guess."], "capture": "cap_1", "links": {"again": "/"}}
    page.route("**/v1/jobs/job_1", lambda route: route.fulfill(json=job))
    page.goto(f"{site.url}/#job=job_1")
    await_data(page, preview=str(held.version))
    expect(page.locator("#result h2:visible")).to_have_text("Please shoot again")
    expect(page.locator("#reason-of-grade")).to_have_text("The surface is in shreds. Make it matt.")
    expect(page.locator("#warnings li")).to_have_text(["Its scale is a guess."])
    expect(page.locator("#held-back")).to_have_text("It is held back: version 1 goes on being shown.")
    expect(page.get_by_role("link", name="View")).to_be_hidden()
    assert read_entry(site.store, "urn").version == 1
    page.get_by_role("button", name="Keep it anyway").click()
    expect(page.locator("#held-back")).to_have_text("It is kept: it is published now.")
    expect(page.get_by_role("link", name="View")).to_be_visible()
    expect(page.get_by_role("button", name="Keep it anyway")).to_be_hidden()
    entry = read_entry(site.store, "urn")
    assert (entry.version, entry.manifest, entry.held) == (3, held.manifest, False)
    page.reload()
    await_data(page, preview=str(held.version))
    expect(page.locator("#held")).to_be_hidden()
