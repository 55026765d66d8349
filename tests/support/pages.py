"""Waiting for what a page in the browser does, and how long the page itself waits."""

from __future__ import annotations

import re

from playwright.sync_api import Error, Page

from services.gateway.routes.pages import WEB

_TIME_LIMITS = WEB / "shared" / "time-limits.js"

_HAS = "told => Object.entries(told).every(([name, value]) => document.body?.dataset[name] === value)"


def await_data(page: Page, **told: str) -> None:
    """Wait until the page's body has these data attributes. Looks every 20 ms; Playwright's `expect` slows down to 1 s.

    Raises AssertionError with what the body has instead.
    """
    try:
        page.wait_for_function(_HAS, arg=told, polling=20)
    except Error:
        raise AssertionError(f"the page has {page.evaluate('({ ...document.body.dataset })')}, not {told}") from None


def time_limit_ms(name: str) -> int:
    """A time limit of the pages, as shared/time-limits.js has it."""
    found = re.search(rf"export const {name} = ([\d_]+);", _TIME_LIMITS.read_text())
    assert found, f"there is no time limit {name}"
    return int(found[1])
