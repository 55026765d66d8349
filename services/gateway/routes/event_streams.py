"""Answers of server-sent events: how they are sent, and how a stream waits for news."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Annotated

from fastapi import Header
from sse_starlette import EventSourceResponse, ServerSentEvent

HEARTBEAT_S = 10.0
"""Longest silence on an event stream: proxies cut silent connections after 30 to 60 s."""
RECONNECT_MS = 1000
"""How long browsers wait before they reconnect."""
_SEND_TIMEOUT_S = 30.0  # a client that reads nothing for so long is considered gone

LastEventId = Annotated[
    str, Header(pattern=r"^[0-9]{0,15}$", description="Same as `after`; browsers send it when they reconnect.")
]
"""Parameter `last_event_id` of a route that sends numbered events."""


def known_event(after: int | None, last_event_id: str) -> int:
    """Return the number of the newest event that a client knows: a stream goes on behind it. 0: it knows none."""
    return int(last_event_id) if last_event_id else after or 0


def stream_events(
    events: AsyncIterator[ServerSentEvent], headers: Mapping[str, str] | None = None
) -> EventSourceResponse:
    """Return the answer that sends these events."""
    return EventSourceResponse(
        events,
        ping=3600,  # in effect off: our own heartbeats are visible to pages
        send_timeout=_SEND_TIMEOUT_S,
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no", **(headers or {})},
    )
