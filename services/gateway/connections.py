"""Limits of connections, below HTTP: how many an address may have, how long and how large a request's head may be, and
how long a client may leave an answer unread.

Attackers open connections and send a byte now and then ("slowloris"), or headers without an end, or read nothing; all
cost the server memory and file descriptors while there is no request that the app could refuse.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from capture2vr.gateway.errors import MEDIA_TYPE, RETRY_S, Problem
from capture2vr.gateway.own_address import is_own
from capture2vr.sentences.documents import with_codes
from capture2vr.sentences.sentence import say

MAX_HEAD_BYTES = 64 << 10
"""Limit of a request's line and headers; browsers send 2 KB, with long cookies 8."""
_HEAD_S = 20.0  # for a whole head to arrive; a phone in a bad network resends within 3 s
_STUCK_S = 120.0  # for a client to read 64 KB of an answer, before it counts as gone

OnRefused = Callable[[str], None]
"""Called with the code of each refusal."""


class ConnectionLimits:
    """Counts the open connections of each address. Event loop only.

    most  connections of one address; 0: any number. This machine's own are not counted
    """

    def __init__(self, most: int, on_refused: OnRefused) -> None:
        self._most = most
        self._open = Counter[str]()
        self.on_refused = on_refused

    def enter(self, address: str) -> bool:
        """Count a new connection; return False when it is one too many. `leave` must follow in both cases."""
        self._open[address] += 1
        return not self._most or self._open[address] <= self._most or is_own(address)

    def leave(self, address: str) -> None:
        """Count a connection's end."""
        self._open[address] -= 1
        if not self._open[address]:
            del self._open[address]


class LimitedProtocol(HttpToolsProtocol):
    """uvicorn's protocol, with limits. One instance for each connection."""

    def __init__(self, limits: ConnectionLimits, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._limits = limits
        self._address = ""
        self._timer: asyncio.TimerHandle | None = None
        self._stuck: asyncio.TimerHandle | None = None
        self._in_head, self._head_bytes = True, 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._address = self.client[0] if self.client else ""
        if self._limits.enter(self._address):
            self._expect_head()
        else:
            detail = say("address_has_too_many_open")
            headers = {"Retry-After": str(RETRY_S)}
            self._refuse(Problem(429, "CONNECTIONS_LIMITED", detail, retryable=True, headers=headers))

    def connection_lost(self, exc: Exception | None) -> None:
        self._limits.leave(self._address)
        self._stop_timer()
        self._go_on()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self.transport.is_closing():
            return  # refused: what still arrives is not read
        if self._in_head:
            self._head_bytes += len(data)
            self._expect_head()
        super().data_received(data)
        if self._in_head and self._head_bytes > MAX_HEAD_BYTES and not self.transport.is_closing():
            self._refuse(head_too_large())

    def on_headers_complete(self) -> None:
        self._in_head, self._head_bytes = False, 0
        self._stop_timer()
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        self._in_head = True  # of the next request: its time begins with its first byte
        super().on_message_complete()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stuck = self.loop.call_later(_STUCK_S, self._abort)

    def resume_writing(self) -> None:
        self._go_on()
        super().resume_writing()

    def _abort(self) -> None:
        self._limits.on_refused("ANSWER_NOT_READ")
        self.transport.abort()

    def _go_on(self) -> None:
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None

    def _expect_head(self) -> None:
        if self._timer is None:
            self._timer = self.loop.call_later(_HEAD_S, self._time_out)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _time_out(self) -> None:
        if not self._head_bytes:  # opened in advance, and never used
            self.transport.close()
            return
        detail = say("request_headers_did_not_arrive", seconds=_HEAD_S)
        self._refuse(Problem(408, "REQUEST_SILENT", detail, retryable=True))

    def _refuse(self, problem: Problem) -> None:
        """Answer a request that never was one, and close the connection; only that while another answer is sent."""
        self._limits.on_refused(problem.code)
        if self.cycle is not None and not self.cycle.response_complete:
            self.transport.close()
            return
        body = json.dumps(with_codes(problem.document())).encode()
        headers = {
            "Content-Type": MEDIA_TYPE,
            "Content-Length": str(len(body)),
            "Connection": "close",
            **problem.headers,
        }
        lines = [f"HTTP/1.1 {problem.status} {problem.title}", *(f"{name}: {each}" for name, each in headers.items())]
        self.transport.write("\r\n".join([*lines, "", ""]).encode() + body)
        self.transport.close()


def head_too_large() -> Problem:
    """Return the problem for a request whose line and headers are too large."""
    detail = say("request_line_headers_too_large", most=MAX_HEAD_BYTES)
    return Problem(431, "HEADERS_TOO_LARGE", detail, hints=(say("send_fewer_smaller_headers_delete"),))
