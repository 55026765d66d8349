"""What one browser keeps for one account, another one does not see; visitors see what is open to them."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, Route, expect

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.lines import Line, line_to
from tests.support.pages import await_data
from tests.support.screenshots import drawn, stage
from tests.support.sites import site_at
from tests.support.tenants import bearer, make_key
from tests.support.things import BLUE, RED, box
from tests.web.conftest import GuardedSite, with_a_past, without_a_past

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedSite]:
    """Of ada a cup; the gateway signs."""
    folder = tmp_path_factory.mktemp("signed-and-guarded")
    generate_key(folder / "ours")
    keys = Keys((read_signer(folder / "ours"),))
    secret = make_key(folder / "data", "ada", ALL_SCOPES - {Scope.OPERATE})
    with site_at(folder, keys) as site:
        publish(box("Cup", RED), store_of_tenant(site.store, "ada"), key="cup", policy=PublishPolicy(keys))
        publish(box("Jug", BLUE), store_of_tenant(site.store, "ada"), key="jug", policy=PublishPolicy(keys))
        yield GuardedSite(site, secret, folder / "data")


@pytest.fixture
def line(guarded: GuardedSite) -> Line:
    return line_to(guarded.url)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    with with_a_past(browser) as context:
        yield context


def log_in(page: Page, line: Line, key: str) -> None:
    page.goto(f"{line.url}/login")
    page.get_by_label("Access key").fill(key)
    page.get_by_role("button", name="Log in with the key").click()
    page.wait_for_url(f"{line.url}/")


def set_visibility(guarded: GuardedSite, thing: str, visibility: Visibility | None) -> None:
    url = f"{guarded.url}/v1/{thing}/visibility"
    httpx.put(url, json={"visibility": visibility}, headers=bearer(guarded.key)).raise_for_status()


def kept(page: Page) -> list[str]:
    """The names of the browser's caches of things, and of what it stores."""
    names: list[str] = page.evaluate("async () => [...await caches.keys(), ...Object.keys(localStorage)]")
    return sorted(name for name in names if not name.startswith("shell-"))


@pytest.mark.essential
def test_another_user_of_a_browser_sees_nothing_of_the_first(
    context: BrowserContext, line: Line, guarded: GuardedSite
) -> None:
    line.set_time_limits(CACHED_COPY_MS=300)
    bob = make_key(guarded.data_dir, "bob", {Scope.READ})
    page = context.new_page()
    log_in(page, line, guarded.key)
    page.goto(f"{line.url}/view/cup")
    await_data(page, loaded="2 1 0", tenant="ada", offline="ready")
    page.evaluate("localStorage.setItem('capture2vr:placed:ada', '[]')")
    assert {"assets-1:ada", "catalogue-1:ada"} <= set(kept(page))

    # Another one logs in without that the first has signed out.
    log_in(page, line, bob)
    assert not [
        name for name in kept(page) if name.endswith((":ada", "assets-1", "catalogue-1")) and "seen" not in name
    ]
    page.goto(f"{line.url}/view/cup")
    await_data(page, code="ASSET_UNKNOWN", tenant="bob")
    line.cut()
    page.goto(f"{line.url}/view/cup")
    await_data(page, state="error")
    assert drawn(stage(page)) == 0


def test_signing_out_forgets_what_was_kept(context: BrowserContext, line: Line, guarded: GuardedSite) -> None:
    page = context.new_page()
    log_in(page, line, guarded.key)
    page.goto(f"{line.url}/view/cup")
    await_data(page, loaded="2 1 0", tenant="ada", offline="ready")
    page.get_by_role("button", name="Sign out").click()
    page.wait_for_url("**/login")
    assert [name for name in kept(page) if "assets" in name or "catalogue" in name] == []
    line.cut()
    page.goto(f"{line.url}/view/cup")
    await_data(page, state="error", code="OFFLINE")


@pytest.mark.parametrize("own", [Visibility.UNLISTED, Visibility.PUBLIC])
def test_a_visitor_sees_an_open_thing_and_nothing_else(browser: Browser, guarded: GuardedSite, own: Visibility) -> None:
    set_visibility(guarded, "assets/cup", own)
    with without_a_past(browser) as context:
        page = context.new_page()
        page.goto(f"{guarded.url}/view/cup?tenant=ada")
        await_data(page, loaded="2 1 0", tenant="")
        assert drawn(stage(page)) > 0.05
        expect(page.locator("#collection")).to_be_hidden()
        page.goto(f"{guarded.url}/view/jug?tenant=ada")
        page.wait_for_url("**/login?next=*")
    set_visibility(guarded, "assets/cup", None)


def test_a_visitor_browses_an_open_collection(browser: Browser, guarded: GuardedSite) -> None:
    set_visibility(guarded, "collections/default", Visibility.PUBLIC)
    with without_a_past(browser) as context:
        page = context.new_page()
        page.goto(f"{guarded.url}/browse/default?tenant=ada")
        await_data(page, state="shown")
        expect(page.locator("#said")).to_have_text("2 objects")
        page.get_by_role("searchbox").fill("jug")
        expect(page.locator("#said")).to_have_text("1 object for “jug”")
        downloads = page.get_by_role("link", name="Download Jug")
        expect(downloads).to_have_attribute("href", "/view/jug?tenant=ada#downloads")
        page.get_by_role("link", name="Jug", exact=True).click()
        await_data(page, loaded="2 1 0")
        assert page.url == f"{guarded.url}/view/jug?tenant=ada"
        page.get_by_role("link", name="All objects").click()
        await_data(page, state="shown")
    set_visibility(guarded, "collections/default", None)


def test_what_is_signed_for_another_thing_is_not_shown(browser: Browser, guarded: GuardedSite) -> None:
    set_visibility(guarded, "assets/cup", Visibility.UNLISTED)
    with without_a_past(browser) as context:
        page = context.new_page()
        other = context.request.get(f"{guarded.url}/v1/assets/cup?tenant=ada").json()["proof"]

        def swap(route: Route) -> None:
            entry = route.fetch().json()
            route.fulfill(json={**entry, "proof": {**other, "signed": other["signed"].replace("cup", "jug")}})

        page.route("**/v1/assets/cup?*", swap)
        page.goto(f"{guarded.url}/view/cup?tenant=ada")
        await_data(page, code="CATALOGUE_FORGED")
    set_visibility(guarded, "assets/cup", None)
