"""Whatever a page waits for ends in the thing, or in a sentence with a button that brings the thing once the fault is
mended."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from services.storage.catalogue.publish import publish
from services.storage.catalogue.signing import Keys, generate_key, read_signer
from tests.support.lines import Line, line_to
from tests.support.screenshots import drawn, stage
from tests.support.sites import Site, site_at
from tests.support.things import BLUE, RED, box, picture_of

pytestmark = pytest.mark.browser

SILENCE_MS = 4000
"""Long enough for an answer on a busy machine: where a page is not loaded anew, it holds after the fault too."""

SILENT = "The server does not answer. Check the connection and try again."
INCOMPLETE = "This page could not be loaded completely. Check the connection and try again."


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A signed collection of a red and a blue box."""
    folder = tmp_path_factory.mktemp("waits")
    generate_key(folder / "key")
    keys = Keys((read_signer(folder / "key"),))
    with site_at(folder, keys) as site:
        for key, colour in {"red": RED, "blue": BLUE}.items():
            files = {"thumbnail.webp": picture_of(colour)}
            publish(box(f"{key} box", colour, files=files), site.store, key=key, keys=keys)
        yield site


@pytest.fixture
def line(shelf: Site) -> Iterator[Line]:
    """A line of each test's own."""
    line = line_to(shelf.url)
    yield line
    line.mend()
    line.cut()


def expect_thing(page: Page, loaded: str = "2 1 0") -> None:
    expect(page.locator("body")).to_have_attribute("data-loaded", loaded)
    assert drawn(stage(page)) > 0.05
    expect(page.get_by_role("button", name="Try again")).to_be_hidden()


def expect_sentence(page: Page, words: str) -> None:
    expect(page.get_by_text(words)).to_be_in_viewport(ratio=1)
    expect(page.get_by_role("button", name="Try again")).to_be_in_viewport(ratio=1)


def break_line(line: Line, fault: str, path: str) -> None:
    if fault == "silent":
        line.silence(path)
    else:
        line.stop_midway(path)


def try_again(page: Page, line: Line) -> None:
    line.mend()
    page.get_by_role("button", name="Try again").click()


@pytest.mark.parametrize(
    ("fault", "path"),
    [
        ("silent", "/v1/assets/red"),
        ("silent", "/v1/keys"),
        ("silent", "/v1/collections/default"),
        ("silent", r"/shard\."),
        ("silent", "lod2.*glb"),
        ("half", "/v1/assets/red"),
        ("half", "lod2.*glb"),
    ],
)
def test_data_that_does_not_come_is_said_and_comes_when_asked_for_again(
    page: Page, line: Line, fault: str, path: str
) -> None:
    line.set_time_limits(NETWORK_SILENCE_MS=SILENCE_MS)
    break_line(line, fault, path)
    page.goto(f"{line.url}/view/red")
    expect_sentence(page, SILENT)
    expect(page.locator("#label")).to_have_text("Not loaded")
    try_again(page, line)
    expect_thing(page)


@pytest.mark.parametrize(
    ("fault", "path"),
    [
        ("silent", "viewer/viewer.js"),
        ("silent", "gltf-loader.js"),
        ("silent", "shared/style.css"),
        ("half", "gltf-loader.js"),
        ("half", "shared/style.css"),
    ],
)
def test_a_page_that_does_not_start_says_so(page: Page, line: Line, fault: str, path: str) -> None:
    line.set_time_limits(start_ms=SILENCE_MS)
    break_line(line, fault, path)
    page.goto(f"{line.url}/view/red", wait_until="commit")
    expect_sentence(page, INCOMPLETE)
    try_again(page, line)
    expect_thing(page)


def test_a_page_whose_own_text_stops_says_so(page: Page, line: Line) -> None:
    line.set_time_limits(start_ms=SILENCE_MS)
    line.stop_midway("^/view/", 0.8)
    page.goto(f"{line.url}/view/red", wait_until="commit")
    expect_sentence(page, INCOMPLETE)
    try_again(page, line)
    expect_thing(page)


def test_a_module_that_is_missing_is_said_at_once(page: Page, line: Line) -> None:
    page.route("**/*orbit-controls.js", lambda route: route.fulfill(status=404))
    page.goto(f"{line.url}/view/red", wait_until="commit")
    expect_sentence(page, INCOMPLETE)
    page.unroute_all()
    try_again(page, line)
    expect_thing(page)


