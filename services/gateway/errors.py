"""Problem documents (RFC 9457): the JSON format of all errors that this service returns.

Handles our own `Problem`, the framework's HTTP errors, requests that do not match their schema, and a database that
fails. An unexpected exception tells the client nothing but a request id to quote.
"""

from __future__ import annotations

import logging
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as NoConnection
from starlette.exceptions import HTTPException

from capture2vr.gateway.database_faults import Fault, fault_of
from capture2vr.gateway.languages import for_reader
from capture2vr.order.edits import SEE, fault_sentence
from capture2vr.sentences.sentence import say

MEDIA_TYPE = "application/problem+json"

_SEE_OPENAPI = ("see /openapi.json",)
RETRY_S = 10
"""Seconds after which a request that failed for want of space or of the database may succeed."""
_TRY_AGAIN = (say("try_again_in_moment"),)

_log = logging.getLogger(__name__)


class Problem(Exception):  # noqa: N818 - RFC 9457 calls it a problem
    """An error to be returned to the client as a problem document.

    status     HTTP status
    code       stable, upper case, for programs: CAPTURE_UNKNOWN
    detail     for people: what is wrong with this request, with the numbers; never a path or a secret of the server
    retryable  whether the same request may succeed later
    stage      stage of the job in which it happened, or ""
    file       file of the capture that it concerns, or ""
    hints      what the user can do about it; default for retryable problems: try again
    headers    of the answer, e.g. Retry-After
    """

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        *,
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
        self._title = ""
        self.retryable = retryable
        self.stage = stage
        self.file = file
        self.hints = hints or (_TRY_AGAIN if retryable else ())
        self.headers = headers or {}

    def titled(self, title: str) -> Problem:
        """Name the kind of problem for people, where the status' phrase says too little; return it."""
        self._title = title
        return self

    @property
    def title(self) -> str:
        """The kind of problem for people: the status' phrase, unless it was named."""
        return self._title or HTTPStatus(self.status).phrase

    def document(self) -> dict[str, Any]:
        """Return the problem as JSON; `stage` and `file` only where they are set. Its sentences are Sentences."""
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
        """Return the problem as an HTTP answer, in the reader's language and with its sentences' codes."""
        document = for_reader(self.document())
        return JSONResponse(document, self.status, headers=self.headers, media_type=MEDIA_TYPE)


def internal_error(request_id: str) -> Problem:
    """Return the problem for an unexpected exception. It tells only the request id; the log has the rest under it."""
    return Problem(
        500,
        "INTERNAL",
        say("internal_error_gateway_log", request=request_id),
        retryable=True,
        hints=(say("try_again"), say("report_request_id_if_happens", request=request_id)),
    )


def install_handlers(app: FastAPI) -> None:
    """Register the handlers that turn routes' errors into problem documents; RequestMiddleware catches all others."""
    app.add_exception_handler(Problem, _on_problem)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(DBAPIError, _on_database_error)
    app.add_exception_handler(NoConnection, _on_database_error)


async def _on_problem(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, Problem)
    return error.response()


async def _on_http_exception(_: Request, error: Exception) -> JSONResponse:
    """Answer the framework's own errors: unknown route, method not allowed, body that is not JSON."""
    assert isinstance(error, HTTPException)
    status = HTTPStatus(error.status_code)
    detail = error.detail if isinstance(error.detail, str) else status.phrase
    return Problem(status.value, status.name, detail, hints=_SEE_OPENAPI, headers=dict(error.headers or {})).response()


async def _on_invalid_request(request: Request, error: Exception) -> JSONResponse:
    """Answer a request that does not match its schema: each wrong field and why, without its value."""
    assert isinstance(error, RequestValidationError)
    if any(fault["loc"] == ("body",) for fault in error.errors()) and not _is_json(request):
        detail = say("body_must_be_json_sent")
        return Problem(415, "REQUEST_MEDIA_TYPE", detail, hints=_SEE_OPENAPI).response()
    faults = [fault_sentence(fault["loc"], fault["msg"]) for fault in error.errors()]
    if all(fault["loc"][:2] == ("body", "edits") for fault in error.errors()):
        return Problem(422, "EDITS_INVALID", "; ".join(faults), hints=(SEE,)).response()
    return Problem(422, "REQUEST_INVALID", "; ".join(faults), hints=_SEE_OPENAPI).response()


async def _on_database_error(request: Request, error: Exception) -> JSONResponse:
    """Answer for a jobs database that is away, locked, full, read-only or damaged.

    A transaction is all or none. A client that does not know whether it was committed asks again with its
    Idempotency-Key.
    """
    assert isinstance(error, SQLAlchemyError)
    _log.error("%s %s: the jobs database failed: %s", request.method, request.url.path, error.__cause__ or error)
    match fault_of(error):
        case Fault.FULL:
            return storage_full().response()
        case Fault.READ_ONLY:
            detail, hints = say("jobs_database_read_only_nothing"), (say("try_again_later"),)
            return _database_problem("DATABASE_READ_ONLY", detail, hints).response()
        case Fault.UNUSABLE:
            detail = say("jobs_database_busy_cannot")
            return _database_problem("DATABASE_UNAVAILABLE", detail).response()


def _database_problem(code: str, detail: str, hints: tuple[str, ...] = ()) -> Problem:
    return Problem(503, code, detail, retryable=True, hints=hints, headers={"Retry-After": str(RETRY_S)})


def storage_full() -> Problem:
    """Return the problem for a server without space."""
    detail = say("server_disk_full")
    hints = (say("try_again_later"), say("operator_must_free_space"))
    return Problem(507, "STORAGE_FULL", detail, retryable=True, hints=hints, headers={"Retry-After": str(RETRY_S)})


def _is_json(request: Request) -> bool:
    """Return whether the Content-Type is JSON; a body of another type is not parsed."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return media_type == "application/json" or media_type.endswith("+json")
