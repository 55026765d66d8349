"""What a device keeps: the second visit loads no asset, the third needs no server, and nothing false is shown."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from tests.support.lines import Line, line_to
from tests.support.pages import await_data
from tests.support.patience import PATIENCE_S
from tests.support.screenshots import await_frames, drawn, stage
from tests.support.sites import Site
from tests.support.things import RED, box
from tests.web.conftest import with_a_past

pytestmark = pytest.mark.browser


@pytest.fixture
def line(site: Site) -> Line:
    """A line of this test's own: a browser's caches and workers belong to an address."""
    return line_to(site.url)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser that keeps what pages keep, from visit to visit."""
    with with_a_past(browser) as context:
        yield context


@pytest.fixture
def cup(site: Site, request: pytest.FixtureRequest) -> str:
    """The key of an asset of this test's own."""
    key = re.sub(r"[^a-z0-9]+", "-", request.node.name.removeprefix("test_"))[:99]
    publish(box("Cup", RED), site.store, key=key)
    return key


def _visited(context: BrowserContext, address: str) -> Page:
    page = context.new_page()
    page.goto(address)
    await_data(page, loaded="2 1 0")
    assert drawn(stage(page)) > 0.05
    return page


def _visit_once(context: BrowserContext, address: str) -> None:
    """Until the browser has all that a visit without the server needs."""
    page = _visited(context, address)
    await_data(page, offline="ready")
    page.close()


@pytest.mark.essential
def test_a_second_visit_loads_no_file_and_later_ones_need_no_server(
    context: BrowserContext, line: Line, cup: str
) -> None:
    line.set_time_limits(CACHED_COPY_MS=300)  # a service worker's clock cannot be put forward
    address = f"{line.url}/view/{cup}"
    _visit_once(context, address)
    assert len(line.asset_files()) == 3
    for fault in (None, partial(line.stop_midway, ""), line.silence, line.cut):
        if fault:
            fault()
        page = _visited(context, address)
        assert page.locator("#label").inner_text() == "Cup"
        assert line.requests or fault == line.cut, "the server was asked first"
        assert line.asset_files() == []
        page.close()


ROT = """async () => {
    const vault = await caches.open('assets-1');
    for (const place of await vault.keys()) {
        const bytes = new Uint8Array(await (await vault.match(place)).arrayBuffer());
        bytes[bytes.length >> 1] ^= 1;
        await vault.put(place, new Response(bytes));
    }
}"""
FILES = """async () => {
    const vault = await caches.open('assets-1');
    const kept = {};
    for (const place of await vault.keys()) {
        const digest = await crypto.subtle.digest('SHA-256', await (await vault.match(place)).arrayBuffer());
        const hash = Array.from(new Uint8Array(digest), (value) => value.toString(16).padStart(2, '0')).join('');
        kept[new URL(place.url).pathname.split('/').pop()] = hash;
    }
    return kept;
}"""


def test_what_has_rotted_on_the_device_is_replaced(context: BrowserContext, line: Line, cup: str) -> None:
    address = f"{line.url}/view/{cup}"
    page = _visited(context, address)
    page.evaluate(ROT)
    rotten = page.evaluate(FILES)
    assert len(rotten) == 4, "three levels of detail and the manifest"
    assert all(name != content for name, content in rotten.items())
    page.close()
    healed = _visited(context, address).evaluate(FILES)
    assert healed == {name: name for name in rotten}


def test_a_file_that_was_changed_on_the_server_is_not_shown(
    context: BrowserContext, line: Line, cup: str, site: Site
) -> None:
    changed = [Path(site.store.path(lod["name"])) for lod in read_entry(site.store, cup).document["lods"]]
    before = [path.read_bytes() for path in changed]
    for path, content in zip(changed, before, strict=True):
        path.chmod(0o644)
        path.write_bytes(content[:-40] + bytes(40))
    try:
        page = context.new_page()
        page.goto(f"{line.url}/view/{cup}")
        await_data(page, code="ASSET_TAMPERED")
        expect(page.locator("#said")).to_contain_text("not what the catalogue promises")
        assert drawn(stage(page)) == 0 or page.get_attribute("body", "data-hints")
        assert len(page.evaluate(FILES)) == 1, "the manifest alone"
    finally:
        for path, content in zip(changed, before, strict=True):
            path.write_bytes(content)


CUT_SHORT = """async ([name, ending]) => {
    const names = (await caches.keys()).filter((each) => each.startsWith(name));
    for (const cache of await Promise.all(names.map((each) => caches.open(each)))) {
        for (const request of (await cache.keys()).filter(({ url }) => url.endsWith(ending))) {
            const { headers } = await cache.match(request);
            const text = await (await cache.match(request)).text();
            await cache.put(request, new Response(text.slice(0, text.length / 2), { headers }));
            return true;
        }
    }
    return false;
}"""


def test_damaged_copies_are_not_used(context: BrowserContext, line: Line, cup: str) -> None:
    address = f"{line.url}/view/{cup}"
    _visit_once(context, address)
    for cache, file, words in (
        ("catalogue-", f"/v1/assets/{cup}", "The server cannot be reached."),
        ("shell-", "/viewer.js", "This page could not be loaded completely."),
    ):
        page = context.new_page()
        page.goto(f"{line.url}/v1/keys")
        assert page.evaluate(CUT_SHORT, [cache, file])
        line.cut()
        page.goto(address, wait_until="commit")
        expect(page.get_by_text(words)).to_be_visible()
        line.mend()
        page.get_by_role("button", name="Try again").click()
        await_data(page, loaded="2 1 0")
        page.close()


def test_pages_that_were_cached_in_part_are_not_used(context: BrowserContext, line: Line, cup: str) -> None:
    """The last file of the shell never comes: the cache is not complete, and the next visit completes it."""
    line.silence("basis-transcoder.wasm")
    address = f"{line.url}/view/{cup}"
    page = _visited(context, address)
    line.await_fault()
    assert page.get_attribute("body", "data-offline") != "ready"
    line.mend()
    page.close()
    _visit_once(context, address)
    line.cut()
    _visited(context, address)


def _has_only_shell(page: Page, prefix: str) -> bool:
    """Whether one version of the pages is cached, and which: an older one goes once a newer one is complete."""
    names = [name for name in page.evaluate("caches.keys()") if name.startswith("shell-")]
    return len(names) == 1 and names[0].startswith(prefix)


def test_a_new_version_of_the_pages_replaces_the_cached_one_as_a_whole(
    context: BrowserContext, line: Line, cup: str
) -> None:
    address = f"{line.url}/view/{cup}"
    _visit_once(context, address)
    line.change("/viewer/viewer.js", lambda text: text + "document.body.dataset.release = 'new';")
    # Last: an update that is still on its way must not cache the old file under the new version.
    line.change("/web/shell.json", lambda text: text.replace('"version":"', '"version":"new-'))
    page = _visited(context, address)
    deadline = time.monotonic() + PATIENCE_S
    while not _has_only_shell(page, "shell-new-"):
        assert time.monotonic() < deadline, page.evaluate("caches.keys()")
        await_frames(page)
    page.close()
    line.cut()
    expect(_visited(context, address).locator("body")).to_have_attribute("data-release", "new")
