"""Pages in the reader's language: English as their files have it, German by two tables.

services/web/texts.json has the sentences of the pages, services/web/server-texts.json those of gateway and worker which
the pages show: what is wrong with a capture, what to do about it, how a thing was made.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

TEXTS = Path(__file__).parents[1] / "web" / "texts.json"
SERVER_TEXTS = TEXTS.with_name("server-texts.json")
LANGUAGES = ("en", "de")

_ELEMENT = re.compile(
    r"(<(title|h1|h2|p|label|legend|summary|option|button|a|strong|code)\b[^>]*>)(.*?)(</\2>)", re.DOTALL
)
_RUN = re.compile(r"(>)([^<>]+)(<)")
_ATTRIBUTE = re.compile(r'(\s(?:aria-label|aria-roledescription|alt|placeholder|title)=")([^"]+)(")')
_HEAD = re.compile(r'<html lang="en">\s*<head>')

Translations = Mapping[str, str]


def preferred_language(accept: str, languages: tuple[str, ...] = LANGUAGES) -> str:
    """Return the one of these languages that an Accept-Language header wants most; the first of them for none."""
    wanted = [_parse_range(each) for each in accept.split(",")]
    for _, language in sorted(wanted, key=lambda each: -each[0]):
        if language in languages:
            return language
    return languages[0]


def _parse_range(text: str) -> tuple[float, str]:
    """Split a language range such as `de-AT;q=0.8` into its weight, from 0 to 1, and its language without a region."""
    tag, _, weight = text.partition(";")
    try:
        quality = float(weight.strip().removeprefix("q=") or 1)
    except ValueError:
        quality = 0.0
    return quality, tag.strip().split("-")[0].lower()


@lru_cache(maxsize=1)
def german_texts() -> Translations:
    """Read the table of German texts by their English ones."""
    return _read_table(TEXTS)


@lru_cache(maxsize=1)
def german_server_texts() -> Translations:
    """Read the table of the German sentences of gateway and worker by their English ones."""
    return _read_table(SERVER_TEXTS)


def _read_table(path: Path) -> Translations:
    table: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
    return table


def _table_element(name: str, table: Translations) -> str:
    """Return an element that hands a table to the scripts of a page."""
    content = json.dumps(table, ensure_ascii=False).replace("<", "\\u003c")
    return f'<script id="{name}" type="application/json">{content}</script>'


@lru_cache(maxsize=32)  # more than there are pages
def translate_page(html: str, language: str) -> str:
    """Return a page in a language, with the tables that its scripts translate by, in the elements "texts" and, where it
    delays nothing that is seen, "server-texts".
    """
    if language == LANGUAGES[0]:
        return html
    head = f'<html lang="{language}">\n<head>\n  {_table_element("texts", german_texts())}'
    before, separator, body = html.partition("<title>")
    page = _HEAD.sub(lambda _: head, before) + translate_markup(separator + body, german_texts().get)
    seen, end, rest = page.rpartition("</body>")
    return f"{seen}{_table_element('server-texts', german_server_texts())}\n{end}{rest}"


def translate_markup(html: str, find: Callable[[str], str | None]) -> str:
    """Replace all texts of a page that `find` knows: those of whole elements, with the markup inside them, of the
    pieces between tags, and of attributes that people read or hear.
    """

    def element(found: re.Match[str]) -> str:
        inside = find(one_line(found[3]))
        return found[1] + (_ELEMENT.sub(element, found[3]) if inside is None else inside) + found[4]

    def piece(found: re.Match[str]) -> str:
        text = one_line(found[2])
        translated = find(text) if text else None
        return found[0] if translated is None else found[0].replace(found[2].strip(), translated)

    return _ATTRIBUTE.sub(piece, _RUN.sub(piece, _ELEMENT.sub(element, html)))


def one_line(text: str) -> str:
    """Return a text as the table has it: without the line breaks and the indents of a page's file."""
    return " ".join(text.split())
