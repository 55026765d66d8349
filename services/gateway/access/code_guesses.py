"""Limit how often six-digit codes may be tried: per address, and in all."""

from __future__ import annotations

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter
from starlette.requests import Request

from services.gateway.errors import Problem

_OF_ADDRESS = RateLimitItemPerMinute(5)
# In the five minutes that a code lives, strangers together try one in seven thousand of all.
_OF_ALL = RateLimitItemPerMinute(30)


class CodeGuesses:
    """Counts the codes that this process is asked about."""

    def __init__(self) -> None:
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())

    def spend(self, request: Request) -> None:
        """Count a try. Raises Problem CODE_GUESSES_LIMITED where there were too many within a minute."""
        address = request.client.host if request.client else ""
        if self._limiter.hit(_OF_ADDRESS, "code", address) and self._limiter.hit(_OF_ALL, "code"):
            return
        detail = "too many codes were tried within a minute"
        hints = ("wait a minute", "or scan the QR code")
        headers = {"Retry-After": "60"}
        raise Problem(429, "CODE_GUESSES_LIMITED", detail, retryable=True, hints=hints, headers=headers)
