"""Questions that a job leaves to people: warnings that somebody can answer, each with the options that are the answer.

The likelier reading goes on at once. An answer makes a new version: the job again, with these options.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from capture2vr.order.option_table import OPTION_TABLE
from capture2vr.sentences.sentence import Sentence, say

_COLUMNS = {"columns": ""}
_MILLIMETRES, _CENTIMETRES, _INCHES = {"unit": "mm"}, {"unit": "cm"}, {"unit": "in"}
_METRES, _FEET, _SURVEY_FEET = {"unit": "m"}, {"unit": "ft"}, {"unit": "us-ft"}
_SWAPPED = {"unit": "deg", "columns": "x=2,y=1,z=3"}
_BY_CODE: Mapping[str, tuple[Mapping[str, str], ...]] = {
    "cloud_long_in_unknown_unit": (_MILLIMETRES, _CENTIMETRES, _INCHES),
    "columns_taken": (_COLUMNS,),
    "doubt_column_counts": (_COLUMNS,),
    "doubt_degrees": (_METRES, _SWAPPED),
    "doubt_feet": (_FEET, _SURVEY_FEET),
    "doubt_one_side_long": (_COLUMNS,),
}
"""Answers by the code of the sentence: options of a job; "" is for a person to say."""


def questions_of(warnings: Iterable[str]) -> list[dict[str, Any]]:
    """Return the questions among warnings, as JSON: code, the sentence as `text`, and answers. An answer has a text
    and the options of a job that is run again; a value "" is for a person to fill in."""
    return [
        {
            "code": warning.code,
            "text": warning,
            "answers": [{"text": _text(options), "options": dict(options)} for options in _BY_CODE[warning.code]],
        }
        for warning in warnings
        if isinstance(warning, Sentence) and warning.code in _BY_CODE
    ]


def flags_of(question: Mapping[str, Any]) -> str:
    """Return the flags of the command line that answer a question of `questions_of`: "--unit mm or --unit cm"."""
    return " or ".join(
        " ".join(f"{OPTION_TABLE[name].flag} {value or 'x=2,y=3,z=4'}" for name, value in answer["options"].items())
        for answer in question["answers"]
    )


def _text(options: Mapping[str, str]) -> Sentence:
    texts = {
        "mm": say("answer_millimetres"),
        "cm": say("answer_centimetres"),
        "in": say("answer_inches"),
        "ft": say("answer_feet"),
        "us-ft": say("answer_survey_feet"),
        "deg": say("answer_latitude_first"),
        "m": say("answer_metres"),
    }
    return texts.get(options.get("unit", ""), say("answer_columns"))
