"""The viewer trusts a signature and nobody's word: what is forged, older or another's is refused, and said."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from services.cli.up import Stack, run_stack
from services.storage.bundle import Bundle
from services.storage.catalogue.collection import index_name
from services.storage.catalogue.publish import publish
from services.storage.catalogue.signing import Keys, generate_key, read_signer
from services.storage.catalogue.update import rebuild
from services.storage.local import LocalStore
from services.storage.store import NO_CACHE
from tests.support.screenshots import drawn, stage
from tests.web.conftest import PATIENCE_MS, PHONE

pytestmark = pytest.mark.browser
INDEX = index_name("default")


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stack, Keys]]:
    """Gateway and worker that sign, and their key."""
    path = tmp_path_factory.mktemp("keys") / "ours"
    generate_key(path)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("STORAGE_SIGNING_KEY", str(path))
        with run_stack("127.0.0.1", 0, tmp_path_factory.mktemp("signed")) as stack:
            yield stack, Keys((read_signer(path),))


@pytest.fixture
def store(signed: tuple[Stack, Keys], bundle: Bundle) -> Iterator[LocalStore]:
    """The gateway's store with an asset; its index is as it was when the test is over."""
    store = LocalStore(signed[0].store_root)
    publish(bundle, store, key="bowl", keys=signed[1])
    whole = store.get(INDEX)
    yield store
    replaced(store, whole)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A device that keeps what it has seen from visit to visit."""
    context = browser.new_context(viewport=PHONE, device_scale_factor=1, service_workers="block")
    yield context
    context.close()


def replaced(store: LocalStore, index: bytes) -> None:
    store.put(INDEX, index, content_type="application/json", cache_control=NO_CACHE)


def visit(context: BrowserContext, signed: tuple[Stack, Keys]) -> Page:
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{signed[0].url}/view/bowl")
    return page


def expect_shown(page: Page) -> None:
    expect(page.locator("body")).to_have_attribute("data-loaded", "2 1 0")
    assert drawn(stage(page)) > 0.05


def expect_refused(page: Page, code: str, words: str) -> None:
    expect(page.locator("body")).to_have_attribute("data-code", code)
    expect(page.locator("#said")).to_contain_text(words)
    assert not page.get_attribute("body", "data-loaded")


def test_a_signed_asset_is_shown_and_an_older_catalogue_refused(
    context: BrowserContext,
    signed: tuple[Stack, Keys],
    store: LocalStore,
    bundle: Bundle,
) -> None:
    older = store.get(INDEX)
    publish(bundle, store, key="another", keys=signed[1])
    expect_shown(visit(context, signed))
    replaced(store, older)
    expect_refused(visit(context, signed), "CATALOGUE_OLDER", "older catalogue than this device has seen")


def test_a_forged_catalogue_is_refused(context: BrowserContext, signed: tuple[Stack, Keys], store: LocalStore) -> None:
    envelope = json.loads(store.get(INDEX))
    text = json.loads(envelope["signed"])
    envelope["signed"] = json.dumps({**text, "version": text["version"] + 1})
    replaced(store, json.dumps(envelope).encode())
    expect_refused(visit(context, signed), "CATALOGUE_FORGED", "not signed by whom it was before")


def test_the_catalogue_of_another_signer_is_refused_on_a_device_that_knows_the_first(
    context: BrowserContext, signed: tuple[Stack, Keys], store: LocalStore, tmp_path: Path
) -> None:
    expect_shown(visit(context, signed))
    generate_key(tmp_path / "theirs")
    rebuild(store, "default", Keys((read_signer(tmp_path / "theirs"),)))
    expect_refused(visit(context, signed), "CATALOGUE_FORGED", "not signed by whom it was before")


def test_an_entry_that_the_collection_does_not_know_is_refused(
    context: BrowserContext, signed: tuple[Stack, Keys], store: LocalStore
) -> None:
    name = "catalog/bowl.json"
    whole = store.get(name)
    entry = json.loads(whole)
    entry["manifest"]["sha256"] = "0" * 64
    store.put(name, json.dumps(entry).encode(), content_type="application/json", cache_control=NO_CACHE)
    try:
        expect_refused(visit(context, signed), "CATALOGUE_BEHIND", "not in the signed catalogue")
    finally:
        store.put(name, whole, content_type="application/json", cache_control=NO_CACHE)
