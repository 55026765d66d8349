"""An asset's grade as the first line of what a person is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from capture2vr.order.questions import flags_of, questions_of


def grade_line(grade: Mapping[str, str]) -> str:
    """Return an asset's grade as one line: the word, then why and what to do."""
    why = f": {grade['because']}. {grade['advice']}" if grade["because"] else ""
    return f"{grade['level'].capitalize()}{why}"


def origin_line(origin: str) -> str:
    """Return what an asset is that was not measured, as one line; "" of one that was."""
    return _ORIGINS.get(origin, "")


_ORIGINS = {
    "generated": "Generated: a generator made this shape up from one photo; nothing of it was measured",
    "guess": "A guess: this shape was made from the outline in one photo; its depth was not measured",
}


def other_warnings(
    grade: Mapping[str, str] | None, warnings: Sequence[str], questions: Sequence[Mapping[str, Any]] | None = None
) -> list[str]:
    """Return an asset's warnings without the one that says the grade, which stands on a line of its own.

    questions: those among the warnings, where they are known by themselves; behind each stand the flags that answer it.
    """
    because = (grade or {}).get("because")
    asked = questions_of(warnings) if questions is None else questions
    flags = {question["text"]: f". If not so: {flags_of(question)}" for question in asked}
    return [
        f"{warning.rstrip('.')}{flags[warning]}" if warning in flags else warning
        for warning in warnings
        if not because or because not in warning
    ]
