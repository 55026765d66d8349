"""Whatever a page waits for ends in the thing, or in a sentence with a button that brings the thing once the fault is
mended.

Pages run on a clock of the test's, which is put forward by the page's own time limits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import product

import pytest
from playwright.sync_api import Page, expect

from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from tests.support.lines import Line, line_to
from tests.support.pages import await_data, time_limit_ms
from tests.support.screenshots import drawn, stage
from tests.support.sites import Site, site_at
from tests.support.things import BLUE, RED, box, picture_of

pytestmark = pytest.mark.browser

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
            publish(box(f"{key} box", colour, files=files), site.store, key=key, policy=PublishPolicy(keys))
        yield site


@pytest.fixture
def page(page: Page) -> Page:
    """A page whose clock can be put forward."""
    page.clock.install()
    return page


@pytest.fixture
def line(shelf: Site) -> Iterator[Line]:
    """A line of each test's own."""
    line = line_to(shelf.url)
    yield line
    line.mend()
    line.cut()


def expect_thing(page: Page, loaded: str = "2 1 0") -> None:
    await_data(page, loaded=loaded)
    assert drawn(stage(page)) > 0.05
    expect(page.get_by_role("button", name="Try again")).to_be_hidden()


def expect_sentence(page: Page, words: str) -> None:
    expect(page.get_by_text(words)).to_be_in_viewport(ratio=1)
    expect(page.get_by_role("button", name="Try again")).to_be_in_viewport(ratio=1)


def ask(page: Page, address: str) -> None:
    """Visit the address; on a page that is there already, ask for it again."""
    if page.url == "about:blank":
        page.goto(address, wait_until="commit")
    else:
        page.get_by_role("button", name="Try again").click()


def each_fault(page: Page, line: Line, address: str, faults: Iterable[tuple[str, str]]) -> Iterator[None]:
    """Let the page ask once with each of these faults, which are alone then, and in the end with none."""
    for fault, path in faults:
        line.mend()
        if fault == "silent":
            line.silence(path)
        else:
            line.stop_midway(path, 0.8)
        ask(page, address)
        yield
    line.mend()
    ask(page, address)


def await_silence(page: Page, line: Line) -> None:
    """Wait until a request has met the fault, and let the time pass that a page waits then."""
    line.await_fault()
    page.clock.fast_forward(time_limit_ms("NETWORK_SILENCE_MS"))


def await_start(page: Page, line: Line) -> None:
    """The same for the time in which a page has to start."""
    line.await_fault()
    page.locator("#stage").wait_for(state="attached")  # it stands behind the script that watches over the start
    page.clock.fast_forward(int(page.locator("[data-silence-ms]").get_attribute("data-silence-ms") or ""))


@pytest.mark.essential
@pytest.mark.parametrize(
    ("fault", "paths"),
    [
        ("silent", ["/v1/assets/red", "/v1/keys", "/v1/collections/default", r"/shard\.", "lod2.*glb"]),
        ("half", ["/v1/assets/red", "lod2.*glb"]),
    ],
    ids=["silent", "half"],
)
def test_data_that_does_not_come_is_said_and_comes_when_asked_for_again(
    page: Page, line: Line, fault: str, paths: list[str]
) -> None:
    """A page asks for these one after another: each has come before the next one is missing."""
    for _ in each_fault(page, line, f"{line.url}/view/red", product([fault], paths)):
        await_silence(page, line)
        expect_sentence(page, SILENT)
        expect(page.locator("#label")).to_have_text("Not loaded")
    expect_thing(page)


@pytest.mark.parametrize(
    ("fault", "paths"),
    [
        ("silent", ["gltf-loader.js", "viewer/viewer.js", "shared/style.css"]),
        ("half", ["gltf-loader.js", "^/view/", "shared/style.css"]),
    ],
    ids=["silent", "half"],
)
def test_a_page_that_does_not_start_says_so(page: Page, line: Line, fault: str, paths: list[str]) -> None:
    """The loader comes first: once it has arrived the browser keeps it, as its address has a version."""
    for _ in each_fault(page, line, f"{line.url}/view/red", product([fault], paths)):
        await_start(page, line)
        expect_sentence(page, INCOMPLETE)
    expect_thing(page)


def test_a_module_that_is_missing_is_said_at_once(page: Page, line: Line) -> None:
    page.route("**/*orbit-controls.js", lambda route: route.fulfill(status=404))
    page.goto(f"{line.url}/view/red", wait_until="commit")
    expect_sentence(page, INCOMPLETE)
    page.unroute_all()
    ask(page, page.url)
    expect_thing(page)


def test_a_collection_that_does_not_come_is_said(page: Page, line: Line) -> None:
    faults = [("silent", "/v1/collections/"), ("half", r"/shard\.")]
    for _ in each_fault(page, line, f"{line.url}/browse/default", faults):
        await_silence(page, line)
        expect_sentence(page, SILENT)
    expect(page.locator("#said")).to_have_text("2 objects")
    expect(page.get_by_role("button", name="Try again")).to_be_hidden()


