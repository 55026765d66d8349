"""Pages in the reader's language: English as their files have it, German by `services/web/texts.json`.

A page has its own language alone, and of it the sentences of its own scripts. Sentences of gateway and worker come in
the reader's language with the answers that have them; those in stored manifests, which cannot be translated on the way,
are translated by the scripts, with a catalogue that they load when they need it.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

from capture2vr.gateway.languages import LANGUAGES, catalogue_of
from capture2vr.gateway.page_modules import modules_of_page

WEB = Path(__file__).parents[1] / "web"
TEXTS = WEB / "texts.json"

_ELEMENT = re.compile(
    r"(<(title|h1|h2|p|label|legend|summary|option|button|a|strong|code)\b[^>]*>)(.*?)(</\2\s*>)", re.DOTALL
)
_RUN = re.compile(r"(>)([^<>]+)(<)")
_ATTRIBUTE = re.compile(r'(\s(?:aria-label|aria-roledescription|alt|placeholder|title)=")([^"]+)(")')
_HEAD = re.compile(r'<html lang="en">\s*<head>')
_SENTENCE = re.compile(r"\bt\(\s*'((?:[^'\\]|\\.)*)'")

Translations = Mapping[str, str]


@lru_cache(maxsize=1)
def german_texts() -> Translations:
    """Read the table of German texts by their English ones."""
    table: dict[str, str] = json.loads(TEXTS.read_text(encoding="utf-8"))
    return table


@lru_cache(maxsize=len(LANGUAGES))
def stored_sentences(language: str) -> bytes:
    """Return the catalogue by which scripts translate what is stored, as JSON: a language's sentences by code."""
    return json.dumps(catalogue_of(language), ensure_ascii=False, separators=(",", ":")).encode()


def sentences_address(language: str) -> str:
    """Return the address of that catalogue, which changes with its content."""
    return f"/web/sentences/{language}-{hashlib.sha256(stored_sentences(language)).hexdigest()[:16]}.json"


@lru_cache(maxsize=32)  # more than there are pages
def translate_page(html: str, language: str) -> str:
    """Return a page in a language. Its element "texts" has the sentences of its scripts; `data-sentences` of <html> is
    the address of the stored ones.
    """
    if language == LANGUAGES[0]:
        return html
    content = json.dumps(texts_of_scripts(html), ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    head = (
        f'<html lang="{language}" data-sentences="{sentences_address(language)}">\n<head>\n'
        f'  <script id="texts" type="application/json">{content}</script>'
    )
    before, separator, body = html.partition("<title>")
    return _HEAD.sub(lambda _: head, before) + translate_markup(separator + body, german_texts().get)


def texts_of_scripts(html: str) -> Translations:
    """Return the part of the table that the scripts of a page may ask for."""
    scripts = [html, *(module.read_text(encoding="utf-8") for module in modules_of_page(html, WEB))]
    said = {text.replace("\\'", "'") for script in scripts for text in _SENTENCE.findall(script)}
    return {english: german for english, german in german_texts().items() if english in said}


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
    """Return a text as the table has it: without line breaks and indents, and with `<br>` for `<br />`."""
    return " ".join(text.split()).replace(" />", ">")
