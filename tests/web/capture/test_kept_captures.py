"""What the capture page keeps on the device: photos that were not sent, and captures that found no server."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, Route, expect

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.gateway.jobs.capture_objects import capture_name
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.store import list_all
from tests.support.lines import Line, line_to
from tests.support.pages import await_data
from tests.support.sites import Site
from tests.support.tenants import make_key
from tests.support.things import RED, box
from tests.web.conftest import GuardedSite, with_a_past

pytestmark = pytest.mark.browser

# How many captures are on the device when nobody else sends any more: asked for at once, answered then.
_COUNT_AT_MY_TURN = """() => {
    globalThis.counted = navigator.locks.request('capture2vr-send', async () => {
        const { listKept } = await import('/web/shared/kept-captures.js');
        return (await listKept('')).length;
    });
}"""
SIZE = 1200  # pixels of noise along a photo's side: one is 2 MB, and three make an upload that goes on


@pytest.fixture
def line(site: Site) -> Line:
    """A line of this test's own: a browser's storage and workers belong to an address."""
    line = line_to(site.url)
    line.set_time_limits(CACHED_COPY_MS=300)
    return line


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser that keeps what pages keep, from visit to visit."""
    with with_a_past(browser) as context:
        yield context


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three large ones."""
    folder = tmp_path_factory.mktemp("photos")
    rng = np.random.default_rng(0)
    paths = [folder / f"IMG_{number}.jpg" for number in range(3)]
    for path in paths:
        Image.fromarray(rng.integers(0, 256, (SIZE, SIZE, 3), np.uint8)).save(path, quality=95)
    return paths


def visit(context: BrowserContext, line: Line, *, wait_for: str = "") -> Page:
    page = context.new_page()
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto(line.url)
    await_data(page, started="yes", **({"offline": wait_for} if wait_for else {}))
    return page


def visit_once(context: BrowserContext, line: Line) -> None:
    """Until the browser has all that a visit without the server needs."""
    visit(context, line, wait_for="ready").close()


def send(page: Page, photos: list[Path], name: str, *, collection: str = "") -> None:
    page.locator("#files").set_input_files(photos)
    page.locator("#name").fill(name)
    page.locator("#description").evaluate("area => (area.value = 'From the attic.')")
    page.locator("#collection").evaluate("(field, name) => (field.value = name)", collection)
    page.get_by_role("button", name="Send", exact=True).click()


def jobs_of(site: Site, key: str) -> list[dict[str, Any]]:
    return [job for job in httpx.get(f"{site.url}/v1/jobs").json()["jobs"] if job["asset_key"] == key]


def stored_files(site: Site, job: dict[str, Any]) -> dict[str, str]:
    """The SHA-256 of each file of a job's capture."""
    with zipfile.ZipFile(io.BytesIO(site.store.get(capture_name(job["capture"])))) as archive:
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist()}


def hashes(photos: list[Path]) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in photos}


def keep_without_a_server(
    context: BrowserContext, line: Line, photos: list[Path], *names: str, collection: str = ""
) -> None:
    """Open the page without the server, send, and close it, for each name."""
    visit_once(context, line)
    line.cut()
    for name in names:
        page = visit(context, line)
        send(page, photos, name, collection=collection)
        alert = page.get_by_role("alert")
        expect(alert).to_contain_text("The server cannot be reached.")
        expect(alert).to_contain_text("It is kept on this device, and sent when the server can be reached")
        page.close()


