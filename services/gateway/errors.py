"""Problem documents (RFC 9457): the only shape in which this service says no.

Every error ends here: our own `Problem`, the framework's HTTP errors, requests that do not fit their schema, and
anything unexpected, which tells the client nothing but a request id to quote.
"""

from __future__ import annotations

import logging
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

MEDIA_TYPE = "application/problem+json"

_SEE = ("see /openapi.json",)
_AGAIN = ("try again in a moment",)

_log = logging.getLogger(__name__)


class Problem(Exception):  # noqa: N818 - RFC 9457 calls it a problem
    """Something the client is told, and may act upon.

    status     HTTP status
    code       stable, upper case, for programs: CAPTURE_UNKNOWN
    detail     for people: what is wrong with this request, with the numbers; never a path or a secret of the server
    title      for people: what kind of problem; the status' phrase otherwise
    retryable  whether the same request may succeed later
    stage      of the job in which it happened, or ""
    file       of the capture that it concerns, or ""
    hints      what the person can do about it; to try again, unless said otherwise, where that may help
    headers    of the answer, e.g. Retry-After
    """

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        *,
        title: str = "",
        retryable: bool = False,
        stage: str = "",
        file: str = "",
        hints: tuple[str, ...] = (),
        headers: dict[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code
        self.detail = detail
        self.title = title or HTTPStatus(status).phrase
        self.retryable = retryable
        self.stage = stage
        self.file = file
        self.hints = hints or (_AGAIN if retryable else ())
        self.headers = headers or {}

    def document(self) -> dict[str, Any]:
        """The JSON of the problem; `stage` and `file` only where there are any."""
        where = {name: value for name, value in (("stage", self.stage), ("file", self.file)) if value}
        return {
            "type": f"urn:capture2vr:problem:{self.code}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "code": self.code,
            "retryable": self.retryable,
            **where,
            "hints": list(self.hints),
        }

    def response(self) -> JSONResponse:
        """The answer that carries it."""
        return JSONResponse(self.document(), self.status, headers=self.headers, media_type=MEDIA_TYPE)


def unexpected(request_id: str) -> Problem:
    """What a client learns of a fault of ours: the id under which the log has the rest."""
    return Problem(
        500,
        "INTERNAL",
        f"something went wrong on this side; the log has it under request {request_id}",
        retryable=True,
        hints=("try again", f"report request id {request_id} if it stays"),
    )


def install(app: FastAPI) -> None:
    """Teach the app to answer every error that a route can raise; the rest is caught by the outermost middleware."""
    app.add_exception_handler(Problem, _on_problem)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)


async def _on_problem(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, Problem)
    return error.response()


async def _on_http_exception(_: Request, error: Exception) -> JSONResponse:
    """The framework's own refusals: no such route, method not allowed, body that is no JSON."""
    assert isinstance(error, HTTPException)
    status = HTTPStatus(error.status_code)
    detail = error.detail if isinstance(error.detail, str) else status.phrase
    return Problem(status.value, status.name, detail, hints=_SEE, headers=dict(error.headers or {})).response()


async def _on_invalid_request(request: Request, error: Exception) -> JSONResponse:
    """Names every field at fault and why; the values are not repeated, they may be anything."""
    assert isinstance(error, RequestValidationError)
    if any(fault["loc"] == ("body",) for fault in error.errors()) and not _is_json(request):
        detail = "the body must be JSON, sent as Content-Type: application/json"
        return Problem(415, "REQUEST_MEDIA_TYPE", detail, hints=_SEE).response()
    faults = tuple(f"{'.'.join(str(part) for part in fault['loc'])}: {fault['msg']}" for fault in error.errors())
    return Problem(422, "REQUEST_INVALID", "; ".join(faults), hints=_SEE).response()


def _is_json(request: Request) -> bool:
    """Whether the body is said to be JSON: any other is not looked into."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return media_type == "application/json" or media_type.endswith("+json")
