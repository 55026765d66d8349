"""HTTP client for requests to a gateway: it sends the access key to the gateway alone, and translates errors."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager

import httpx

from capture2vr.client.answers import understood
from capture2vr.errors import BadInput, GatewayError

API_KEY_VARIABLE = "CAPTURE2VR_KEY"
"""Environment variable of the access key: on a command line everybody on the machine could read it."""
_TIMEOUT = httpx.Timeout(30.0)
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def client_of(
    gateway: str, *, key: str | None = None, timeout: httpx.Timeout = _TIMEOUT, follow_redirects: bool = False
) -> httpx.Client:
    """Create an HTTP client for this gateway. Raises BadInput for a key that cannot be sent.

    key  access key; "": none; None: the one in CAPTURE2VR_KEY, if there is one
    Proxies of the environment are not used for the local machine.
    """
    direct: dict[str, httpx.BaseTransport | None] = {f"all://{host}": None for host in _LOOPBACK}
    key = os.environ.get(API_KEY_VARIABLE, "").strip() if key is None else key
    if not key.isascii() or not key.isprintable():
        raise BadInput(f"{API_KEY_VARIABLE} is not an access key: it reads c2v_TENANT_…")
    return httpx.Client(
        base_url=gateway,
        timeout=timeout,
        follow_redirects=follow_redirects,
        mounts=direct,
        auth=_KeyForGateway(httpx.URL(gateway), key) if key else None,
    )


@contextmanager
def open_gateway(
    gateway: str, *, timeout: httpx.Timeout = _TIMEOUT, follow_redirects: bool = False
) -> Iterator[httpx.Client]:
    """Open an HTTP client as `client_of` does, for a command.

    Raises GatewayError, also in the block, where nothing answers, or nothing that can be read as a gateway's answer.
    """
    with (
        reaching(gateway),
        understood("one of a gateway"),
        client_of(gateway, timeout=timeout, follow_redirects=follow_redirects) as client,
    ):
        yield client


@contextmanager
def reaching(gateway: str) -> Iterator[None]:
    """Raise GatewayError for requests of the block that get no answer, and for a URL that is none."""
    try:
        yield
    except (httpx.RequestError, httpx.InvalidURL) as error:
        raise GatewayError(f"{gateway} cannot be reached: {error}", retryable=True) from error


class _KeyForGateway(httpx.Auth):
    """Sends the access key to the gateway's origin, and to no other server that its answers name."""

    def __init__(self, gateway: httpx.URL, key: str) -> None:
        self._origin = _origin(gateway)
        self._key = key

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        if _origin(request.url) == self._origin:
            request.headers["Authorization"] = f"Bearer {self._key}"
        yield request


def _origin(url: httpx.URL) -> tuple[str, str, int | None]:
    return url.scheme, url.host, url.port
