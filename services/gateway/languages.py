"""The languages that pages and answers are in: English, and those with a gettext catalogue in `sentences/locale/`.

Answers of the API are in English unless a request's Accept-Language wants another language, as browsers' do; programs
tell sentences apart by their codes, which are the same in each.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import Any

from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po
from babel.numbers import get_decimal_symbol, get_group_symbol
from babel.support import Translations

from capture2vr.sentences.documents import translated
from capture2vr.sentences.sentence import HERE, Find, Sentence, english, translate

LANGUAGES = ("en", "de")

_LOCALE = HERE / "locale"


@dataclass(slots=True)
class Reader:
    """Who reads an answer. was_asked: whether the answer depends on the language, so that caches must know"""

    language: str = LANGUAGES[0]
    was_asked: bool = False


_nobody = Reader()
reader: ContextVar[Reader] = ContextVar("reader", default=_nobody)
"""The reader of the answer to the request that is handled now; outside of requests all is English."""


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


def for_reader(document: Any) -> Any:
    """Return a sentence, or a JSON document with its sentences, in the reader's language; with the codes beside."""
    now = reader.get()
    if now is not _nobody:
        now.was_asked = True
    return translated(document, lambda text: in_language(text, now.language))


def in_language(text: str, language: str) -> str:
    """Translate a sentence; names, and sentences without a translation, stay as they are."""
    if language == LANGUAGES[0]:
        return text.english if isinstance(text, Sentence) else text
    marks = str.maketrans({",": get_group_symbol(language), ".": get_decimal_symbol(language)})
    return translate(text, _finder(language), lambda number: number.translate(marks))


def catalogue_of(language: str) -> Mapping[str, str]:
    """Return a language's sentences by code."""
    find = _finder(language)
    return {code: find(code, text) for code, text in english().items()}


def _finder(language: str) -> Find:
    translations = _translations(language)
    return lambda code, text: str(translations.pgettext(code, text))


@cache
def _translations(language: str) -> Translations:
    """Load a language's catalogue; it is compiled in memory, so that no compiled file can be out of date."""
    compiled = BytesIO()
    with (_LOCALE / language / "LC_MESSAGES" / "messages.po").open("rb") as catalogue:
        write_mo(compiled, read_po(catalogue, locale=language))
    compiled.seek(0)
    return Translations(compiled)
