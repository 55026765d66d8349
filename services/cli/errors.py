"""Errors of the command line that the user can fix, and conversion of problem documents to one-line messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx


class BadInput(Exception):  # noqa: N818 - it reads as what it is
    """An error that the user can fix. The command prints its one-line message and ends with exit code 2."""


def sentence(message: str, *, file: str | None = None, hints: tuple[str, ...] = ()) -> str:
    """Format an error on one line: file, reason, and hints in parentheses."""
    message_with_file = f"{file}: {message}" if file and not message.startswith(file) else message
    return f"{message_with_file} ({'; '.join(hints)})" if hints else message_with_file


def printable(text: str) -> str:
    """Replace unprintable characters: file names may have line ends, terminal control codes and invalid bytes."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def parse_answer(response: httpx.Response, *, file: str = "") -> Any:
    """Return the JSON of a successful answer. Raises BadInput with the detail, file and hints of a problem document.

    file  name of the file that was sent, for problems that name none
    """
    try:
        problem = response.json()
    except ValueError:  # the server is no gateway
        problem = None
    if response.is_success and problem is not None:
        return problem
    if not isinstance(problem, dict) or "detail" not in problem:
        raise BadInput(
            f"{response.request.url} answered {response.status_code}, but not as a gateway does: check --gateway"
        )
    raise BadInput(problem_sentence(problem, file=file))


def problem_sentence(problem: Mapping[str, Any], *, file: str = "") -> str:
    """Format a problem document on one line."""
    return sentence(problem["detail"], file=problem.get("file") or file, hints=tuple(problem.get("hints") or ()))
