"""Questions that a job leaves to people: warnings that somebody can answer, each with the options that are the answer.

The likelier reading goes on at once. An answer makes a new version: the job again, with these options.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from capture2vr.order.option_table import OPTION_TABLE
from capture2vr.sentences.sentence import Sentence, say

Answer = tuple[Sentence, Mapping[str, str]]
_COLUMNS: Answer = say("answer_columns"), {"columns": ""}
_METRES: Answer = say("answer_metres"), {"unit": "m"}
_MILLIMETRES: Answer = say("answer_millimetres"), {"unit": "mm"}
_CENTIMETRES: Answer = say("answer_centimetres"), {"unit": "cm"}
_INCHES: Answer = say("answer_inches"), {"unit": "in"}
_FEET: Answer = say("answer_feet"), {"unit": "ft"}
_SURVEY_FEET: Answer = say("answer_survey_feet"), {"unit": "us-ft"}
_SWAPPED: Answer = say("answer_latitude_first"), {"unit": "deg", "columns": "x=2,y=1,z=3"}
_BY_CODE: Mapping[str, tuple[Answer, ...]] = {
    "cloud_long_in_unknown_unit": (_MILLIMETRES, _CENTIMETRES, _INCHES),
    "columns_taken": (_COLUMNS,),
    "doubt_column_counts": (_COLUMNS,),
    "doubt_degrees": (_METRES, _SWAPPED),
    "doubt_feet": (_FEET, _SURVEY_FEET),
    "doubt_one_side_long": (_COLUMNS,),
}
"""Answers by the code of the sentence: what they say, and options of a job; "" is for a person to say."""


def questions_of(warnings: Iterable[str]) -> list[dict[str, Any]]:
    """Return the questions among warnings, as JSON: code, the sentence as `text`, and answers. An answer has a text
    and the options of a job that is run again; a value "" is for a person to fill in."""
    return [
        {
            "code": warning.code,
            "text": warning,
            "answers": [{"text": text, "options": dict(options)} for text, options in _BY_CODE[warning.code]],
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
