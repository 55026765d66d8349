"""What a device keeps: the second visit loads no asset, the third needs no server, and nothing false is shown."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from services.cli.up import Stack
from services.storage.bundle import Bundle
from services.storage.catalogue.entry import read_entry
from services.storage.catalogue.publish import publish
from services.storage.local import LocalStore
from tests.support.lines import Line, line_to
from tests.support.screenshots import drawn, stage
from tests.web.conftest import PATIENCE_MS, PHONE
from tests.web.viewer.test_viewer import store  # noqa: F401 - a fixture is used by its name

pytestmark = pytest.mark.browser


@pytest.fixture
def line(stack: Stack) -> Line:
    """A line of this test's own: a browser's caches and workers belong to an address."""
    return line_to(stack.url)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser that keeps what pages keep, from visit to visit."""
    context = browser.new_context(viewport=PHONE, device_scale_factor=1)
    yield context
    context.close()


@pytest.fixture
def cup(store: LocalStore, bundle: Bundle, request: pytest.FixtureRequest) -> str:  # noqa: F811
    """The key of an asset of this test's own."""
    key = re.sub(r"[^a-z0-9]+", "-", request.node.name.removeprefix("test_"))[:99]
    publish(bundle, store, key=key)
    return key


def _visited(context: BrowserContext, address: str) -> Page:
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    assert drawn(stage(page)) > 0.05
    return page


def expect_offline_ready(page: Page) -> None:
    """Until the browser has all that a visit without the server needs."""
    expect(page.locator("body")).to_have_attribute("data-offline", "ready")


def test_a_second_visit_loads_no_file_and_a_third_needs_no_server(
    context: BrowserContext, line: Line, cup: str
) -> None:
    address = f"{line.url}/view/{cup}"
    first = _visited(context, address)
    assert len(line.asset_files()) == 3
    expect_offline_ready(first)
    first.close()
    _visited(context, address).close()
    assert line.asset_files() == []
    line.cut()
    third = _visited(context, address)
    assert line.asset_files() == []
    assert third.locator("#label").inner_text() == "Bowl"


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
    context: BrowserContext,
    line: Line,
    cup: str,
    store: LocalStore,  # noqa: F811
) -> None:
    changed = [Path(store.path(lod["name"])) for lod in read_entry(store, cup).document["lods"]]
    before = [path.read_bytes() for path in changed]
    for path, content in zip(changed, before, strict=True):
        path.chmod(0o644)
        path.write_bytes(content[:-40] + bytes(40))
    try:
        page = context.new_page()
        page.goto(f"{line.url}/view/{cup}")
        expect(page.locator("body")).to_have_attribute("data-code", "ASSET_TAMPERED")
        expect(page.locator("#said")).to_contain_text("not what the catalogue promises")
        assert drawn(stage(page)) == 0 or page.get_attribute("body", "data-hints")
        assert len(page.evaluate(FILES)) == 1, "the manifest alone"
    finally:
        for path, content in zip(changed, before, strict=True):
            path.write_bytes(content)


HASTY_MS = {"CACHED_COPY_MS": 1000, "NETWORK_SILENCE_MS": 4000}


def _visit_once(context: BrowserContext, address: str) -> None:
    page = _visited(context, address)
    expect_offline_ready(page)
    page.close()


@pytest.mark.parametrize("fault", ["never answers", "stops in the middle of every answer"])
def test_a_server_that_hangs_is_done_without(context: BrowserContext, line: Line, cup: str, fault: str) -> None:
    line.set_time_limits(**HASTY_MS)
    address = f"{line.url}/view/{cup}"
    _visit_once(context, address)
    if fault == "never answers":
        line.silence()
    else:
        line.stop_midway("")
    _visited(context, address)


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


@pytest.mark.parametrize(
    ("cache", "file", "words"),
    [
        ("shell-", "/viewer.js", "This page could not be loaded completely."),
        ("catalogue-", "", "The server cannot be reached."),
    ],
)
def test_a_damaged_copy_is_not_used(
    context: BrowserContext, line: Line, cup: str, cache: str, file: str, words: str
) -> None:
    address = f"{line.url}/view/{cup}"
    page = _visited(context, address)
    expect_offline_ready(page)
    assert page.evaluate(CUT_SHORT, [cache, file or f"/v1/assets/{cup}"])
    page.close()
    line.cut()
    page = context.new_page()
    page.goto(address, wait_until="commit")
    expect(page.get_by_text(words)).to_be_visible()
    line.mend()
    page.get_by_role("button", name="Try again").click()
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")


def test_pages_that_were_cached_in_part_are_not_used(context: BrowserContext, line: Line, cup: str) -> None:
    """The last file of the shell never comes: the cache is not complete, and the next visit completes it."""
    line.set_time_limits(**HASTY_MS)
    line.silence("basis-transcoder.wasm")
    address = f"{line.url}/view/{cup}"
    page = _visited(context, address)
    assert page.get_attribute("body", "data-offline") != "ready"
    line.mend()
    page.close()
    _visit_once(context, address)
    line.cut()
    _visited(context, address)


def test_a_new_version_of_the_pages_replaces_the_cached_one_as_a_whole(
    context: BrowserContext, line: Line, cup: str
) -> None:
    address = f"{line.url}/view/{cup}"
    _visit_once(context, address)
    line.change("/web/shell.json", lambda text: text.replace('"version":"', '"version":"new-'))
    line.change("/viewer/viewer.js", lambda text: text + "document.body.dataset.release = 'new';")
    page = _visited(context, address)
    page.wait_for_function(
        """async () => {
            const names = (await caches.keys()).filter((name) => name.startsWith('shell-'));
            return names.length === 1 && names[0].startsWith('shell-new-');
        }"""
    )
    page.close()
    line.cut()
    expect(_visited(context, address).locator("body")).to_have_attribute("data-release", "new")
