"""Limit tries of six-digit codes, and of passwords of shares: per address, and in all, of each share for itself."""

from __future__ import annotations

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter
from starlette.requests import Request

from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say

_OF_ADDRESS = RateLimitItemPerMinute(5)
# In the five minutes that a code lives, strangers together try one in seven thousand of all.
_OF_ALL = RateLimitItemPerMinute(30)
_WORDS = {"code": say("word_code"), "password": say("word_password")}


class Guesses:
    """Counts the codes, or the passwords, that this process is asked about. what: "code" or "password" """

    def __init__(self, what: str) -> None:
        self._what = what
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())

    def spend(self, request: Request, of: str = "") -> None:
        """Count a try. Raises Problem CODE_GUESSES_LIMITED, PASSWORD_GUESSES_LIMITED: too many within a minute.

        of  id of the share whose password is tried, so that who tries those of one keeps nobody from the others
        """
        address = request.client.host if request.client else ""
        if self._limiter.hit(_OF_ADDRESS, self._what, address) and self._limiter.hit(_OF_ALL, self._what, of):
            return
        detail = say("too_many_s_tried_within", what=_WORDS[self._what])
        hints = (say("wait_minute"),)
        headers = {"Retry-After": "60"}
        raise Problem(
            429, f"{self._what.upper()}_GUESSES_LIMITED", detail, retryable=True, hints=hints, headers=headers
        )
