"""Waiting for what a page in the browser does, and how long the page itself waits."""

from __future__ import annotations

import re

from playwright.sync_api import Error, Locator, Page

from capture2vr.gateway.page_texts import WEB

_TIME_LIMITS = WEB / "shared" / "time-limits.js"

_HAS = "told => Object.entries(told).every(([name, value]) => document.body?.dataset[name] === value)"
_IS_FILLED = """name => [...document.querySelectorAll('summary')].some((each) =>
    each.textContent.trim() === name && !each.parentElement.querySelector(':scope > [inert]'))"""


def await_data(page: Page, **told: str) -> None:
    """Wait until the page's body has these data attributes. Looks every 20 ms; Playwright's `expect` slows down to 1 s.

    Raises AssertionError with what the body has instead.
    """
    try:
        page.wait_for_function(_HAS, arg=told, polling=20)
    except Error:
        raise AssertionError(f"the page has {page.evaluate('({ ...document.body.dataset })')}, not {told}") from None


def open_panel(page: Page, name: str) -> None:
    """Open a panel of a page, or close it, and wait until its module has filled it.

    Until then nobody can type into it, and Playwright's `fill` does not mind: what it types is lost.
    """
    page.get_by_text(name, exact=True).click()
    page.wait_for_function(_IS_FILLED, arg=name, polling=20)


def press_twice(button: Locator) -> None:
    """Press a button two times, before the server can have answered the first."""
    button.evaluate("button => { button.click(); button.click(); }")


def requests_of(page: Page, method: str) -> list[str]:
    """The addresses to which the page sends such requests from now on, as they come."""
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url) if request.method == method else None)
    return sent


def time_limit_ms(name: str) -> int:
    """A time limit of the pages, as shared/time-limits.js has it."""
    found = re.search(rf"export const {name} = ([\d_]+);", _TIME_LIMITS.read_text())
    assert found, f"there is no time limit {name}"
    return int(found[1])
