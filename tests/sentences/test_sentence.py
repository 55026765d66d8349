"""Sentences: texts that know their code and values, on their way through processes and documents, and translated."""

from __future__ import annotations

import copy
import json
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.languages import in_language
from capture2vr.sentences.documents import codes_as_json, read_codes, translated, with_codes, with_sentences
from capture2vr.sentences.sentence import (
    Sentence,
    capitalised,
    english,
    in_row,
    map_texts,
    read_sentence,
    say,
    sentence_or_text,
)

NAMES = st.text(max_size=20)
SENTENCES = st.one_of(
    st.builds(lambda name: say("no_job", job=name), NAMES),
    st.builds(lambda left: say("only_left", left=left), st.integers()),
    st.builds(lambda count, least: say("has_only_points_least_needed", count=count, least=least), *[st.integers()] * 2),
    st.builds(lambda parts: in_row("; ", parts), st.lists(NAMES, max_size=3)),
    st.builds(lambda why: say("photo_skipped", why=say("not_readable", what="PLY", reason=why)), NAMES),
    st.builds(lambda name: capitalised(say("no_job", job=name)), NAMES),
)
MEMBERS = st.sampled_from("abcde")
DOCUMENTS = st.recursive(
    st.one_of(SENTENCES, NAMES, st.integers(), st.none(), st.lists(SENTENCES | NAMES, max_size=3)),
    lambda inner: (
        st.dictionaries(MEMBERS, inner, max_size=4) | st.lists(st.dictionaries(MEMBERS, inner, max_size=3), max_size=3)
    ),
    max_leaves=12,
)


def german(text: str) -> str:
    return in_language(text, "de")


def coded(value: Any) -> Any:
    """A document with sentences told apart from texts."""
    if isinstance(value, Sentence):
        return ("sentence", str(value), value.coded)
    if isinstance(value, dict):
        return {name: coded(each) for name, each in value.items()}
    return [coded(each) for each in value] if isinstance(value, list) else value


def test_a_sentence_is_its_english_text() -> None:
    sentence = say("only_left", left=np.int64(1234))
    assert sentence == "only 1,234 are left"
    assert json.loads(json.dumps(sentence.coded))["values"] == {"left": 1234}
    assert f"{sentence}." == "only 1,234 are left."


@pytest.mark.parametrize("go", [copy.deepcopy, lambda sentence: pickle.loads(pickle.dumps(sentence))])
def test_it_keeps_its_code_between_processes(go: Any) -> None:
    sentence = say("photo_skipped", why=say("no_job", job="a"))
    assert coded(go(sentence)) == coded(sentence)


@given(DOCUMENTS)
def test_a_document_has_its_sentences_again_after_json(document: Any) -> None:
    wrapped = {"document": document}
    written = json.loads(json.dumps(with_codes(wrapped)))
    assert coded(with_sentences(written)) == coded(wrapped)


@given(DOCUMENTS)
def test_old_readers_find_the_english_where_it_always_was(document: Any) -> None:
    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(each) for name, each in value.items() if not name.endswith("_i18n")}
        return [plain(each) for each in value] if isinstance(value, list) else value

    assert plain(json.loads(json.dumps(with_codes({"all": document})))) == json.loads(json.dumps({"all": document}))


@given(NAMES)
def test_names_are_not_translated_whatever_they_say(name: str) -> None:
    assert german(say("no_job", job=name)) == f"einen Auftrag {name} gibt es nicht"
    assert german(name) == name
    assert german(in_row(": ", (name, say("has_no_points")))) == f"{name}: hat keine Punkte"


def test_quoted_sentences_and_numbers_are_translated_too() -> None:
    inner = say("triangles_more_than", count=1234, most=100)
    assert german(say("photo_skipped", why=inner)).startswith("Foto übersprungen: 1.234 ")
    assert german(capitalised(say("has_no_points"))) == "Hat keine Punkte"


@given(st.text(max_size=200))
def test_codes_that_cannot_be_read_leave_the_english(codes: str) -> None:
    assert read_codes(codes, message="has no points") == {"message": "has no points"}


@pytest.mark.parametrize(
    "broken", [{}, {"code": 3}, {"code": "no_job"}, {"code": "no_job", "values": []}, {"code": "new", "values": {}}]
)
def test_a_malformed_or_unknown_code_leaves_the_english(broken: dict[str, Any]) -> None:
    assert german(read_sentence("there is no job a", broken)) == "there is no job a"


def test_a_sentence_of_another_release_with_other_values_stays_english() -> None:
    other = read_sentence("there is no job 7 of yours", {"code": "no_job", "values": {"number": 7}})
    assert german(other) == "there is no job 7 of yours"
    assert german(read_sentence("x", {"code": "only_left", "values": {"left": []}})) == "x"


def test_messages_of_the_wire_carry_codes_only_where_there_are_any() -> None:
    assert codes_as_json(message="by hand", hints=()) == ""
    codes = codes_as_json(message=say("has_no_points"), hints=(say("try_again"), "by hand"))
    read = read_codes(codes, message="has no points", hints=["try again", "by hand"])
    assert coded(read) == coded({"message": say("has_no_points"), "hints": [say("try_again"), "by hand"]})


def test_a_translated_document_keeps_its_codes() -> None:
    document = translated({"hints": [say("try_again"), "X"], "error": {"detail": say("has_no_points")}}, german)
    assert document == {
        "hints": ["versuch es noch einmal", "X"],
        "hints_i18n": [{"code": "try_again", "values": {}}, None],
        "error": {"detail": "hat keine Punkte", "detail_i18n": {"code": "has_no_points", "values": {}}},
    }


def test_a_change_of_texts_reaches_the_values() -> None:
    changed = map_texts(
        say("photo_skipped", why=say("no_job", job="/tmp/x/a.jpg")), lambda text: text.replace("/tmp/x/", "")
    )
    assert german(changed) == "Foto übersprungen: einen Auftrag a.jpg gibt es nicht"
    assert changed == "photo skipped: there is no job a.jpg"


def test_numbers_that_json_has_not_travel_as_text() -> None:
    assert json.loads(json.dumps(say("no_job", job=float("nan")).coded, allow_nan=False))["values"] == {"job": "nan"}


def test_a_file_names_a_code_or_says_it_itself() -> None:
    assert isinstance(sentence_or_text("preset_draft"), Sentence)
    assert sentence_or_text("for our own garments") == "for our own garments"


def test_the_text_of_an_error_keeps_the_code() -> None:
    assert coded(str(ValueError(say("has_no_points")))) == coded(say("has_no_points"))
    assert type(say("has_no_points").english) is str


def test_every_english_sentence_can_be_said() -> None:
    assert len(english()) > 850
    with pytest.raises(KeyError):
        say("no_job")
    with pytest.raises(KeyError):
        say("there is no such code")
