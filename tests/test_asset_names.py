"""Names of assets: what passes is one line, short and not twice; what does not is refused with a reason."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.order.asset_names import (
    DESCRIPTION_CHARS,
    LABEL_CHARS,
    MOST_LABELS,
    WORD_CHARS,
    AssetNames,
    check_description,
    check_label,
    check_labels,
)

TURNING = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
LETTERS = st.characters(exclude_categories=["Cc", "Cs", "Zl", "Zp"], exclude_characters=TURNING)
WORDS = st.text(LETTERS, max_size=WORD_CHARS)


@given(st.lists(WORDS.filter(str.strip), max_size=MOST_LABELS))
def test_words_stay_in_their_order_each_once(words: list[str]) -> None:
    found = check_labels(words)
    assert check_labels(found) == found
    folded = [word.strip().casefold() for word in words]
    assert [word.casefold() for word in found] == list(dict.fromkeys(folded))


@given(WORDS, st.lists(WORDS, max_size=5))
def test_what_passed_passes_again(label: str, lines: list[str]) -> None:
    names = AssetNames(label, "\n".join(lines), ()).checked()
    assert names.checked() == names
    assert AssetNames.of(names.as_json) == names


def test_markup_is_text() -> None:
    assert check_label(' <b>"Shirt"</b> & co. ') == '<b>"Shirt"</b> & co.'
    assert check_labels(["<script>", "Größe 42", "größe 42"]) == ("<script>", "Größe 42")


def test_a_description_keeps_its_lines() -> None:
    assert check_description(" Wool.\r\n\r\nMade in\tWales. \n") == "Wool.\n\nMade in Wales."


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (AssetNames(label="a" * (LABEL_CHARS + 1)), "a label has at most 200 characters, and this one has 201"),
        (AssetNames(label="a\nb"), r"no control characters, and this one has U\+000A"),
        (AssetNames(label="a\u202eb"), r"U\+202E"),
        (AssetNames(description="a" * (DESCRIPTION_CHARS + 1)), "a description has at most 2,000 characters"),
        (AssetNames(description="a\x1b[2Jb"), r"U\+001B"),
        (AssetNames(labels=("a" * (WORD_CHARS + 1),)), "a tag has at most 50 characters"),
        (AssetNames(labels=("a", " ")), "a tag is empty"),
        (AssetNames(labels=("a\u2028b",)), r"U\+2028"),
        (AssetNames(labels=tuple(map(str, range(MOST_LABELS + 1)))), "at most 20 tags, and these are 21"),
    ],
)
def test_what_is_no_name_is_refused(names: AssetNames, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        names.checked()
