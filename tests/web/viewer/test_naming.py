"""The panel that names a thing: who manages it changes its names on its page, and nobody else sees the panel."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.order.asset_names import AssetNames
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.change_entry import change_names
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.pages import await_data, open_panel
from tests.support.sites import Site
from tests.support.tenants import make_key
from tests.support.things import GREEN, box
from tests.web.conftest import PHONE, GuardedSite, without_a_past

pytestmark = pytest.mark.browser
HOSTILE = '<img src=x onerror="document.body.dataset.bad=1">'


def open_names(page: Page) -> None:
    open_panel(page, "Name it")
    expect(page.get_by_label("Name", exact=True)).not_to_have_value("")


def test_a_thing_is_named_where_it_is_shown(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="named")
    page.goto(f"{site.url}/view/named")
    await_data(page, loaded="2 1 0")
    open_names(page)
    page.get_by_label("Name", exact=True).fill(f" Bowl {HOSTILE}")
    page.get_by_label("Description").fill("Two\nlines.")
    page.get_by_label("Tags, with commas").fill("blue, Blue, kitchen")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#names-saved")).to_have_text("Saved.")
    expect(page.get_by_label("Tags, with commas")).to_have_value("blue, kitchen")
    expect(page.locator("#label")).to_have_text(f"Bowl {HOSTILE}")
    expect(page.locator("#description")).to_have_text("Two\nlines.")
    assert page.locator("body").get_attribute("data-bad") is None
    names = AssetNames(f"Bowl {HOSTILE}", "Two\nlines.", ("blue", "kitchen"))
    assert read_entry(site.store, "named").names == names
    page.reload()
    await_data(page, loaded="2 1 0")
    expect(page.locator("#label")).to_have_text(f"Bowl {HOSTILE}")


def test_what_is_no_name_is_said_and_nothing_is_lost(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="kept")
    page.goto(f"{site.url}/view/kept")
    await_data(page, loaded="2 1 0")
    open_names(page)
    page.get_by_label("Tags, with commas").fill("a" * 60)
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#names-trouble")).to_contain_text("at most 50 characters, and this one has 60")
    expect(page.get_by_label("Tags, with commas")).to_have_value("a" * 60)
    assert read_entry(site.store, "kept").names.labels == ()


def test_what_does_not_come_at_first_comes_at_the_next_opening_and_nothing_is_wiped(
    page: Page, site: Site, bundle: Bundle
) -> None:
    publish(bundle, site.store, key="torn")
    change_names(site.store, "torn", site.keys, label="Dress", description="Torn at the hem.", labels=("silk",))
    page.goto(f"{site.url}/view/torn")
    await_data(page, loaded="2 1 0")
    for address in ("**/viewer/naming.js", "**/v1/assets/torn"):
        page.route(address, lambda route: route.abort())
        page.get_by_text("Name it", exact=True).click()
        expect(page.locator("#names-trouble")).to_have_text(
            "The server cannot be reached. Check the connection and try again."
        )
        expect(page.locator("#names-form")).to_have_attribute("inert", "")
        page.unroute(address)
        page.get_by_text("Name it", exact=True).click()
    open_names(page)
    expect(page.locator("#names-trouble")).to_be_hidden()
    sent: list[Any] = []
    page.on("request", lambda request: sent.append(request.post_data_json) if request.method == "PATCH" else None)
    page.get_by_label("Name", exact=True).fill("Wedding dress")
    change_names(site.store, "torn", site.keys, description="Mended.")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#names-saved")).to_have_text("Saved.")
    assert sent == [{"label": "Wedding dress"}], "once, and nothing that somebody else may have changed meanwhile"
    assert read_entry(site.store, "torn").names == AssetNames("Wedding dress", "Mended.", ("silk",))
    expect(page.get_by_label("Description")).to_have_value("Mended.")


def test_nothing_of_another_who_logs_in_is_renamed(page: Page, guarded: GuardedSite) -> None:
    """In another tab of the same browser; the things of both have the same key."""
    bob = make_key(guarded.data_dir, "bob", ALL_SCOPES - {Scope.OPERATE})
    bobs = store_of_tenant(guarded.site.store, "bob")
    for store in (guarded.store, bobs):
        publish(box("Mug", GREEN), store, key="mug")
    guarded.log_in(page.context)
    page.goto(f"{guarded.url}/view/mug")
    await_data(page, loaded="2 1 0", tenant="ada")
    open_names(page)
    page.get_by_label("Name", exact=True).fill("Ada's mug")
    page.context.request.post(f"{guarded.url}/v1/session", data={"key": bob})
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#names-trouble")).to_have_text(
        "Nothing was changed: in another tab of this browser, somebody else has logged in. "
        "Log in again, or load this page anew."
    )
    expect(page.get_by_label("Name", exact=True)).to_have_value("Ada's mug")
    assert read_entry(bobs, "mug").names.label == "Mug"
    guarded.log_in(page.context)
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#names-saved")).to_have_text("Saved.")
    assert read_entry(guarded.store, "mug").names.label == "Ada's mug"


def test_only_who_manages_it_sees_the_panel(context: BrowserContext, browser: Browser, guarded: GuardedSite) -> None:
    publish(box("Cup", GREEN), guarded.store, key="cup", visibility=Visibility.PUBLIC)
    guarded.log_in(context)
    owner = context.new_page()
    owner.goto(f"{guarded.url}/view/cup")
    await_data(owner, loaded="2 1 0", tenant="ada")
    open_names(owner)
    with without_a_past(browser, PHONE, has_touch=True) as anonymous:
        visitor = anonymous.new_page()
        visitor.goto(f"{guarded.url}/view/cup?tenant=ada")
        await_data(visitor, loaded="2 1 0")
        expect(visitor.locator("#names")).to_be_hidden()