@pytest.mark.parametrize(("fault", "path"), [("silent", "/v1/collections/"), ("half", r"/shard\.")])
def test_a_collection_that_does_not_come_is_said(page: Page, line: Line, fault: str, path: str) -> None:
    line.set_time_limits(NETWORK_SILENCE_MS=SILENCE_MS)
    break_line(line, fault, path)
    page.goto(f"{line.url}/browse/default")
    expect_sentence(page, SILENT)
    try_again(page, line)
    expect(page.locator("#said")).to_have_text("2 things")
    expect(page.get_by_role("button", name="Try again")).to_be_hidden()


def test_a_picture_that_does_not_come_is_said_beside_the_others(page: Page, line: Line, shelf: Site) -> None:
    (name,) = [path.name for path in (shelf.store.path("assets/red")).iterdir() if "thumbnail" in path.name]
    line.set_time_limits(NETWORK_SILENCE_MS=SILENCE_MS)
    line.silence(f"/red/{re.escape(name)}")
    page.goto(f"{line.url}/browse/default")
    expect(page.locator("[data-key=red] .facts")).to_have_text("Its picture could not be loaded.")
    expect(page.locator("[data-key=blue]")).to_have_attribute("data-picture", "thumbnail.webp")
    try_again(page, line)
    expect(page.locator("[data-key=red]")).to_have_attribute("data-picture", "thumbnail.webp")


def test_one_of_several_things_that_does_not_come_is_counted(page: Page, line: Line) -> None:
    line.set_time_limits(NETWORK_SILENCE_MS=SILENCE_MS)
    line.silence("/v1/assets/blue")
    page.goto(f"{line.url}/view?key=red&key=blue")
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    expect_sentence(page, "1 could not be loaded")
    try_again(page, line)
    expect_thing(page, "2 1 0; 2 1 0")
    expect(page.locator("#said")).not_to_contain_text("could not be loaded")


HANGING = {
    "a worker that never answers": "window.Worker = class { postMessage() {} terminate() {} addEventListener() {} }",
    "a worker that does not start": "window.Worker = class { constructor() { throw new Error('no workers here'); } }",
    "a cache that never opens": "CacheStorage.prototype.open = () => new Promise(() => {})",
    "a cache that never reads": "Cache.prototype.match = () => new Promise(() => {})",
    "a cache that never writes": "Cache.prototype.put = () => new Promise(() => {})",
    "a cache that is forbidden": "CacheStorage.prototype.open = () => Promise.reject(new Error('no'))",
    "a storage that is forbidden": "Storage.prototype.getItem = Storage.prototype.setItem = () => { throw Error(); }",
    "a storage that is damaged": "localStorage.setItem('capture2vr:keys', '[{')",
    "a service worker that is never registered": "navigator.serviceWorker.register = () => new Promise(() => {})",
    "a service worker that is never ready": (
        "Object.defineProperty(navigator.serviceWorker, 'ready', { value: new Promise(() => {}) })"
    ),
    "shaders that are never ready": (
        "const get = WebGL2RenderingContext.prototype.getProgramParameter;"
        "WebGL2RenderingContext.prototype.getProgramParameter = function (program, name) {"
        "    return name === 0x91B1 ? false : get.call(this, program, name);"  # COMPLETION_STATUS_KHR
        "};"
        "const extension = WebGL2RenderingContext.prototype.getExtension;"
        "WebGL2RenderingContext.prototype.getExtension = function (name) {"
        "    return name === 'KHR_parallel_shader_compile' ? {} : extension.call(this, name);"
        "}"
    ),
}


@pytest.mark.parametrize("what", HANGING)
def test_what_hangs_in_the_browser_does_not_keep_the_thing_away(page: Page, line: Line, what: str) -> None:
    line.set_time_limits(CACHE_STORAGE_MS=500, MESH_WORKER_MS=500, SHADER_MS=500)
    page.add_init_script(HANGING[what])
    page.goto(f"{line.url}/view/red")
    expect_thing(page)


def test_a_file_that_cannot_be_decoded_is_said(page: Page, line: Line) -> None:
    """A browser whose WebAssembly never starts; the button loads the page anew, where it does."""
    line.set_time_limits(DECODE_MS=1000)
    never = "WebAssembly.instantiate = () => new Promise(() => {}); window.Worker = null"
    page.add_init_script(f"if (!sessionStorage.mended) {{ {never} }}")
    page.goto(f"{line.url}/view/red")
    expect_sentence(page, "The 3D file was loaded, but this browser could not open it.")
    page.evaluate("sessionStorage.mended = 'yes'")
    try_again(page, line)
    expect_thing(page)
