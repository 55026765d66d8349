"""Sentences in JSON documents: beside a member `detail` stands `detail_i18n`, with the sentence's code and values."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from capture2vr.sentences.sentence import Sentence, read_sentence

_SUFFIX = "_i18n"

T = TypeVar("T")


def with_codes(document: Any) -> Any:
    """Return a document with the codes of its sentences: beside a sentence an object, beside a list of texts a list
    that has null for each text without a code. Old readers find the English where it always was.
    """
    if isinstance(document, Mapping):
        return {name: value for member in document.items() for name, value in _with_code(*member)}
    if isinstance(document, list | tuple):
        return [with_codes(each) for each in document]
    return _english(document) if isinstance(document, str) else document


def _with_code(name: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, Sentence):
        return [(name, value.english), (name + _SUFFIX, value.coded)]
    if isinstance(value, list | tuple) and _are_texts(value):
        codes = [each.coded if isinstance(each, Sentence) else None for each in value]
        return [(name, [_english(each) for each in value]), (name + _SUFFIX, codes)]
    return [(name, with_codes(value))]


def _are_texts(values: Sequence[Any]) -> bool:
    """Whether all of them are texts, and one is a sentence."""
    return all(isinstance(each, str) for each in values) and any(isinstance(each, Sentence) for each in values)


def _english(text: str) -> str:
    return text.english if isinstance(text, Sentence) else text


def with_sentences(document: Any) -> Any:
    """Return a document as it was before `with_codes`."""
    if isinstance(document, Mapping):
        members = {name: value for name, value in document.items() if not _is_code(name, document)}
        return {name: _as_sentence(value, document.get(name + _SUFFIX)) for name, value in members.items()}
    if isinstance(document, list | tuple):
        return [with_sentences(each) for each in document]
    return document


def _is_code(name: str, document: Mapping[str, Any]) -> bool:
    return name.endswith(_SUFFIX) and name.removesuffix(_SUFFIX) in document


def _as_sentence(value: Any, coded: Any) -> Any:
    if isinstance(value, str):
        return read_sentence(value, coded)
    if isinstance(value, list | tuple) and isinstance(coded, list) and len(coded) == len(value):
        return [
            read_sentence(text, code) if isinstance(text, str) else text
            for text, code in zip(value, coded, strict=True)
        ]
    return with_sentences(value)


def restored(value: T, document: Any) -> T:
    """Return what was made from a document of `with_sentences`, by a reader that knows texts alone, with its sentences.

    value  a dataclass, or a tuple of dataclasses or texts; document: the JSON that it was made from
    """
    if isinstance(document, Sentence) and isinstance(value, str):
        return document  # type: ignore[return-value]
    if isinstance(value, tuple) and isinstance(document, list):
        return tuple(map(restored, value, document))  # type: ignore[return-value]
    if is_dataclass(value) and not isinstance(value, type) and isinstance(document, Mapping):
        known = [field.name for field in fields(value) if field.name in document]
        return replace(value, **{name: restored(getattr(value, name), document[name]) for name in known})
    return value


def codes_as_json(**members: Any) -> str:
    """Return the codes of a message's sentences as JSON, to travel beside their English; "" where none has a code."""
    codes = {name: value for name, value in with_codes(members).items() if name not in members}
    return json.dumps(codes, separators=(",", ":")) if codes else ""


def read_codes(codes: str, **members: Any) -> dict[str, Any]:
    """Return the members with the codes of `codes_as_json`; as they are where that cannot be read."""
    try:
        read = json.loads(codes) if codes else {}
        found = with_sentences({**members, **read}) if isinstance(read, dict) else members
    except (TypeError, ValueError, RecursionError):
        return members
    return {name: found[name] for name in members}


def translated(document: Any, translate: Callable[[str], str]) -> Any:
    """Return a document with its sentences translated, each beside its code as before."""
    if isinstance(document, Sentence):
        return translate(document)
    if isinstance(document, Mapping):
        return {name: value for member in document.items() for name, value in _translated(*member, translate)}
    if isinstance(document, list | tuple):
        return [translated(each, translate) for each in document]
    return document


def _translated(name: str, value: Any, translate: Callable[[str], str]) -> list[tuple[str, Any]]:
    if isinstance(value, Mapping):
        return [(name, translated(value, translate))]
    coded = _with_code(name, value)
    return [(name, translated(value, translate)), *coded[1:]]
