"""What the server would refuse is changed in the form, and what was uploaded is not uploaded again."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from capture2vr.gateway.jobs.capture_objects import capture_name
from capture2vr.storage.catalogue.publish import publish
from tests.support.lines import line_to
from tests.support.pages import await_data
from tests.support.sites import Site
from tests.support.things import RED, box
from tests.web.conftest import with_a_past

pytestmark = pytest.mark.browser


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(paths):
        rgb = np.random.default_rng(number).integers(0, 256, (240, 320, 3), np.uint8)
        Image.fromarray(rgb).save(path)
    return paths


@pytest.fixture
def uploads(page: Page) -> list[str]:
    """The uploads that the page sends."""
    sent: list[str] = []
    page.on("request", lambda each: sent.append(each.url) if each.url.endswith("/v1/captures") else None)
    return sent


def fill(page: Page, photos: list[Path], name: str, collection: str) -> None:
    page.locator("#files").set_input_files(photos)
    page.locator("#name").fill(name)
    page.locator("#more summary").click()
    page.locator("#collection").fill(collection)


def send(page: Page) -> None:
    page.get_by_role("button", name="Send", exact=True).click()


def the_job(site: Site, key: str) -> dict[str, Any]:
    (job,) = (job for job in httpx.get(f"{site.url}/v1/jobs").json()["jobs"] if job["asset_key"] == key)
    found: dict[str, Any] = job
    return found


def files_of(site: Site, job: dict[str, Any]) -> list[str]:
    with zipfile.ZipFile(io.BytesIO(site.store.get(capture_name(job["capture"])))) as archive:
        return archive.namelist()


def test_a_field_that_cannot_be_sent_is_shown_before_anything_is_uploaded(
    page: Page, site: Site, photos: list[Path], uploads: list[str]
) -> None:
    page.goto(site.url)
    fill(page, photos, "Coat", "Mein Schrank")
    page.locator("#more summary").click()
    expect(page.locator("#collection")).to_be_hidden()
    send(page)
    expect(page.locator("#collection")).to_be_focused()
    assert page.evaluate("document.body.dataset.state") == "choosing"
    assert uploads == []
    page.locator("#collection").fill("Schrank ")  # as phones' keyboards write it
    send(page)
    page.wait_for_url("**/#job=*")
    assert the_job(site, "Coat")["collection"] == "Schrank"


@pytest.mark.parametrize("more", [False, True])
def test_a_refused_job_is_changed_and_only_other_files_are_uploaded_again(
    page: Page, site: Site, photos: list[Path], uploads: list[str], more: bool
) -> None:
    key = f"stool-{more}"
    publish(box("Stool", RED), site.store, key=key)
    page.goto(site.url)
    fill(page, photos[:2], key, "attic")
    send(page)
    expect(page.get_by_role("alert")).to_contain_text("exists already")
    page.get_by_role("button", name="Change it").click()
    await_data(page, state="choosing", looked="2")
    expect(page.locator("#name")).to_have_value(key)
    expect(page.locator("#collection")).to_have_value("attic")
    page.locator("#name").fill(f"Other {key}")
    if more:
        page.locator("#photos").set_input_files(photos[2])
        await_data(page, looked="3")
    send(page)
    page.wait_for_url("**/#job=*")
    assert len(uploads) == 1 + more
    assert files_of(site, the_job(site, f"Other-{key}")) == [path.name for path in photos[: 2 + more]]


def test_what_is_being_changed_is_not_sent_as_it_was(browser: Browser, site: Site, photos: list[Path]) -> None:
    publish(box("Bench", RED), site.store, key="Bench")
    line = line_to(site.url)
    with with_a_past(browser) as context:
        page = context.new_page()
        page.on("dialog", lambda dialog: dialog.accept())
        page.goto(line.url)
        fill(page, photos, "Bench", "attic")
        line.cut()
        send(page)
        expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
        line.mend()
        page.get_by_role("button", name="Try again").click()
        expect(page.get_by_role("alert")).to_contain_text("exists already")
        page.get_by_role("button", name="Change it").click()
        await_data(page, state="choosing")
        page.close()
        page = context.new_page()
        page.goto(line.url)
        await_data(page, kept="draft")
        expect(page.locator("#kept-list li")).to_contain_text("Bench: 3 photos of")
