"""Read the answers of a gateway: JSON, or a problem document (RFC 9457), which becomes a GatewayError."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import httpx

from capture2vr.errors import GatewayError, sentence


def parse_answer(response: httpx.Response, *, file: str = "") -> Any:
    """Return the JSON of a successful answer. Raises GatewayError with detail, file and hints of a problem document.

    file  name of the file that was sent, for problems that name none
    """
    try:
        problem = response.json()
    except ValueError:  # the server is no gateway
        problem = None
    if response.is_success and problem is not None:
        return problem
    if not isinstance(problem, dict) or "detail" not in problem:
        status = response.status_code
        why = f"{response.request.url} answered {status}, but not as a gateway does: check the gateway's URL"
        raise GatewayError(why, status=status)
    raise problem_error(problem, file=file, status=response.status_code)


def problem_error(
    problem: Mapping[str, Any], *, file: str = "", status: int = 0, kind: type[GatewayError] = GatewayError
) -> GatewayError:
    """Convert a problem document to an error, whose text is one line."""
    hints = tuple(problem.get("hints") or ())
    line = sentence(problem["detail"], file=problem.get("file") or file, hints=hints)
    code, retryable = str(problem.get("code") or ""), bool(problem.get("retryable"))
    return kind(line, code=code, status=status, hints=hints, retryable=retryable)


def paged(client: httpx.Client, path: str, name: str, query: Mapping[str, str | int]) -> Iterator[Any]:
    """Yield the items of a list that comes in pages. name: the field of a page that has them. Raises GatewayError."""
    after: str | None = ""
    while after is not None:
        page = parse_answer(client.get(path, params={**query, "after": after}))
        yield from page[name]
        after = page["next"]
