"""Sentences for people, each with a stable code and its values, so that they can be translated wherever they arrive.

`english.json` has the English of every code, with `{names}` for values; other languages are gettext catalogues in
`locale/`. A sentence is a text: where only English is wanted, in a log or on a command line, it is used as it is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, TypeAlias

HERE = files("capture2vr.sentences")
"""The folder of the catalogues; in a wheel that is run as it is, a folder of the zip."""

Value: TypeAlias = "str | int | float | Sentence"
Find: TypeAlias = Callable[[str, str], str]
"""Finds the text of a code in a language: (code, English) -> text, which is the English where there is no other."""

_ROW, _CAPITAL = "row", "capital"
"""Codes of sentences in a row and of one with a capital letter, in no catalogue: only their parts are translated."""


class Sentence(str):
    """A sentence in English that knows its code and values.

    code    stable, lower case, of `english.json`: "has_no_points"
    values  by the names in the catalogue: texts, numbers, or sentences that this one quotes
    """

    __slots__ = ("code", "values")

    code: str
    values: Mapping[str, Any]

    def __new__(cls, text: str, code: str, values: Mapping[str, Any]) -> Sentence:
        sentence = super().__new__(cls, text)
        sentence.code = code
        sentence.values = values
        return sentence

    def __str__(self) -> str:
        """Return the sentence itself: `str` of an exception that was raised with it keeps its code."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle code and values too: an error may be raised in another process than where it is shown."""
        return Sentence, (self.english, self.code, self.values)

    @property
    def english(self) -> str:
        """The text alone."""
        return str.__str__(self)

    @property
    def coded(self) -> dict[str, Any]:
        """Code and values as JSON has them. A sentence among the values is an object with its English as `text`."""
        return {"code": self.code, "values": {name: _value_to_json(value) for name, value in self.values.items()}}


def say(code: str, /, **values: object) -> Sentence:
    """Make a sentence from its code and its values. Raises KeyError for an unknown code or a missing value."""
    kept = {name: _plain(value) for name, value in values.items()}
    return Sentence(english()[code].format(**kept), code, kept)


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """Give a sentence values that its text does not show, for a page that shows them beside it: JSON's own types but
    for objects."""
    return Sentence(text, text.code, {**text.values, **values}) if isinstance(text, Sentence) else text


def in_row(joint: str, parts: Iterable[str]) -> Sentence:
    """Join sentences and names to one text, as `joint.join` does; each keeps its code."""
    all_parts = [_plain(part) for part in parts]
    return Sentence(joint.join(map(str, all_parts)), _ROW, {"joint": joint, "parts": all_parts})


def sentence_or_text(text: str) -> str:
    """Make the sentence of a code without values, as a file has it; a text that is no code stays as it is."""
    return say(text) if text in english() else text


def capitalised(text: str) -> str:
    """Begin a sentence that was a part of one with a capital letter."""
    return Sentence(text[:1].upper() + text[1:], _CAPITAL, {"part": _plain(text)})


def map_texts(text: str, change: Callable[[str], str]) -> str:
    """Change a text, and all texts among its values, so that its translations are changed too."""
    if not isinstance(text, Sentence):
        return change(text)
    return Sentence(change(text.english), text.code, {name: _map(value, change) for name, value in text.values.items()})


def _map(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, list):
        return [_map(each, change) for each in value]
    return map_texts(value, change) if isinstance(value, str) else value


def read_sentence(text: str, coded: Mapping[str, Any] | None) -> str:
    """Make a sentence from its English and its `coded` form; without the latter, or if it is malformed, the text."""
    try:
        values = {str(name): _value_from_json(value) for name, value in (coded or {})["values"].items()}
        return Sentence(text, str((coded or {})["code"]), values)
    except (AttributeError, KeyError, TypeError):
        return text


def translate(text: str, find: Find, number: Callable[[str], str] = str) -> str:
    """Return a sentence in another language; a text without a code, such as a name, as it is.

    number: turns a number as English writes it (1,000.5) into the other language's
    """
    if not isinstance(text, Sentence):
        return text
    if text.code == _ROW:
        return str(text.values["joint"]).join(translate(part, find, number) for part in text.values["parts"])
    if text.code == _CAPITAL:
        part = translate(text.values["part"], find, number)
        return part[:1].upper() + part[1:]
    found = find(text.code, english().get(text.code, ""))
    try:
        shown = {name: _Shown(value, find, number) for name, value in text.values.items()}
        return found.format(**shown) if found else text.english
    except (IndexError, KeyError, TypeError, ValueError):  # of another release, whose sentence has other values
        return text.english


class _Shown:
    """A value as another language shows it: a quoted sentence translated, a number with that language's marks."""

    def __init__(self, value: Value, find: Find, number: Callable[[str], str]) -> None:
        self._value, self._find, self._number = value, find, number

    def __format__(self, spec: str) -> str:
        if isinstance(self._value, str):
            return format(translate(self._value, self._find, self._number), spec)
        return self._number(format(self._value, spec))


@cache
def english() -> Mapping[str, str]:
    """Return the catalogue of English sentences by code."""
    catalogue: dict[str, str] = json.loads((HERE / "english.json").read_text(encoding="utf-8"))
    return catalogue


def _plain(value: object) -> Value:
    """Return a value as JSON can have it: numbers of numpy as Python's, anything else as text."""
    if isinstance(value, str | int | float):
        return value
    item = getattr(value, "item", None)
    return item() if callable(item) else str(value)


def _value_to_json(value: Any) -> Any:
    if isinstance(value, Sentence):
        return {"text": value.english, **value.coded}
    if isinstance(value, list):
        return [_value_to_json(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _value_from_json(value: Any) -> Any:
    if isinstance(value, dict):
        return read_sentence(str(value.get("text", "")), value)
    if isinstance(value, list):
        return [_value_from_json(each) for each in value]
    return value
