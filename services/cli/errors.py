"""What the command line says when the person, not the program, has to change something."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

NO_KEY = "'{}' is no asset key: use 1 to 100 letters, digits, '.', '_' or '-', a letter or digit first"


class BadInput(Exception):  # noqa: N818 - it reads as what it is
    """One sentence for the person; the command ends with exit code 2."""


def sentence(message: str, *, file: str | None = None, hints: tuple[str, ...] = ()) -> str:
    """File, reason and what to do on one line."""
    said = f"{file}: {message}" if file and not message.startswith(file) else message
    return f"{said} ({'; '.join(hints)})" if hints else said


def plain(text: str) -> str:
    """The text on one line: file names may hold line ends, terminal controls and bytes that are no text."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def answer_of(response: httpx.Response, *, file: str = "") -> Any:
    """The JSON of a good answer. A problem document becomes `BadInput` with its detail, file and hints.

    file  what was sent, for a problem that blames no file in it
    """
    try:
        problem = response.json()
    except ValueError:  # another server than a gateway
        problem = None
    if response.is_success and problem is not None:
        return problem
    if not isinstance(problem, dict) or "detail" not in problem:
        raise BadInput(f"{response.request.url} answered {response.status_code}, but not as a gateway does")
    raise BadInput(told(problem, file=file))


def told(problem: Mapping[str, Any], *, file: str = "") -> str:
    """A problem document as a sentence."""
    return sentence(problem["detail"], file=problem.get("file") or file, hints=tuple(problem.get("hints") or ()))
