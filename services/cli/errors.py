"""What the command line says when the person, not the program, has to change something."""

from __future__ import annotations

from typing import Any

import httpx


class BadInput(Exception):  # noqa: N818 - it reads as what it is
    """One sentence for the person; the command ends with exit code 2."""


def sentence(message: str, *, file: str | None = None, hints: tuple[str, ...] = ()) -> str:
    """File, reason and what to do on one line."""
    said = f"{file}: {message}" if file and file not in message else message
    return f"{said} ({'; '.join(hints)})" if hints else said


def answer_of(response: httpx.Response) -> Any:
    """The JSON of a good answer. A problem document becomes `BadInput` with its detail, file and hints."""
    if response.is_success:
        return response.json()
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    if not isinstance(problem, dict) or "detail" not in problem:
        raise BadInput(f"{response.request.url} answered {response.status_code} {response.reason_phrase}")
    raise BadInput(sentence(problem["detail"], file=problem.get("file"), hints=tuple(problem.get("hints") or ())))
