"""The login page, and how pages that need a session lead there and come back."""

from __future__ import annotations

import httpx
import pytest
from playwright.sync_api import BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data, press_twice, requests_of
from tests.support.sites import Site
from tests.support.tenants import bearer
from tests.support.things import RED, box
from tests.web.conftest import GuardedSite

pytestmark = pytest.mark.browser


def log_in(page: Page, key: str) -> None:
    page.get_by_label("Access key").fill(key)
    page.get_by_role("button", name="Log in with the key").click()


@pytest.mark.essential
def test_a_page_leads_to_the_login_and_comes_back(page: Page, guarded: GuardedSite) -> None:
    publish(box("Cup", RED), guarded.store, key="cup")
    page.goto(f"{guarded.url}/view/cup?from=a%26b#there")
    page.wait_for_url("**/login?next=*")
    log_in(page, guarded.key)
    page.wait_for_url(f"{guarded.url}/view/cup?from=a%26b#there")
    await_data(page, loaded="2 1 0", tenant="ada")
    assert page.locator("#label").inner_text() == "Cup"
    assert guarded.key not in page.evaluate("JSON.stringify([document.cookie, { ...localStorage }])")

    page.get_by_role("button", name="Sign out").click()
    page.wait_for_url(f"{guarded.url}/login")
    page.goto(f"{guarded.url}/browse/default")
    page.wait_for_url("**/login?next=%2Fbrowse%2Fdefault")


def test_the_capture_page_needs_a_login_before_files_are_chosen(page: Page, guarded: GuardedSite) -> None:
    page.goto(f"{guarded.url}/")
    page.wait_for_url("**/login?next=%2F")


@pytest.mark.parametrize("key", ["nonsense", "c2v_ada_" + "x" * 43])
def test_a_wrong_key_is_told(page: Page, guarded: GuardedSite, key: str) -> None:
    page.goto(f"{guarded.url}/login")
    log_in(page, key)
    await_data(page, state="asking", code="KEY_MALFORMED" if key == "nonsense" else "KEY_UNKNOWN")
    expect(page.get_by_role("alert")).to_contain_text("key")


def test_a_code_is_sent_once_and_only_when_it_is_whole(page: Page, guarded: GuardedSite) -> None:
    made = httpx.post(f"{guarded.url}/v1/pairings", json={"scopes": ["read"]}, headers=bearer(guarded.key)).json()
    page.goto(f"{guarded.url}/login?next=/browse/default")
    posts = requests_of(page, "POST")
    digits, button = page.get_by_label("Ten digits"), page.get_by_role("button", name="Log in with the digits")
    digits.fill(made["code"][:5])
    button.click()
    expect(page.get_by_role("alert")).to_have_text("A code has ten digits.")
    expect(digits).to_be_focused()
    digits.fill(f"  {made['code'][:3]} - {made['code'][3:]} ")
    press_twice(button)
    page.wait_for_url("**/browse/default")
    assert posts == [f"{guarded.url}/v1/pairings/claim"]


def test_an_ended_session_leads_to_the_login(page: Page, context: BrowserContext, guarded: GuardedSite) -> None:
    context.add_cookies([{"name": "c2v_session", "value": "altered", "url": guarded.url}])
    page.goto(f"{guarded.url}/browse/default")
    page.wait_for_url("**/login?next=*")
    log_in(page, guarded.key)
    page.wait_for_url("**/browse/default")
    await_data(page, tenant="ada")


@pytest.mark.parametrize(
    "next_", ["//evil.example/x", "https://evil.example", "javascript:0", "/\\evil.example", "/.//evil.example/x"]
)
def test_a_link_to_the_login_leads_to_no_other_site(page: Page, guarded: GuardedSite, next_: str) -> None:
    page.goto(f"{guarded.url}/login")
    page.evaluate("next => history.replaceState(null, '', '/login?' + new URLSearchParams({ next }))", next_)
    log_in(page, guarded.key)
    page.wait_for_url(f"{guarded.url}/")


def test_where_no_keys_are_asked_for_no_page_speaks_of_them(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/browse/nothing-here")
    await_data(page, state="error", code="COLLECTION_UNKNOWN")
    expect(page.locator("#account")).to_be_hidden()
    page.goto(f"{site.url}/login")
    expect(page.locator("#present")).to_have_text("This server asks nobody for a key.")
