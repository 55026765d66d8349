"""Around every request: an id, limits on its body, security headers, a count, a log line, and the last catch of errors.

Plain ASGI, because the framework's own middleware class buffers streams and hides disconnects.
"""

from __future__ import annotations

import logging
import re
import time
import uuid
from dataclasses import dataclass, field

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.gateway.errors import Problem, unexpected
from services.gateway.metrics import Metrics
from services.logs import request_id

_JSON_BYTES = 64 << 10  # a job request has a few hundred bytes
_FORM_BYTES = 16 << 20  # what multipart adds to an upload: boundaries and headers of some thousand files
_UPLOADS = "/v1/captures"
_HUNG_UP = 499  # nginx's word for a client that left before its answer; never sent, only counted
_STREAM = "text/event-stream"
_GIVEN_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")

_log = logging.getLogger("services.gateway.requests")


@dataclass(slots=True)
class _Exchange:
    """What is known of a request and its answer while they pass."""

    limit: int
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    status: int = 0
    streamed: bool = False
    too_large: bool = False


class Around:
    """The outermost layer of the app."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics, max_upload_bytes: int) -> None:
        self._app = app
        self._metrics = metrics
        self._max_upload_bytes = max_upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        given = headers.get("x-request-id", "")
        identity = given if _GIVEN_ID.fullmatch(given) else uuid.uuid4().hex
        token = request_id.set(identity)
        try:
            await self._pass(scope, receive, send, headers, identity)
        finally:
            request_id.reset(token)

    async def _pass(self, scope: Scope, receive: Receive, send: Send, headers: Headers, identity: str) -> None:
        exchange = _Exchange(self._limit(scope["path"]))

        async def receive_counted() -> Message:
            message = await receive()
            exchange.received += len(message.get("body", b""))
            if exchange.received > exchange.limit:
                exchange.too_large = True
                raise _too_large(exchange.limit)
            return message

        async def send_marked(message: Message) -> None:
            if message["type"] == "http.response.start":
                exchange.status = message["status"]
                marked = MutableHeaders(scope=message)
                marked.setdefault("X-Content-Type-Options", "nosniff")
                marked.setdefault("Referrer-Policy", "no-referrer")
                marked.setdefault("X-Request-ID", identity)
                exchange.streamed = marked.get("content-type", "").startswith(_STREAM)
            await send(message)

        async def send_unless_too_large(message: Message) -> None:
            # The framework takes what `receive` raises for a malformed body; the answer must still say the true reason.
            if not exchange.too_large or exchange.status:
                await send_marked(message)

        try:
            if _declared(headers) > exchange.limit:
                raise _too_large(exchange.limit)
            await self._app(scope, receive_counted, send_unless_too_large)
            if exchange.too_large and not exchange.status:
                raise _too_large(exchange.limit)
        except Problem as problem:
            await problem.response()(scope, receive, send_marked)
        except ClientDisconnect:
            exchange.status = exchange.status or _HUNG_UP
        except Exception:
            _log.exception("%s %s failed", scope["method"], scope["path"])
            if exchange.status:  # the answer is under way: breaking the connection is all that is left to say
                raise
            await unexpected(identity).response()(scope, receive, send_marked)
        finally:
            self._count(scope, exchange)

    def _limit(self, path: str) -> int:
        return self._max_upload_bytes + _FORM_BYTES if path.rstrip("/") == _UPLOADS else _JSON_BYTES

    def _count(self, scope: Scope, exchange: _Exchange) -> None:
        seconds = time.perf_counter() - exchange.began
        # The template, never the path: one series per route, not per job.
        route = getattr(scope.get("route"), "path", "unmatched")
        self._metrics.answered(scope["method"], route, exchange.status, seconds, exchange.received, exchange.streamed)
        extra = {
            "method": scope["method"],
            "path": scope["path"],
            "status": exchange.status,
            "ms": round(seconds * 1000, 1),
        }
        _log.info("%s %s %d", scope["method"], scope["path"], exchange.status, extra=extra)


def _declared(headers: Headers) -> int:
    length = headers.get("content-length", "")
    return int(length) if length.isascii() and length.isdigit() else 0


def _too_large(limit: int) -> Problem:
    detail = f"the request's body may have {limit:,} bytes"
    return Problem(413, "REQUEST_TOO_LARGE", detail, hints=("send less at once",))
