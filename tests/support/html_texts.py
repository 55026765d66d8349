"""The texts of a page that people read or hear."""

from __future__ import annotations

import re
from html.parser import HTMLParser

from capture2vr.gateway.page_texts import one_line

HEARD = ("aria-label", "aria-roledescription", "alt", "placeholder", "title")
"""Attributes that people read or hear."""


class Texts(HTMLParser):
    """All texts of a page that people read or hear, each on one line."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self._in_script = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._in_script = tag == "script"
        self.found += [one_line(value) for name, value in attrs if name in HEARD and value]

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if not self._in_script and re.search("[A-Za-z]{2}", data):
            self.found.append(one_line(data))