@pytest.mark.essential
def test_a_capture_without_a_server_is_kept_and_sent_when_the_page_opens_again(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    keep_without_a_server(context, line, photos, "Attic chair")
    waiting = visit(context, line)
    expect(waiting.locator("#kept-list li")).to_contain_text("Attic chair: it waits for the server.")
    waiting.close()
    line.mend()
    page = visit(context, line)
    await_data(page, kept="sent")
    (job,) = jobs_of(site, "Attic-chair")
    assert stored_files(site, job) == hashes(photos)
    assert job["label"] == "Attic chair"
    page.get_by_role("button", name="See it").click()
    await_data(page, job=job["state"])
    page.goto(line.url)
    await_data(page, kept="")
    assert len(jobs_of(site, "Attic-chair")) == 1


def test_the_service_worker_sends_while_no_capture_page_is_open(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    keep_without_a_server(context, line, photos, "Attic lamp")
    line.mend()
    other = context.new_page()
    devtools = context.new_cdp_session(other)
    registrations: list[dict[str, Any]] = []
    devtools.on("ServiceWorker.workerRegistrationUpdated", lambda event: registrations.extend(event["registrations"]))
    devtools.send("ServiceWorker.enable")
    other.goto(f"{line.url}/browse/default")
    await_data(other, offline="ready")
    found = next(each for each in registrations if each["scopeURL"].startswith(line.url))
    sync = {"origin": line.url, "registrationId": found["registrationId"], "tag": "send-captures", "lastChance": False}
    devtools.send("ServiceWorker.dispatchSyncEvent", sync)
    while not jobs_of(site, "Attic-lamp"):
        other.wait_for_function("() => new Promise((resolve) => setTimeout(() => resolve(true), 50))")
    (job,) = jobs_of(site, "Attic-lamp")
    assert stored_files(site, job) == hashes(photos)
    page = visit(context, line)
    expect(page.locator("#kept-list li")).to_contain_text("Attic lamp: sent.")


def test_trying_again_on_the_same_page_sends_it_once(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    page = visit(context, line)
    line.cut()
    send(page, photos[:1], "Attic box")
    expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
    line.mend()
    page.get_by_role("button", name="Try again").click()
    page.wait_for_url("**/#job=*")
    page.goto(line.url)
    page.reload()
    await_data(page, kept="")
    assert len(jobs_of(site, "Attic-box")) == 1


def test_who_sends_next_finds_nothing_left_of_what_was_sent(
    context: BrowserContext, line: Line, photos: list[Path]
) -> None:
    page, other = visit(context, line), visit(context, line)
    line.cut()
    send(page, photos[:1], "Attic rug")
    expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
    line.mend()

    def queue_another(route: Route) -> None:
        other.evaluate(_COUNT_AT_MY_TURN)
        route.continue_()

    page.route("**/v1/jobs", queue_another)
    page.get_by_role("button", name="Try again").click()
    page.wait_for_url("**/#job=*")
    assert other.evaluate("counted") == 0


def test_a_page_waits_until_another_has_sent(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    keep_without_a_server(context, line, photos[:1], "Attic shelf")
    line.mend()
    sender = context.new_page()
    sender.goto(f"{line.url}/browse/default")
    sender.evaluate(
        "new Promise((held) => { navigator.locks.request('capture2vr-send', () => (held(), new Promise(() => {}))); })"
    )
    page = visit(context, line)
    await_data(page, kept="waiting")
    page.wait_for_function("async () => (await navigator.locks.query()).pending.length === 1")
    assert not jobs_of(site, "Attic-shelf")
    sender.close()
    await_data(page, kept="sent")
    assert len(jobs_of(site, "Attic-shelf")) == 1


def test_what_the_server_refuses_is_said_and_stays_until_it_is_deleted(
    context: BrowserContext, line: Line, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8\xff" + bytes(1000))
    keep_without_a_server(context, line, [broken], "Broken")
    line.mend()
    page = visit(context, line)
    await_data(page, kept="refused")
    expect(page.locator("#kept-list li")).to_contain_text("broken.jpg")
    page.get_by_role("button", name="Delete").click()
    await_data(page, kept="")


def test_what_contradicts_what_the_server_has_is_refused_and_the_next_one_is_sent(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    publish(box("Heirloom", RED), site.store, key="Heirloom")
    keep_without_a_server(context, line, photos[:1], "Heirloom", "Attic desk", collection="attic")
    line.mend()
    page = visit(context, line)
    await_data(page, kept="refused sent")
    expect(page.locator("#kept-list li").first).to_contain_text("Heirloom: ")
    expect(page.locator("#kept-list li").first).to_contain_text("choose another key", ignore_case=True)
    expect(page.locator("#kept-trouble")).to_have_text("")
    assert len(jobs_of(site, "Attic-desk")) == 1
    page.get_by_role("button", name="Change it").click()
    await_data(page, looked="1", kept="sent")
    expect(page.locator("#description")).to_have_value("From the attic.")
    expect(page.locator("#collection")).to_have_value("attic")
    expect(page.locator("#name")).to_have_value("Heirloom")
    page.locator("#name").fill("Heirloom of the attic")
    page.get_by_role("button", name="Send", exact=True).click()
    page.wait_for_url("**/#job=*")
    (job,) = jobs_of(site, "Heirloom-of-the-attic")
    assert stored_files(site, job) == hashes(photos[:1])


@pytest.mark.parametrize(("status", "kept"), [(423, "waiting sent"), (503, "waiting waiting"), (403, "refused sent")])
def test_what_fails_for_one_capture_alone_is_said_with_its_name_and_the_next_one_is_sent(
    context: BrowserContext, line: Line, photos: list[Path], status: int, kept: str
) -> None:
    keep_without_a_server(context, line, photos[:1], "Attic bed", "Attic clock")
    line.mend()
    failed: list[str] = []

    def fail_once(route: Route) -> None:
        if failed:
            return route.continue_()
        failed.append(route.request.url)
        return route.fulfill(status=status, json={"status": status, "code": "FAILED", "detail": "not this time"})

    page = context.new_page()
    page.route("**/v1/jobs", fail_once)
    page.goto(line.url)
    expect(page.locator("#kept-captures")).to_contain_text("Not this time.")
    await_data(page, kept=kept)
    trouble = "" if status == 403 else "Attic bed: Not this time." if status == 423 else "Not this time."
    expect(page.locator("#kept-trouble")).to_have_text(trouble)


def test_an_upload_that_the_server_has_lost_is_sent_anew(
    context: BrowserContext, line: Line, site: Site, photos: list[Path]
) -> None:
    keep_without_a_server(context, line, photos[:1], "Attic trunk")
    line.mend()
    page = context.new_page()
    page.route("**/v1/uploads/*/capture", lambda route: route.abort())
    page.goto(line.url)
    expect(page.locator("#kept-trouble")).to_contain_text("The server cannot be reached.")
    page.close()
    for head in list(list_all(site.store, "uploads/")):
        site.store.delete(head.name)
    page = visit(context, line)
    expect(page.locator("#kept-trouble")).to_contain_text("Attic trunk: The server has lost a part of what was sent.")
    await_data(page, kept="waiting")
    page.get_by_role("button", name="Send now").click()
    await_data(page, kept="sent")
    (job,) = jobs_of(site, "Attic-trunk")
    assert stored_files(site, job) == hashes(photos[:1])


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("indexedDB.open = () => { throw new DOMException('no', 'SecurityError'); }", "This browser keeps nothing"),
        (
            "IDBObjectStore.prototype.put = () => { throw new DOMException('full', 'QuotaExceededError'); }",
            "This device has no room for it.",
        ),
    ],
)
def test_what_cannot_be_kept_is_said_and_stays_in_the_page(
    context: BrowserContext, line: Line, site: Site, photos: list[Path], fault: str, sentence: str
) -> None:
    page = context.new_page()
    page.add_init_script(fault)
    page.goto(line.url)
    page.locator("#photos").set_input_files(photos[0])
    expect(page.locator("#not-kept")).to_contain_text(sentence)
    expect(page.locator("#not-kept")).to_contain_text("leave the page open until it is sent")
    line.cut()
    page.locator("#name").fill("Homeless")
    page.get_by_role("button", name="Send").click()
    expect(page.locator("#trouble")).to_contain_text(sentence)
    line.mend()
    before = len(jobs_of(site, "Homeless"))
    page.get_by_role("button", name="Try again").click()
    page.wait_for_url("**/#job=*")
    assert len(jobs_of(site, "Homeless")) == before + 1


def test_photos_that_were_taken_and_not_sent_are_there_at_the_next_visit(
    context: BrowserContext, line: Line, photos: list[Path]
) -> None:
    page = visit(context, line)
    for photo in photos:
        page.locator("#photos").set_input_files(photo)
    await_data(page, looked="3", onDevice="yes")
    page.close()
    page = visit(context, line)
    expect(page.locator("#kept-list li")).to_contain_text("3 photos of")
    page.get_by_role("button", name="Go on").click()
    await_data(page, looked="3", kept="")
    expect(page.locator("#count")).to_have_text("3 photos")
    expect(page.locator("#name")).to_have_value("")
    page.close()
    page = visit(context, line)
    page.get_by_role("button", name="Delete").click()
    await_data(page, kept="")


@pytest.mark.parametrize("server", [True, False])
def test_photos_that_are_replaced_are_not_sent_and_stay_as_a_draft(
    context: BrowserContext, line: Line, site: Site, photos: list[Path], tmp_path: Path, server: bool
) -> None:
    scan = tmp_path / "scan.xyz"
    scan.write_text("".join(f"{x} {y} 0\n" for x in range(20) for y in range(20)))
    name = f"Replaced {server}"
    page = visit(context, line)
    for photo in photos[:2]:
        page.locator("#photos").set_input_files(photo)
    await_data(page, looked="2", onDevice="yes")
    page.locator("#files").set_input_files(scan)
    expect(page.locator("#chosen")).to_contain_text("1 file")
    expect(page.locator("#kept-list li")).to_contain_text("2 photos of")
    page.locator("#name").fill(name)
    if not server:
        line.cut()
    page.get_by_role("button", name="Send", exact=True).click()
    if server:
        page.wait_for_url("**/#job=*")
    else:
        expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
        line.mend()
    page.close()
    page = visit(context, line)
    await_data(page, kept="draft" if server else "draft sent")
    (job,) = jobs_of(site, name.replace(" ", "-"))
    assert stored_files(site, job) == hashes([scan])
    page.get_by_role("button", name="Go on").click()
    await_data(page, looked="2")


def test_a_photo_that_was_removed_but_not_forgotten_is_not_sent(
    context: BrowserContext, line: Line, site: Site, photos: list[Path], tmp_path: Path
) -> None:
    dark = tmp_path / "dark.jpg"
    Image.new("RGB", (300, 200)).save(dark)
    page = visit(context, line)
    for number, photo in enumerate([dark, photos[0]], start=1):
        page.locator("#photos").set_input_files(photo)
        await_data(page, looked=str(number), onDevice="yes")
    page.evaluate("""() => {
        const own = IDBObjectStore.prototype.delete;
        IDBObjectStore.prototype.delete = () => {
            IDBObjectStore.prototype.delete = own;
            throw new DOMException('once', 'UnknownError');
        };
    }""")
    page.get_by_role("button", name="Remove dark.jpg").click()
    await_data(page, looked="1")
    line.cut()
    page.locator("#name").fill("Bright")
    page.get_by_role("button", name="Send", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("It is kept on this device")
    page.close()
    line.mend()
    await_data(visit(context, line), kept="sent")
    (job,) = jobs_of(site, "Bright")
    assert stored_files(site, job) == hashes(photos[:1])


def test_another_user_of_the_browser_neither_sees_nor_sends_them(
    browser: Browser, guarded: GuardedSite, photos: list[Path]
) -> None:
    line = line_to(guarded.url)
    bob = make_key(guarded.data_dir, "bob", ALL_SCOPES - {Scope.OPERATE})
    with with_a_past(browser) as context:

        def log_in(key: str) -> None:
            assert context.request.post(f"{line.url}/v1/session", data={"key": key}).ok

        log_in(guarded.key)
        keep_without_a_server(context, line, photos[:1], "Diary")
        line.mend()
        log_in(bob)
        page = visit(context, line, wait_for="ready")
        await_data(page, tenant="bob", kept="")
        page.close()
        assert not httpx.get(f"{guarded.url}/v1/jobs", headers={"Authorization": f"Bearer {bob}"}).json()["jobs"]
        log_in(guarded.key)
        await_data(visit(context, line), tenant="ada", kept="sent")
