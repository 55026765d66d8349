"""Share links in the browser: made on the thing's page, opened without a login, revoked, refused."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data, open_panel, press_twice, requests_of
from tests.support.qr_codes import picture_of, text_of
from tests.support.screenshots import drawn, stage
from tests.support.things import GREEN, box
from tests.web.conftest import PHONE, GuardedSite, without_a_past

pytestmark = pytest.mark.browser


@pytest.fixture
def owner(context: BrowserContext, guarded: GuardedSite) -> Page:
    """The page of a bowl with the panel to share it."""
    publish(box("Bowl", GREEN), guarded.store, key="bowl")
    guarded.log_in(context)
    page = context.new_page()
    page.goto(f"{guarded.url}/view/bowl")
    await_data(page, loaded="2 1 0", tenant="ada")
    open_panel(page, "Share")
    expect(page.locator("#share")).to_have_attribute("open", "")
    expect(page.locator("body")).to_have_attribute("data-links", "0")
    return page


@pytest.fixture
def visitor(browser: Browser) -> Iterator[Page]:
    """A page of a browser that is logged in nowhere."""
    with without_a_past(browser, PHONE, has_touch=True) as context:
        yield context.new_page()


def make_link(owner: Page) -> None:
    owner.get_by_role("button", name="Make a link").click()
    await_data(owner, links="1")


def revoke(owner: Page) -> None:
    owner.get_by_role("button", name="Revoke").click()
    await_data(owner, links="0")


def test_links_that_do_not_come_are_asked_for_at_the_next_opening(owner: Page) -> None:
    owner.reload()
    await_data(owner, loaded="2 1 0", tenant="ada")
    owner.route("**/v1/shares?*", lambda route: route.abort(), times=1)
    owner.get_by_text("Share", exact=True).click()
    expect(owner.locator("#share-trouble")).to_contain_text("The server cannot be reached.")
    expect(owner.locator("#share-form")).to_have_attribute("inert", "")
    owner.get_by_text("Share", exact=True).click()
    open_panel(owner, "Share")
    make_link(owner)
    revoke(owner)


def test_who_presses_twice_makes_one_link(owner: Page) -> None:
    posts = requests_of(owner, "POST")
    press_twice(owner.get_by_role("button", name="Make a link"))
    await_data(owner, links="1")
    assert len(posts) == 1
    revoke(owner)


@pytest.mark.essential
def test_a_link_is_opened_without_a_login_until_it_is_revoked(owner: Page, visitor: Page, guarded: GuardedSite) -> None:
    make_link(owner)
    address = text_of(picture_of(owner.get_by_role("img", name="QR code of the link")))
    assert address == owner.locator("#links a").get_attribute("href")
    visitor.goto(address)
    visitor.wait_for_url(f"{guarded.url}/view/bowl?tenant=ada")
    await_data(visitor, loaded="2 1 0", tenant="")
    assert drawn(stage(visitor)) > 0.05
    expect(visitor.get_by_role("button", name="Move")).to_be_hidden()
    expect(visitor.locator("#collection")).to_be_hidden()
    expect(visitor.locator("#share")).to_be_hidden()

    owner.reload()
    await_data(owner, loaded="2 1 0", tenant="ada")
    open_panel(owner, "Share")
    expect(owner.locator("#links li p")).to_contain_text("opened 1 time")
    revoke(owner)
    visitor.reload()
    await_data(visitor, state="error", code="SHARE_REVOKED")
    expect(visitor.locator("#said")).to_contain_text("the link was taken back")
    assert drawn(stage(visitor)) == 0
    visitor.goto(address)
    await_data(visitor, state="error", code="SHARE_REVOKED")
    expect(visitor.locator("#said")).to_contain_text("Ask whoever shared it for a new link.")


@pytest.mark.parametrize("tenant", ["bob", "ada"])
def test_a_session_that_has_ended_keeps_nobody_from_what_is_shared(
    owner: Page, visitor: Page, guarded: GuardedSite, tenant: str
) -> None:
    make_link(owner)
    ended = {"c2v_session": "ended", "c2v_tenant": tenant}
    visitor.context.add_cookies([{"name": name, "value": value, "url": guarded.url} for name, value in ended.items()])
    visitor.goto(str(owner.locator("#links a").get_attribute("href")))
    await_data(visitor, loaded="2 1 0", tenant="")
    expect(visitor.get_by_role("button", name="Log in")).to_be_visible()
    assert visitor.url == f"{guarded.url}/view/bowl?tenant=ada"
    revoke(owner)


def test_a_password_is_typed_and_things_may_be_moved(owner: Page, visitor: Page, guarded: GuardedSite) -> None:
    owner.get_by_label("A link for somebody who may").select_option("place")
    owner.get_by_label("Password, if there is to be one").fill("open sesame")
    make_link(owner)
    visitor.goto(str(owner.locator("#links a").get_attribute("href")))
    for password, code in (("", "SHARE_PASSWORD_MISSING"), ("sesame", "SHARE_PASSWORD_WRONG"), ("open sesame", "")):
        if password:
            visitor.get_by_label("The password").fill(password)
            tried = requests_of(visitor, "POST")
            press_twice(visitor.get_by_role("button", name="Open"))
        if code:
            await_data(visitor, state="asking", code=code)
        if password:
            visitor.wait_for_function("() => document.body?.dataset.state !== 'sending'")
            assert len(tried) == 1
    await_data(visitor, loaded="2 1 0")
    expect(visitor.get_by_role("button", name="Move")).to_be_visible()
    revoke(owner)


def test_a_link_that_never_was_leads_nowhere(visitor: Page, guarded: GuardedSite) -> None:
    answer = visitor.goto(f"{guarded.url}/s/nonsense")
    assert answer is not None
    assert answer.status == 404
    await_data(visitor, state="error", code="SHARE_UNKNOWN")


def test_who_may_see_it_is_chosen_on_its_page(owner: Page, visitor: Page, guarded: GuardedSite) -> None:
    with owner.expect_response("**/visibility"):
        owner.get_by_label("Who may see it").select_option("unlisted")
    visitor.goto(f"{guarded.url}/view/bowl?tenant=ada")
    await_data(visitor, loaded="2 1 0")
    with owner.expect_response("**/visibility"):
        owner.get_by_label("Who may see it").select_option("private")
    visitor.reload()
    visitor.wait_for_url("**/login?next=*")


def test_links_leave_the_caption_and_the_tools_where_they_are(browser: Browser, guarded: GuardedSite) -> None:
    publish(box("Bowl", GREEN), guarded.store, key="bowl")
    with without_a_past(browser, PHONE, has_touch=True) as context:
        guarded.log_in(context)
        page = context.new_page()
        page.goto(f"{guarded.url}/view/bowl")
        await_data(page, loaded="2 1 0", tenant="ada")
        open_panel(page, "Share")
        expect(page.locator("body")).to_have_attribute("data-links", "0")
        make_link(page)
        header, footer = (page.locator(each).bounding_box() for each in ("header", "footer"))
        assert header is not None
        assert footer is not None
        assert header["y"] + header["height"] <= footer["y"]
        revoke(page)
