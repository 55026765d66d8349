"""Large captures arrive whole, whatever happens on the way: no network, a killed gateway, a page loaded again."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import CDPSession, Dialog, Page, expect

from tests.support.gateway_process import GatewayProcess, running
from tests.support.patience import PATIENCE_S
from tests.support.tus import cloud

pytestmark = pytest.mark.browser

_BYTES = 48 << 20
_SLOW = 12 << 20  # bytes a second: slow enough to be interrupted


@pytest.fixture
def gateway(tmp_path: Path) -> Iterator[GatewayProcess]:
    """A gateway of each test's own."""
    with running(tmp_path) as gateway:
        yield gateway


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A file of some megabytes."""
    path = tmp_path / "garden.ply"
    path.write_bytes(cloud(_BYTES))
    return path


@pytest.fixture
def page(page: Page) -> Page:
    """A page that leaves without asking, and sends slowly."""
    page.on("dialog", _leave)
    return page


def _leave(dialog: Dialog) -> None:
    dialog.accept()


def set_network(network: CDPSession, *, throughput: int = _SLOW, offline: bool = False) -> None:
    """Limit the bytes a second that the page sends, or take its network away."""
    limit = {"offline": offline, "latency": 0, "downloadThroughput": -1, "uploadThroughput": throughput}
    network.send("Network.emulateNetworkConditions", limit)


def send(page: Page, gateway: GatewayProcess, scan: Path, *, throughput: int = _SLOW) -> CDPSession:
    page.goto(gateway.url)
    network = page.context.new_cdp_session(page)
    set_network(network, throughput=throughput)
    with page.expect_file_chooser() as chooser:
        page.get_by_text("Choose files").click()
    chooser.value.set_files(scan)
    page.get_by_role("button", name="Send").click()
    return network


def expect_arrived(page: Page, gateway: GatewayProcess, scan: Path, folder: Path) -> None:
    """The job has been started, with one capture that has the bytes that were sent; nothing else is left."""
    expect(page.locator("body")).to_have_attribute("data-job", re.compile("."))
    assert gateway.the_one_file(folder) == hashlib.sha256(scan.read_bytes()).hexdigest()
    until = time.monotonic() + PATIENCE_S
    while gateway.chunks():
        assert time.monotonic() < until
        time.sleep(0.05)
    assert page.evaluate("Object.keys(localStorage).filter((key) => key.startsWith('tus::'))") == []


def test_a_network_that_is_gone_and_a_gateway_that_is_killed(
    page: Page, gateway: GatewayProcess, scan: Path, tmp_path: Path
) -> None:
    created: list[str] = []
    page.on("request", lambda request: created.append(request.url) if request.url.endswith("/v1/uploads") else None)
    network = send(page, gateway, scan)
    gateway.wait_for_chunks(1)
    set_network(network, offline=True)
    expect(page.locator("#detail")).to_contain_text("The connection is lost; it goes on by itself.")
    set_network(network)
    gateway.wait_for_chunks(3)
    gateway.restart()
    expect_arrived(page, gateway, scan, tmp_path)
    assert len(created) == 1


@pytest.mark.essential
def test_a_page_that_is_loaded_again(page: Page, gateway: GatewayProcess, scan: Path, tmp_path: Path) -> None:
    created: list[str] = []
    page.on("request", lambda request: created.append(request.url) if request.url.endswith("/v1/uploads") else None)
    send(page, gateway, scan)
    gateway.wait_for_chunks(2)
    page.reload()
    expect(page.locator("#unfinished")).to_contain_text("garden.ply")
    send(page, gateway, scan, throughput=-1)
    expect_arrived(page, gateway, scan, tmp_path)
    assert len(created) == 1
    page.goto(gateway.url)
    expect(page.locator("#unfinished")).to_be_hidden()


def test_what_the_gateway_refuses_is_said_and_forgotten(page: Page, gateway: GatewayProcess, tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8\xff" + bytes(5 << 20))
    send(page, gateway, broken, throughput=-1)
    expect(page.get_by_role("alert")).to_contain_text("broken.jpg")
    assert gateway.captures() == []
    page.goto(gateway.url)
    expect(page.locator("#unfinished")).to_be_hidden()
    assert gateway.chunks() == 0
