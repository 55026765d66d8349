"""More photos of a thing that is there: they are added to those that are stored, and its next version is made."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, Route, expect

from capture2vr.gateway.jobs.capture_objects import capture_name
from capture2vr.storage.catalogue.publish import publish
from tests.support.lines import line_to
from tests.support.pages import await_data
from tests.support.sites import Site
from tests.support.things import RED, box
from tests.web.conftest import with_a_past

pytestmark = pytest.mark.browser


def photos(folder: Path, *names: str) -> list[Path]:
    paths = [folder / name for name in names]
    folder.mkdir()
    for number, path in enumerate(paths):
        rgb = np.random.default_rng(number).integers(0, 256, (240, 320, 3), np.uint8)
        Image.fromarray(rgb).save(path)
    return paths


def made(site: Site, key: str, paths: list[Path]) -> dict[str, Any]:
    """A job whose asset is published, of a capture of these photos."""
    files = [("files", (path.name, path.read_bytes())) for path in paths]
    capture = httpx.post(f"{site.url}/v1/captures", files=files).json()["capture"]
    order = {"capture": capture, "asset_key": key, "label": "A cup", "edits": {"up": [0, 1, 0]}}
    job: dict[str, Any] = httpx.post(f"{site.url}/v1/jobs", json=order).json()
    publish(box("A cup", RED), site.store, key=key, job=job["id"])
    return job


def newest(site: Site, key: str) -> dict[str, Any]:
    jobs = httpx.get(f"{site.url}/v1/jobs").json()["jobs"]
    found: dict[str, Any] = next(job for job in jobs if job["asset_key"] == key)
    return found


def stored(site: Site, job: dict[str, Any]) -> list[str]:
    with zipfile.ZipFile(io.BytesIO(site.store.get(capture_name(job["capture"])))) as archive:
        return archive.namelist()


@pytest.mark.essential
def test_photos_are_added_and_the_next_version_is_made(page: Page, site: Site, tmp_path: Path) -> None:
    job = made(site, "cup", photos(tmp_path / "first", "1.jpg", "2.jpg"))
    page.goto(f"{site.url}/#add={job['id']}")
    expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
    expect(page.locator("#more-lost")).to_contain_text("does not carry over")
    expect(page.locator("#details")).to_be_hidden()
    page.locator("#files").set_input_files(photos(tmp_path / "more", "2.jpg"))
    expect(page.locator("#advice")).to_have_text("They are added to the photos that are stored.")
    expect(page.locator("#which")).to_be_hidden()
    page.get_by_role("button", name="Send").click()
    page.wait_for_url("**/#job=*")
    again = newest(site, "cup")
    assert again["id"] != job["id"]
    assert (again["label"], stored(site, again)) == ("A cup", ["1.jpg", "2-2.jpg", "2.jpg"])
    assert stored(site, job) == ["1.jpg", "2.jpg"], "what was stored stays"


def test_a_thing_that_is_gone_and_what_is_no_photo_are_said(page: Page, site: Site, tmp_path: Path) -> None:
    page.goto(f"{site.url}/#add=job_0")
    expect(page.get_by_role("alert")).to_contain_text("job_0")
    job = made(site, "jug", photos(tmp_path / "first", "1.jpg"))
    page.goto(f"{site.url}/#add={job['id']}")
    page.reload()
    scan = tmp_path / "scan.ply"
    scan.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    page.locator("#files").set_input_files(scan)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("alert")).to_contain_text("scan.ply")
    expect(page.get_by_role("alert")).to_contain_text("only captures of photos alone can be continued")


def test_who_sends_before_the_page_knows_the_thing_adds_to_it_all_the_same(
    page: Page, site: Site, tmp_path: Path
) -> None:
    job = made(site, "mug", photos(tmp_path / "first", "1.jpg"))
    lost: list[Route] = []
    page.route(f"**/v1/jobs/{job['id']}", lambda route: route.continue_() if lost else lost.append(route))
    page.goto(f"{site.url}/#add={job['id']}")
    page.locator("#files").set_input_files(photos(tmp_path / "more", "2.jpg"))
    page.get_by_role("button", name="Send").click()
    await_data(page, state="sending")
    lost[0].abort()
    page.wait_for_url("**/#job=*")
    assert stored(site, newest(site, "mug")) == ["1.jpg", "2.jpg"]


def test_without_a_server_they_are_kept_and_added_later(browser: Browser, site: Site, tmp_path: Path) -> None:
    line = line_to(site.url)
    job = made(site, "pot", photos(tmp_path / "first", "1.jpg"))
    with with_a_past(browser) as context:
        page = context.new_page()
        page.goto(f"{line.url}/#add={job['id']}")
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
        line.cut()
        page.locator("#files").set_input_files(photos(tmp_path / "more", "2.jpg"))
        page.get_by_role("button", name="Send").click()
        expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
        page.close()
        line.mend()
        page = context.new_page()
        page.goto(line.url)
        await_data(page, kept="sent")
    again = newest(site, "pot")
    assert again["id"] != job["id"]
    assert stored(site, again) == ["1.jpg", "2.jpg"]


def take_and_leave(context: BrowserContext, url: str, photo: Path) -> None:
    page = context.new_page()
    page.goto(url)
    if "#add" in url:
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
    page.locator("#photos").set_input_files(photo)
    await_data(page, looked="1", onDevice="yes")
    page.close()


def test_photos_that_were_taken_for_a_thing_and_not_sent_are_added_to_it_later(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    job = made(site, "bottle", photos(tmp_path / "first", "1.jpg"))
    with with_a_past(browser) as context:
        take_and_leave(context, f"{site.url}/#add={job['id']}", photos(tmp_path / "more", "2.jpg")[0])
        page = context.new_page()
        page.goto(site.url)
        expect(page.locator("#kept-list li")).to_contain_text("A cup: 1 photo of")
        page.get_by_role("button", name="Go on").click()
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
        await_data(page, looked="1", kept="")
        page.get_by_role("button", name="Send", exact=True).click()
        page.wait_for_url("**/#job=*")
    again = newest(site, "bottle")
    assert again["id"] != job["id"]
    assert stored(site, again) == ["1.jpg", "2.jpg"]


def test_who_takes_photos_before_the_page_knows_the_thing_finds_them_with_it_later(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    job = made(site, "vial", photos(tmp_path / "first", "1.jpg"))
    with with_a_past(browser) as context:
        page = context.new_page()
        page.route(f"**/v1/jobs/{job['id']}", lambda route: None)  # never answered
        page.goto(f"{site.url}/#add={job['id']}")
        page.locator("#photos").set_input_files(photos(tmp_path / "more", "2.jpg"))
        await_data(page, looked="1", onDevice="yes")
        page.close()
        page = context.new_page()
        page.goto(site.url)
        page.get_by_role("button", name="Go on").click()
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
        await_data(page, looked="1", kept="")


def test_photos_of_another_thing_leave_the_one_that_photos_are_added_to(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    job = made(site, "vase", photos(tmp_path / "first", "1.jpg"))
    with with_a_past(browser) as context:
        take_and_leave(context, site.url, photos(tmp_path / "more", "2.jpg")[0])
        page = context.new_page()
        page.goto(f"{site.url}/#add={job['id']}")
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_visible()
        page.get_by_role("button", name="Go on").click()
        await_data(page, looked="1", kept="")
        expect(page.get_by_role("heading", name="More photos of A cup")).to_be_hidden()
        page.locator("#name").fill("A fork")
        page.get_by_role("button", name="Send", exact=True).click()
        page.wait_for_url("**/#job=*")
    assert stored(site, newest(site, "A-fork")) == ["2.jpg"]
    assert newest(site, "vase")["id"] == job["id"]


def test_photos_for_a_thing_that_is_gone_can_make_a_new_one(browser: Browser, site: Site, tmp_path: Path) -> None:
    job = made(site, "tin", photos(tmp_path / "first", "1.jpg"))
    with with_a_past(browser) as context:
        take_and_leave(context, f"{site.url}/#add={job['id']}", photos(tmp_path / "more", "2.jpg")[0])
        page = context.new_page()
        gone = {"status": 404, "code": "JOB_UNKNOWN", "detail": "there is no such job"}
        page.route(f"**/v1/jobs/{job['id']}", lambda route: route.fulfill(status=404, json=gone))
        page.goto(site.url)
        page.get_by_role("button", name="Go on").click()
        expect(page.get_by_role("alert")).to_contain_text("there is no such job")
        await_data(page, looked="1")
        page.get_by_role("button", name="Choose again").click()
        page.get_by_role("button", name="Go on").click()
        await_data(page, looked="1", kept="", state="choosing")
        expect(page.locator("#details")).to_be_visible()


@pytest.mark.parametrize(("form", "offered"), [("photos", True), ("photo", True), ("video", False), ("ply", False)])
def test_photos_can_be_added_where_a_capture_has_photos(page: Page, site: Site, form: str, offered: bool) -> None:
    """A job that is done, as the gateway tells it."""
    version = {"version": 1, "state": "preview"}
    job = {"id": "job_1", "state": "SUCCEEDED", "asset_key": "dress", "label": "A dress", "warnings": []}
    job |= {"preview": None, "asset": version, "capture": "cap_1", "links": {"again": "/v1/jobs/job_1/again"}}
    sides = [{"advice": "Shoot from above: 9% of it is seen too little."}]
    told = {
        "/v1/jobs/job_1": job,
        "/v1/assets/dress": {**version, "key": "dress", "manifest": {"url": "/told/manifest.json"}, "lods": []},
        "/told/manifest.json": {"quality": {}, "capture": {"format": form, "unseen": sides}},
    }

    def tell(route: Route) -> None:
        route.fulfill(json=told[route.request.url.removeprefix(site.url)])

    for path in told:
        page.route(f"**{path}", tell)
    page.goto(f"{site.url}/#job=job_1")
    expect(page.locator("#certificate")).to_be_hidden()
    expect(page.locator("#unseen li")).to_have_text([sides[0]["advice"]])
    button = page.get_by_role("button", name="Add photos")
    expect(button).to_be_visible(visible=offered)
    if offered:
        button.click()
        expect(page.get_by_role("heading", name="More photos of A dress")).to_be_visible()
        expect(page.locator("#more-unseen li")).to_have_text([sides[0]["advice"]])
        expect(page.locator("#missing")).to_have_text(sides[0]["advice"])
