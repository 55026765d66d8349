"""What a device keeps: the second visit loads no asset, the third needs no server, and nothing false is shown."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from services.cli.up import Stack
from services.storage.bundle import Bundle
from services.storage.catalogue.entry import read_entry
from services.storage.catalogue.publish import publish
from services.storage.local import LocalStore
from tests.support.screenshots import drawn, stage
from tests.web.conftest import PATIENCE_MS, PHONE
from tests.web.viewer.test_viewer import store  # noqa: F401 - a fixture is used by its name

pytestmark = pytest.mark.browser


@dataclass
class Line:
    """A TCP line to the gateway under an address of its own, which can be cut and counts what is asked for."""

    to: tuple[str, int]
    asked: list[str] = field(default_factory=list)
    _listener: socket.socket = field(init=False)

    def __post_init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self._serve, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def cut(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def files(self) -> list[str]:
        """The files of assets that were asked for since the last time."""
        asked, self.asked = self.asked, []
        return [path for path in asked if path.endswith(".glb")]

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._answer, args=(client,), daemon=True).start()

    def _answer(self, client: socket.socket) -> None:
        """One request: the connection is closed behind its answer, so that requests can be counted by their heads."""
        with client, socket.create_connection(self.to) as server:
            head = b""
            while b"\r\n\r\n" not in head:
                part = client.recv(65536)
                if not part:
                    return
                head += part
            self.asked.append(head.split(b" ", 2)[1].decode())
            lines = [line for line in head.split(b"\r\n") if not line.lower().startswith(b"connection:")]
            server.sendall(b"\r\n".join([lines[0], b"Connection: close", *lines[1:]]))
            while part := server.recv(65536):
                client.sendall(part)


@pytest.fixture
def line(stack: Stack) -> Line:
    """A line of this test's own: a browser's caches and workers belong to an address."""
    parts = urlsplit(stack.url)
    return Line((parts.hostname or "", parts.port or 0))


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser that keeps what pages keep, from visit to visit."""
    context = browser.new_context(viewport=PHONE, device_scale_factor=1)
    yield context
    context.close()


@pytest.fixture
def cup(store: LocalStore, bundle: Bundle, request: pytest.FixtureRequest) -> str:  # noqa: F811
    """The key of an asset of this test's own."""
    key = request.node.name.removeprefix("test_")[:60]
    publish(bundle, store, key=key)
    return key


def _visited(context: BrowserContext, address: str) -> Page:
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    assert drawn(stage(page)) > 0.05
    return page


def _settled(page: Page) -> None:
    """Until the service worker serves this address and has seen the page and its modules."""
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.wait_for_function("() => navigator.serviceWorker.controller !== null")
    page.reload()
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")


def test_a_second_visit_loads_no_file_and_a_third_needs_no_server(
    context: BrowserContext, line: Line, cup: str
) -> None:
    address = f"{line.url}/view/{cup}"
    first = _visited(context, address)
    assert len(line.files()) == 3
    _settled(first)
    first.close()
    _visited(context, address).close()
    assert line.files() == []
    line.cut()
    third = _visited(context, address)
    assert line.files() == []
    assert third.locator("#label").inner_text() == "Bowl"


ROT = """async () => {
    const vault = await caches.open('assets-1');
    for (const place of await vault.keys()) {
        const bytes = new Uint8Array(await (await vault.match(place)).arrayBuffer());
        bytes[bytes.length >> 1] ^= 1;
        await vault.put(place, new Response(bytes));
    }
}"""
KEPT = """async () => {
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
    rotten = page.evaluate(KEPT)
    assert len(rotten) == 3
    assert all(name != content for name, content in rotten.items())
    page.close()
    healed = _visited(context, address).evaluate(KEPT)
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
        assert page.evaluate("caches.open('assets-1').then((vault) => vault.keys()).then((keys) => keys.length)") == 0
    finally:
        for path, content in zip(changed, before, strict=True):
            path.write_bytes(content)