def test_a_picture_that_does_not_come_is_said_beside_the_others(page: Page, line: Line, shelf: Site) -> None:
    (name,) = [path.name for path in (shelf.store.path("assets/red")).iterdir() if "thumbnail" in path.name]
    line.silence(f"/red/{re.escape(name)}")
    page.goto(f"{line.url}/browse/default")
    expect(page.locator("[data-key=blue]")).to_have_attribute("data-picture", "thumbnail.webp")
    await_silence(page, line)
    expect(page.locator("[data-key=red] .facts")).to_have_text("Its picture could not be loaded.")
    expect(page.locator("[data-key=blue]")).to_have_attribute("data-picture", "thumbnail.webp")
    line.mend()
    ask(page, page.url)
    expect(page.locator("[data-key=red]")).to_have_attribute("data-picture", "thumbnail.webp")


def test_one_of_several_things_that_does_not_come_is_counted(page: Page, line: Line) -> None:
    line.silence("/v1/assets/blue")
    page.goto(f"{line.url}/view?key=red&key=blue")
    await_data(page, loaded="2 1 0")
    await_silence(page, line)
    expect_sentence(page, "1 could not be loaded")
    line.mend()
    ask(page, page.url)
    expect_thing(page, "2 1 0; 2 1 0")
    expect(page.locator("#said")).not_to_contain_text("could not be loaded")


HANGING = {
    "a worker that never answers": (
        "window.Worker = class { postMessage() { meet(%r); } terminate() {} addEventListener() {} }"
    ),
    "a worker that does not start": "window.Worker = class { constructor() { meet(%r); throw new Error(); } }",
    "a cache that never opens": "CacheStorage.prototype.open = () => meet(%r)",
    "a cache that never reads": "Cache.prototype.match = () => meet(%r)",
    "a cache that never writes": "Cache.prototype.put = () => meet(%r)",
    "a cache that is forbidden": "CacheStorage.prototype.open = async () => { meet(%r); throw new Error(); }",
    "a storage that is forbidden": (
        "Storage.prototype.getItem = Storage.prototype.setItem = () => { meet(%r); throw new Error(); }"
    ),
    "a storage that is damaged": "Storage.prototype.getItem = () => { meet(%r); return '[{'; }",
    "a service worker that is never registered": "navigator.serviceWorker.register = () => meet(%r)",
    "a service worker that is never ready": (
        "Object.defineProperty(navigator.serviceWorker, 'ready', { get: () => meet(%r) })"
    ),
    "shaders that are never ready": """
        const get = WebGL2RenderingContext.prototype.getProgramParameter;
        WebGL2RenderingContext.prototype.getProgramParameter = function (program, name) {
            if (name !== 0x91B1) return get.call(this, program, name); // COMPLETION_STATUS_KHR
            meet(%r);
            return false;
        };
        const extension = WebGL2RenderingContext.prototype.getExtension;
        WebGL2RenderingContext.prototype.getExtension = function (name) {
            return name === 'KHR_parallel_shader_compile' ? {} : extension.call(this, name);
        }""",
}
MEET = """
    window.met = new Set();
    function meet(fault) {
        met.add(fault);
        return new Promise(() => {});
    }"""


def hang(page: Page, *faults: str) -> None:
    """Let these faults happen on the pages that follow."""
    page.add_init_script(MEET + "".join(f"{{ {HANGING[fault] % fault} }}" for fault in faults))


def await_met(page: Page, fault: str) -> None:
    """Wait until the page has come to this fault."""
    page.wait_for_function("fault => met.has(fault)", arg=fault, polling=20)


TOGETHER = [
    (
        "a cache that never opens",
        "a worker that never answers",
        "a storage that is forbidden",
        "a service worker that is never registered",
    ),
    (
        "a cache that never reads",
        "a worker that does not start",
        "a storage that is damaged",
        "a service worker that is never ready",
    ),
    ("a cache that never writes", "shaders that are never ready"),
    ("a cache that is forbidden",),
]
LIMITS = {
    "a worker that never answers": "MESH_WORKER_MS",
    "a cache that never opens": "CACHE_STORAGE_MS",
    "a cache that never reads": "CACHE_STORAGE_MS",
    "a cache that never writes": "CACHE_STORAGE_MS",
}


@pytest.mark.parametrize("faults", TOGETHER, ids=", ".join)
def test_what_hangs_in_the_browser_does_not_keep_the_thing_away(
    page: Page, line: Line, faults: tuple[str, ...]
) -> None:
    """Faults that have nothing to do with each other, in the order in which a page meets those that it waits for."""
    line.set_time_limits(SHADER_MS=300)  # each level waits for its shaders, and nothing tells when
    hang(page, *faults)
    page.goto(f"{line.url}/view/red")
    for fault in faults:
        await_met(page, fault)
        if fault in LIMITS:
            page.clock.fast_forward(time_limit_ms(LIMITS[fault]))
    expect_thing(page)


def test_a_file_that_cannot_be_decoded_is_said(page: Page, line: Line) -> None:
    """A browser whose WebAssembly never starts; the button loads the page anew, where it does."""
    page.add_init_script("if (!sessionStorage.mended) WebAssembly.instantiate = () => new Promise(() => {})")
    hang(page, "a worker that does not start")  # it is tried when decoding begins
    page.goto(f"{line.url}/view/red")
    await_met(page, "a worker that does not start")
    page.clock.fast_forward(time_limit_ms("DECODE_MS"))
    expect_sentence(page, "The 3D file was loaded, but this browser could not open it.")
    page.evaluate("sessionStorage.mended = 'yes'")
    ask(page, page.url)
    expect_thing(page)
