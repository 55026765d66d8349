"""Middleware for every request: request id, refusal of other sites' requests, limit of the body's size, security
headers, metrics, log line, and a last handler of exceptions.

Plain ASGI, because the framework's own middleware class buffers streams and hides disconnects.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
import uuid
from dataclasses import dataclass, field
from functools import partial
from urllib.parse import unquote

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from capture2vr.gateway import browser_permissions
from capture2vr.gateway.access.api_key import KEY_PATTERN, mask_keys
from capture2vr.gateway.access.authentication import refused
from capture2vr.gateway.access.sharing import mask_shares
from capture2vr.gateway.connections import MAX_HEAD_BYTES, head_too_large
from capture2vr.gateway.errors import Problem, internal_error
from capture2vr.gateway.gateway import Gateway, gateway_in
from capture2vr.gateway.languages import Reader, preferred_language, reader
from capture2vr.gateway.records.audit_log import PASSING
from capture2vr.gateway.same_site import SiteRules
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.process.logs import request_id
from capture2vr.sentences.sentence import say

_JSON_BYTES = 64 << 10  # limit of a body that is no upload: a job request has a few hundred bytes
_FORM_BYTES = 16 << 20  # what multipart adds to an upload: boundaries and headers of some thousand files
_UPLOADS = re.compile("/v1/(captures|outlines|uploads(/[^/]*)?)/?")
_PROBES = re.compile("/(livez|readyz|metrics)")
_UPLOAD_SILENCE_S = 90.0  # without a byte of a body; uploads have a limit of their own, which names the upload
_SILENCE_S = 20.0
_LEAST_BYTES_S = 512  # of a body, whose sender may be silent for as long as that once: a poor mobile line has 5,000
_ASK_S = 15.0  # between two looks at the key of who sends a long body, or follows a stream
_CLIENT_CLOSED = 499  # nginx's status for a client that disconnected before its answer; never sent, only counted
_STREAM = "text/event-stream"
_HSTS = "max-age=31536000"  # browsers ask by HTTPS for a year; subdomains are not ours to decide over
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")

_log = logging.getLogger("capture2vr.gateway.requests")


@dataclass(slots=True)
class _Exchange:
    """State of one request and its answer while they are processed."""

    gateway: Gateway
    scope: Scope
    limit: int
    silence_s: float
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    waited: float = 0.0  # seconds for the body, not those in which the gateway was busy with what had come
    status: int = 0
    streamed: bool = False
    has_body: bool = False  # whether all of the body has been received
    refusal: Problem | None = None  # of the body
    asked: float = field(default_factory=time.perf_counter)  # when the caller's key was last looked at
    cut: bool = False  # whether the answer was ended because its caller's key has

    async def receive(self, receive: Receive) -> Message:
        """Receive a part of the body. Raises Problem where it does not come in time, is too large, or its key ended."""
        began = time.perf_counter()
        left = self.silence_s + self.received / _LEAST_BYTES_S - self.waited
        try:
            async with asyncio.timeout(None if self.has_body else min(self.silence_s, left)):
                message = await receive()
        except TimeoutError:
            slow = left < self.silence_s
            self.refusal = _slow(self.received, self.waited + left) if slow else _silent(self.silence_s)
            raise self.refusal from None
        self.waited += time.perf_counter() - began
        self.received += len(message.get("body", b""))
        self.has_body = not message.get("more_body", False)
        if self.received > self.limit:
            self.refusal = _too_large(self.limit)
            raise self.refusal
        if message["type"] == "http.request" and not await self._is_welcome():
            self.refusal = refused("KEY_ENDED", say("key_ended_meanwhile"))
            raise self.refusal
        return message

    async def send_streamed(self, send: Send, message: Message) -> None:
        """Send a part of a stream; where its caller's key has ended, its end, and nothing more."""
        if self.cut:
            return
        if not await self._is_welcome():
            self.cut = True  # the framework then takes the client for gone, and ends the stream
            message = {"type": "http.response.body", "body": b"", "more_body": False}
        await send(message)

    async def _is_welcome(self) -> bool:
        """Return whether the caller's key and session are still good, of which is asked now and then."""
        now, caller = time.perf_counter(), self.scope.get("state", {}).get("caller")
        if caller is None or now - self.asked < _ASK_S:
            return True
        self.asked = now
        return await self.gateway.access.authentication.is_still(caller)


