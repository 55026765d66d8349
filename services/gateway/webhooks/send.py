"""Send one webhook message: to an address of the internet that is looked up once, with a signature and a time limit.

A tenant names the URL, so it could name the gateway's own network (server-side request forgery). The host's addresses
are looked up here, private ones are refused, and the request goes to the very address that was checked: a name that
resolves differently a moment later (DNS rebinding) changes nothing. Redirects are not followed.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property

import httpx
from standardwebhooks import Webhook

import capture2vr
from capture2vr.gateway.webhooks.outbox import Delivery

TIMEOUT_S = 15.0
"""Seconds for a whole attempt, from the look-up to the answer."""
_ANSWER_BYTES = 1_000  # of an answer that are read: they are only shown to the tenant
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")  # RFC 6052
_UNICAST = ipaddress.IPv6Network("2000::/3")  # all that IANA has assigned to the internet; not old local addresses
_LAST_PORT = 65_535
_LONGEST_WAIT_S = 86_400.0  # that a receiver may ask for


class UrlRefused(Exception):  # noqa: N818 - of the receiver's address, not a fault of ours
    """A URL that no message is sent to."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an attempt. gone: the receiver wants no more; wait_s: the least time that it asked to wait"""

    delivered: bool
    answer: str
    gone: bool = False
    wait_s: float = 0.0


class Sender:
    """Sends messages. allow_private: also to addresses that are not of the internet, and without TLS"""

    def __init__(self, *, allow_private: bool) -> None:
        self._allow_private = allow_private

    @cached_property
    def _client(self) -> httpx.AsyncClient:
        """Made for the first message: to read the certificates takes 40 ms, and most gateways send none."""
        return httpx.AsyncClient(
            # Not HTTPX's own certificates: the system's, to which operators add theirs.
            verify=ssl.create_default_context(),
            trust_env=False,
            follow_redirects=False,
            timeout=TIMEOUT_S,
            # Connections are pooled by address: one that was opened for another host there must not be used again.
            limits=httpx.Limits(max_keepalive_connections=0),
        )

    async def close(self) -> None:
        """Close the connections."""
        if "_client" in self.__dict__:
            await self._client.aclose()

    async def send(self, delivery: Delivery) -> Outcome:
        """Make one attempt."""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                return await self._send(delivery)
        except TimeoutError:
            return Outcome(delivered=False, answer=f"no answer within {TIMEOUT_S:g} s")
        except (UrlRefused, httpx.HTTPError, OSError, ssl.SSLError) as error:
            return Outcome(delivered=False, answer=str(error) or type(error).__name__)

    async def check(self, url: str) -> None:
        """Raises UrlRefused for a URL that no message would be sent to now."""
        await self._address(httpx.URL(url))

    async def _send(self, delivery: Delivery) -> Outcome:
        url = httpx.URL(delivery.url)
        address = await self._address(url)
        message, now = delivery.message, datetime.now(UTC)
        signatures = (Webhook(secret).sign(message.id, now, message.payload) for secret in delivery.secrets)
        headers = {
            "Host": url.netloc.decode("ascii"),
            "Content-Type": "application/json",
            "User-Agent": f"capture2vr/{capture2vr.__version__}",
            "webhook-id": message.id,
            "webhook-timestamp": str(int(now.timestamp())),
            "webhook-signature": " ".join(signatures),
        }
        pinned = url.copy_with(host=address)
        extensions = {"sni_hostname": url.host}  # the certificate must be the host's, not the address's
        content = message.payload.encode()
        async with self._client.stream(
            "POST", pinned, content=content, headers=headers, extensions=extensions
        ) as response:
            return _outcome(response, await _beginning(response))

    async def _address(self, url: httpx.URL) -> str:
        """Return the address to connect to. Raises UrlRefused, OSError where the host has none."""
        if url.scheme != "https" and not (url.scheme == "http" and self._allow_private):
            raise UrlRefused("the URL must begin with https://")
        _check_host(url)
        port = {"http": 80, "https": 443}[url.scheme] if url.port is None else url.port
        if not 0 < port <= _LAST_PORT:  # the look-up of an address takes any number, the connection does not
            raise UrlRefused(f"the URL's port must be 1 to {_LAST_PORT}")
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(url.host, port, type=socket.SOCK_STREAM)
        except UnicodeError:  # of a label that is empty, or longer than 63 letters
            raise UrlRefused(f"{url.host[:80]} is not a host's name") from None
        addresses = list(dict.fromkeys(str(entry[4][0]) for entry in found))
        # All of them: a host with one private address among others is no receiver of the internet.
        if not self._allow_private and not all(map(is_public, addresses)):
            raise UrlRefused(f"{url.host} is not an address of the internet")
        return addresses[0]


def _check_host(url: httpx.URL) -> None:
    """Raises UrlRefused for a URL without a host, or with a user."""
    try:
        named = bool(url.host) and not url.userinfo
    except UnicodeError:  # of a label that begins as encoded letters, and is none
        raise UrlRefused("the URL's host is not a host's name") from None
    if not named:
        raise UrlRefused("the URL must name a host, and no user")


def is_public(address: str) -> bool:
    """Return whether an address is one of the internet: not private, loopback, link-local, shared or reserved."""
    parsed = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(parsed, ipaddress.IPv6Address):
        if parsed in _NAT64:  # how a network without IPv4 reaches an address of it
            return is_public(str(ipaddress.IPv4Address(int(parsed) & 0xFFFFFFFF)))
        inner = parsed.sixtofour or (parsed.teredo[1] if parsed.teredo else None)
        if parsed not in _UNICAST or (inner is not None and not is_public(str(inner))):
            return False
    return parsed.is_global and not parsed.is_multicast


async def _beginning(response: httpx.Response) -> str:
    """Read the beginning of an answer; a receiver may send for ever."""
    text = b""
    async for block in response.aiter_raw():
        text += block
        if len(text) >= _ANSWER_BYTES:
            break
    return text[:_ANSWER_BYTES].decode("utf-8", "replace")


def _outcome(response: httpx.Response, text: str) -> Outcome:
    readable = "".join(letter if letter.isprintable() else " " for letter in text).strip()
    answer = f"{response.status_code} {readable}".strip()
    wait = response.headers.get("retry-after", "")
    wait_s = min(float(wait), _LONGEST_WAIT_S) if wait.isascii() and wait.isdigit() else 0.0
    return Outcome(response.is_success, answer, gone=response.status_code == 410, wait_s=wait_s)
