"""The viewer trusts a signature and nobody's word: what is forged, older or another's is refused, and said."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.catalogue.update import rebuild
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import NO_CACHE
from tests.support.pages import await_data
from tests.support.screenshots import drawn, stage
from tests.support.sites import Site, site_at
from tests.support.things import RED, box
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser
ROOT = root_name("default")
BOWL = box("Bowl", RED)


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A gateway that signs."""
    folder = tmp_path_factory.mktemp("signed")
    generate_key(folder / "ours")
    with site_at(folder, Keys((read_signer(folder / "ours"),))) as site:
        yield site


@pytest.fixture
def store(signed: Site) -> Iterator[LocalStore]:
    """The gateway's store with an asset; its index is as it was when the test is over."""
    publish(BOWL, signed.store, key="bowl", policy=PublishPolicy(signed.keys))
    whole = signed.store.get(ROOT)
    yield signed.store
    replaced(signed.store, whole)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A device that keeps what it has seen from visit to visit."""
    with without_a_past(browser) as context:
        yield context


def replaced(store: LocalStore, index: bytes) -> None:
    store.put(ROOT, index, content_type="application/json", cache_control=NO_CACHE)


def visit(context: BrowserContext, signed: Site) -> Page:
    page = context.new_page()
    page.goto(f"{signed.url}/view/bowl")
    return page


def expect_shown(page: Page) -> None:
    await_data(page, loaded="2 1 0")
    assert drawn(stage(page)) > 0.05


def expect_refused(page: Page, code: str, words: str) -> None:
    await_data(page, code=code)
    expect(page.locator("#said")).to_contain_text(words)
    assert not page.get_attribute("body", "data-loaded")


@pytest.mark.essential
def test_a_signed_asset_is_shown_and_an_older_catalogue_refused(
    context: BrowserContext,
    signed: Site,
    store: LocalStore,
) -> None:
    older = store.get(ROOT)
    publish(BOWL, store, key="another", policy=PublishPolicy(signed.keys))
    expect_shown(visit(context, signed))
    replaced(store, older)
    expect_refused(visit(context, signed), "CATALOGUE_OLDER", "older catalogue than this device has seen")


def test_a_forged_catalogue_is_refused(context: BrowserContext, signed: Site, store: LocalStore) -> None:
    envelope = json.loads(store.get(ROOT))
    text = json.loads(envelope["signed"])
    envelope["signed"] = json.dumps({**text, "version": text["version"] + 1})
    replaced(store, json.dumps(envelope).encode())
    expect_refused(visit(context, signed), "CATALOGUE_FORGED", "not signed by whom it was before")


def test_the_catalogue_of_another_signer_is_refused_on_a_device_that_knows_the_first(
    context: BrowserContext, signed: Site, store: LocalStore, tmp_path: Path
) -> None:
    expect_shown(visit(context, signed))
    generate_key(tmp_path / "theirs")
    rebuild(store, "default", Keys((read_signer(tmp_path / "theirs"),)))
    expect_refused(visit(context, signed), "CATALOGUE_FORGED", "not signed by whom it was before")


def test_an_entry_that_the_collection_does_not_know_is_refused(
    context: BrowserContext, signed: Site, store: LocalStore
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
