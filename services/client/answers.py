"""Read the answers of a gateway: JSON, or a problem document (RFC 9457), which becomes a GatewayError."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import httpx

from capture2vr.errors import GatewayError, sentence

_T = TypeVar("_T")


class Answer(dict[str, Any]):
    """A JSON object of an answer. A field that it lacks is a GatewayError that names it, and no KeyError."""

    def __init__(self, fields: Mapping[str, Any], url: str) -> None:
        super().__init__(fields)
        self._url = url

    def __missing__(self, field: str) -> Any:
        raise GatewayError(f"{self._url} answered without '{field}', so not as a gateway does: check the gateway's URL")


def parse_answer(response: httpx.Response, *, file: str = "") -> Any:
    """Return the JSON object of a successful answer, an `Answer` as all objects in it.

    file  name of the file that was sent, for problems that name none
    Raises GatewayError with detail, file and hints of a problem document, and for what is no JSON object.
    """
    try:
        answer = response.json(object_hook=partial(Answer, url=str(response.request.url)))
    except (ValueError, RecursionError):  # the server is no gateway
        answer = None
    if isinstance(answer, Answer) and response.is_success:
        return answer
    if not isinstance(answer, Answer) or "detail" not in answer:
        status = response.status_code
        why = f"{response.request.url} answered {status}, but not as a gateway does: check the gateway's URL"
        raise GatewayError(why, status=status)
    raise problem_error(answer, file=file, status=response.status_code)


@contextmanager
def understood(what: str) -> Iterator[None]:
    """Raise GatewayError where the block cannot make `what` of an answer, as a field of it is of another type."""
    try:
        yield
    except UnicodeEncodeError:  # of what was asked, not of the answer
        raise
    except (TypeError, ValueError, AttributeError, LookupError) as error:
        why = " ".join(str(error).split())[:200]
        raise GatewayError(
            f"the gateway's answer is no {what} ({why}): check its URL, and that its version fits this one"
        ) from error


def problem_error(
    problem: Mapping[str, Any], *, file: str = "", status: int = 0, kind: type[GatewayError] = GatewayError
) -> GatewayError:
    """Convert a problem document to an error, whose text is one line."""
    with understood("problem document"):
        hints = tuple(map(str, problem.get("hints") or ()))
        line = sentence(str(problem["detail"]), file=str(problem.get("file") or file), hints=hints)
        code, retryable = str(problem.get("code") or ""), bool(problem.get("retryable"))
    return kind(line, code=code, status=status, hints=hints, retryable=retryable)


def paged(
    client: httpx.Client, path: str, name: str, query: Mapping[str, str | int], convert: Callable[[Any], _T]
) -> Iterator[_T]:
    """Yield what `convert` makes of the items of a list that comes in pages. Raises GatewayError.

    name  the field of a page that has them
    """
    after: str | None = ""
    while after is not None:
        page = parse_answer(client.get(path, params={**query, "after": after}))
        with understood(f"page of {name}"):
            items, following = [convert(item) for item in page[name]], page["next"]
            if following is not None and (not isinstance(following, str) or following == after):
                raise ValueError(f"its next page is {following!r}")
        yield from items
        after = following
