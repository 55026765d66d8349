"""Views of sentences, which have their codes beside them in answers of the API, and of questions that people answer."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, Field


class SentenceCode(BaseModel):
    """What a sentence beside it is made from, whatever its language: its code, and its values by name."""

    code: str
    values: dict[str, Any]


def _is_absent(codes: object) -> bool:
    return not codes


Coded = Annotated[SentenceCode | None, Field(exclude_if=_is_absent)]
"""The member beside a sentence; it is left out where the sentence has no code."""
AllCoded = Annotated[list[SentenceCode | None], Field(exclude_if=_is_absent)]
"""The member beside a list of texts: null for each without a code."""


class AnswerView(BaseModel):
    """An answer to a question: what it says, and the options of POST /v1/jobs/{job}/again that it stands for. An option
    that is "" is for a person to fill in.
    """

    text: str
    text_i18n: Coded = None
    options: dict[str, str]


class QuestionView(BaseModel):
    """A question that a capture leaves open. It holds no job: the likelier reading went on. An answer is given by
    making the job again with its options. `text` is one of the warnings.
    """

    code: str
    text: str
    text_i18n: Coded = None
    answers: list[AnswerView]
