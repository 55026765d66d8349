"""Pairing in the browser: the operator's screen shows a code, a phone scans it, a headset's wearer types digits."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.support.pages import await_data
from tests.support.qr_codes import picture_of, text_of
from tests.support.sites import Site
from tests.support.tenants import bearer
from tests.web.conftest import PHONE, GuardedSite, without_a_past

pytestmark = pytest.mark.browser


@pytest.fixture
def operator(context: BrowserContext, guarded: GuardedSite) -> Page:
    """The screen of somebody who is logged in, with a code on it."""
    guarded.log_in(context)
    page = context.new_page()
    page.goto(f"{guarded.url}/pair")
    await_data(page, state="waiting", tenant="ada")
    return page


@pytest.fixture
def phone(browser: Browser) -> Iterator[Page]:
    """A page of another browser, which is logged in nowhere."""
    with without_a_past(browser, PHONE, has_touch=True) as context:
        yield context.new_page()


@pytest.mark.essential
def test_a_phone_that_scans_the_code_is_logged_in(operator: Page, phone: Page, guarded: GuardedSite) -> None:
    expect(operator.locator("#unreachable")).to_be_visible()
    operator.get_by_label("A name for it").fill("Ada's phone")
    operator.get_by_label("The device may").select_option(label="only look at objects")
    before = operator.locator("#code").inner_text()
    operator.get_by_role("button", name="Show a new code").click()
    expect(operator.locator("#code")).not_to_have_text(before)

    address = text_of(picture_of(operator.locator("#qr")))
    phone.goto(address)
    await_data(phone, state="done", tenant="ada")
    assert phone.url == f"{guarded.url}/pair", "the token does not stay in the address"
    await_data(operator, state="paired")
    expect(operator.locator("#said")).to_have_text("Ada's phone is paired.")

    phone.get_by_role("link", name="All objects so far").click()
    await_data(phone, tenant="ada")
    session = phone.context.request.get(f"{guarded.url}/v1/session").json()
    assert (session["via"], session["scopes"]) == ("session", ["read"])
    phone.goto("about:blank")  # else only what is behind the # would change
    phone.goto(address)
    await_data(phone, state="asking")
    phone.get_by_role("button", name="Log in as the other one").click()
    await_data(phone, state="error")
    expect(phone.locator("#said")).to_contain_text("was used")

    httpx.post(f"{guarded.url}/v1/api-keys/{session['key']}/revoke", headers=bearer(guarded.key)).raise_for_status()
    phone.goto(f"{guarded.url}/browse/default")
    phone.wait_for_url("**/login?next=*")


@pytest.mark.parametrize("status", [429, 502])
def test_a_code_stays_while_a_proxy_or_a_limit_answers(operator: Page, phone: Page, status: int) -> None:
    operator.route("**/v1/pairings/pair_*", lambda route: route.fulfill(status=status, body="<html>"), times=1)
    with operator.expect_response(lambda answer: answer.status == status):
        pass
    with operator.expect_response(lambda answer: "/v1/pairings/pair_" in answer.url and answer.ok):
        pass
    phone.goto(text_of(picture_of(operator.locator("#qr"))))
    await_data(operator, state="paired")


def test_a_headset_is_logged_in_by_ten_digits(operator: Page, phone: Page, guarded: GuardedSite) -> None:
    digits = operator.locator("#code").inner_text()
    assert len(digits.replace(" ", "")) == 10
    assert operator.locator("#login-address").inner_text() == f"{guarded.url}/login"
    phone.goto(f"{guarded.url}/view/cup")
    phone.wait_for_url("**/login?next=*")
    wrong = f"{(int(digits.replace(' ', '')) + 1) % 10**10:010}"
    for code in (wrong, digits):
        phone.get_by_label("Ten digits").fill(code)
        phone.get_by_role("button", name="Log in with the digits").click()
        if code == wrong:
            await_data(phone, code="PAIRING_UNKNOWN")
    phone.wait_for_url("**/view/cup")
    await_data(operator, state="paired")


def test_a_screen_that_is_logged_in_nowhere_is_asked_for_a_login_first(phone: Page, guarded: GuardedSite) -> None:
    phone.goto(f"{guarded.url}/pair")
    phone.wait_for_url("**/login?next=%2Fpair")


def test_a_link_does_not_replace_a_login_unasked(operator: Page, guarded: GuardedSite) -> None:
    made = httpx.post(f"{guarded.url}/v1/pairings", json={"scopes": ["read"]}, headers=bearer(guarded.key)).json()
    operator.goto("about:blank")
    operator.goto(made["url"])
    await_data(operator, state="asking")
    expect(operator.locator("#present")).to_contain_text("logged in as ada")
    found = httpx.get(f"{guarded.url}/v1/pairings/{made['id']}", headers=bearer(guarded.key)).json()
    assert not found["claimed"]


def test_where_no_keys_are_asked_for_there_is_nothing_to_pair(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/pair")
    await_data(page, state="error")
    expect(page.locator("#said")).to_contain_text("nothing to pair")
