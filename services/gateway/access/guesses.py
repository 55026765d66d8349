"""Limit tries of pairing codes and of passwords of shares: per network, and of a password per share as well."""

from __future__ import annotations

import ipaddress

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter
from starlette.requests import Request

from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say

_OF_NETWORK = RateLimitItemPerMinute(5)
_OF_SHARE = RateLimitItemPerMinute(30)
_IPV6_NETWORK = 64  # bits: what a provider gives to one customer, who has all addresses in it
_WORDS = {"code": say("word_code"), "password": say("word_password")}


class Guesses:
    """Counts the codes, or the passwords, that this process is asked about. what: "code" or "password"

    Codes have no limit for all networks together, nor for a pairing: strangers could use it up and so keep everybody
    from pairing, and a wrong code belongs to no pairing. What protects them is their length. Of the 10^10 codes of ten
    digits a network tries 25 in the five minutes that one lives: 60 networks hit a given pairing once in 6.7 million,
    10,000 of them once in 40,000, and who keeps a gateway busy with nothing else, at 2,000 tries a second, once in
    16,000 pairings.

    Passwords are chosen by people, and guessed by who has the share's link: there a share has a limit in all.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())

    def spend(self, request: Request, share: str = "") -> None:
        """Count a try. Raises Problem CODE_GUESSES_LIMITED, PASSWORD_GUESSES_LIMITED: too many within a minute.

        share  id of the share whose password is tried; "" for a code
        """
        network = _network(request.client.host if request.client else "")
        if self._limiter.hit(_OF_NETWORK, self._what, network) and (
            not share or self._limiter.hit(_OF_SHARE, self._what, share)
        ):
            return
        detail = say("too_many_s_tried_within", what=_WORDS[self._what])
        hints = (say("wait_minute"),)
        headers = {"Retry-After": "60"}
        raise Problem(
            429, f"{self._what.upper()}_GUESSES_LIMITED", detail, retryable=True, hints=hints, headers=headers
        )


def _network(address: str) -> str:
    """Return the network that is counted for an address: itself, or the 64 bits of an IPv6 customer."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:  # a test client's or a Unix socket's name
        return address
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped:
            return str(found.ipv4_mapped)
        return str(ipaddress.IPv6Network((int(found), _IPV6_NETWORK), strict=False))
    return str(found)