class RequestMiddleware:
    """The outermost layer of the app: adds ids and headers, limits bodies, counts and logs, answers all exceptions."""

    def __init__(self, app: ASGIApp, *, settings: GatewaySettings) -> None:
        self._app = app
        self._sites = SiteRules.of(settings)
        self._has_tls = settings.public_url.startswith("https://")  # by a proxy, which may not tell
        self._max_upload_bytes = settings.max_upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        client_id = headers.get("x-request-id", "")
        identity = client_id if _REQUEST_ID.fullmatch(client_id) else uuid.uuid4().hex
        token = request_id.set(identity)
        asking = reader.set(Reader(preferred_language(headers.get("accept-language", ""))))
        try:
            await self._handle(scope, receive, send, headers, identity)
        finally:
            reader.reset(asking)
            request_id.reset(token)

    def _check(self, gateway: Gateway, scope: Scope, headers: Headers) -> None:
        """Check all but the body of a request, and make room for a deletion. Raises Problem."""
        _check_head(scope)
        self._sites.check(scope["method"], headers)
        _refuse_key_in_url(scope)
        client = scope.get("client")
        gateway.access.limits.spend_address(client[0] if client else "")
        if scope["method"] == "DELETE":
            gateway.upkeep.reserve.give_up_if_full()

    async def _handle(self, scope: Scope, receive: Receive, send: Send, headers: Headers, identity: str) -> None:
        gateway = gateway_in(scope["app"])
        is_upload = _UPLOADS.fullmatch(scope["path"]) is not None
        silence_s = _UPLOAD_SILENCE_S if is_upload else _SILENCE_S
        exchange = _Exchange(gateway, scope, self._limit(is_upload), silence_s)

        async def send_with_headers(message: Message) -> None:
            if exchange.streamed:
                await exchange.send_streamed(send, message)
                return
            if message["type"] == "http.response.start":
                exchange.status = message["status"]
                await gateway.records.audit.record(scope, identity, exchange.status)
                headers_out = MutableHeaders(scope=message)
                _add_headers(headers_out, scope, identity, has_tls=self._has_tls)
                exchange.streamed = headers_out.get("content-type", "").startswith(_STREAM)
            await send(message)

        async def send_unless_refused(message: Message) -> None:
            # The framework answers an exception of `receive` as a malformed body: drop that answer, send ours below.
            if not exchange.refusal or exchange.status:
                await send_with_headers(message)

        try:
            self._check(gateway, scope, headers)
            if _declared_length(headers) > exchange.limit:
                raise _too_large(exchange.limit)
            await self._app(scope, partial(exchange.receive, receive), send_unless_refused)
            if exchange.refusal and not exchange.status:
                raise exchange.refusal
        except Problem as problem:
            await problem.response()(scope, receive, send_with_headers)
        except ClientDisconnect:
            exchange.status = exchange.status or _CLIENT_CLOSED
        except Exception:
            _log.exception("%s %s failed", scope["method"], mask_shares(mask_keys(scope["path"])))
            if exchange.status:  # the answer has been started: all that is left is to break the connection
                raise
            await internal_error(identity).response()(scope, receive, send_with_headers)
        finally:
            _count(gateway, scope, exchange)

    def _limit(self, is_upload: bool) -> int:
        return self._max_upload_bytes + _FORM_BYTES if is_upload else _JSON_BYTES


def _add_headers(headers: MutableHeaders, scope: Scope, identity: str, *, has_tls: bool) -> None:
    """Add what every answer has, where it does not say otherwise: what browsers may do with it, id, limits of rates."""
    headers.setdefault("X-Content-Type-Options", "nosniff")
    headers.setdefault("Referrer-Policy", "no-referrer")
    headers.setdefault("X-Request-ID", identity)
    headers.setdefault("Cache-Control", "private, no-store")  # what anybody may keep says so
    headers.setdefault("Permissions-Policy", browser_permissions.ANY_PAGE)
    headers.setdefault("Cross-Origin-Opener-Policy", "same-origin")
    # What any origin's pages may read, they may also show: the other answers stay in this site.
    shared = headers.get("access-control-allow-origin") == "*"
    headers.setdefault("Cross-Origin-Resource-Policy", "cross-origin" if shared else "same-origin")
    if reader.get().was_asked:
        headers.add_vary_header("Accept-Language")
        headers.setdefault("Content-Language", reader.get().language)
    if rate := scope.get("state", {}).get("rate_limit"):
        for name, value in rate.headers.items():
            headers.setdefault(name, value)
    if has_tls or scope["scheme"] == "https":
        headers.setdefault("Strict-Transport-Security", _HSTS)


def _count(gateway: Gateway, scope: Scope, exchange: _Exchange) -> None:
    """Count and log a complete answer."""
    seconds = time.perf_counter() - exchange.began
    # The route's template, not the path: one time series per route, not per job.
    route = getattr(scope.get("route"), "path", "unmatched")
    gateway.metrics.observe_response(
        scope["method"], route, exchange.status, seconds, exchange.received, exchange.streamed
    )
    path = mask_shares(mask_keys(scope["path"]))
    extra = {"method": scope["method"], "path": path, "status": exchange.status, "ms": round(seconds * 1000, 1)}
    # What is asked every few seconds would bury all others. `Vitals` logs what /readyz finds, once.
    level = logging.DEBUG if PASSING.fullmatch(path) or _PROBES.fullmatch(path) else logging.INFO
    _log.log(level, "%s %s %d", scope["method"], path, exchange.status, extra=extra)


def _check_head(scope: Scope) -> None:
    """Raises Problem for a request line and headers that are too large, and arrived so fast that they were read."""
    size = len(scope.get("raw_path", b"")) + len(scope["query_string"])
    if size + sum(len(name) + len(value) + 4 for name, value in scope["headers"]) > MAX_HEAD_BYTES:
        raise head_too_large()


def _refuse_key_in_url(scope: Scope) -> None:
    """Raises Problem for an access key in a URL, where logs and histories keep it."""
    if KEY_PATTERN.search(scope["path"]) or KEY_PATTERN.search(unquote(scope["query_string"].decode("latin-1"))):
        detail = say("access_key_sent_in_url")
        hints = (say("send_in_header_authorization_bearer"), say("revoke_key_may"))
        raise Problem(400, "KEY_IN_URL", detail, hints=hints)


def _declared_length(headers: Headers) -> int:
    length = headers.get("content-length", "")
    return int(length) if length.isascii() and length.isdigit() else 0


def _silent(seconds: float) -> Problem:
    return Problem(408, "REQUEST_SILENT", say("client_sent_nothing_s", seconds=seconds), retryable=True)


def _slow(received: int, seconds: float) -> Problem:
    return Problem(408, "REQUEST_SLOW", say("client_sent_only_in_s", count=received, seconds=seconds), retryable=True)


def _too_large(limit: int) -> Problem:
    detail = say("request_body_too_large", limit=limit)
    return Problem(413, "REQUEST_TOO_LARGE", detail, hints=(say("send_smaller_request"),))
