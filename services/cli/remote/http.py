"""HTTP client of the command line for requests to a gateway."""

from __future__ import annotations

import os
from collections.abc import Generator

import httpx

from capture2vr.cli.errors import BadInput

API_KEY_VARIABLE = "CAPTURE2VR_KEY"
"""Environment variable of the access key: on a command line everybody on the machine could read it."""
_TIMEOUT = httpx.Timeout(30.0)
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def client_of(gateway: str, *, timeout: httpx.Timeout = _TIMEOUT, follow_redirects: bool = False) -> httpx.Client:
    """Create an HTTP client for this gateway, which gets the access key in CAPTURE2VR_KEY, if there is one.

    Proxies of the environment are not used for the local machine. Raises BadInput for a key that cannot be sent.
    """
    direct: dict[str, httpx.BaseTransport | None] = {f"all://{host}": None for host in _LOOPBACK}
    key = os.environ.get(API_KEY_VARIABLE, "").strip()
    if not key.isascii() or not key.isprintable():
        raise BadInput(f"{API_KEY_VARIABLE} is not an access key: it reads c2v_TENANT_…")
    return httpx.Client(
        base_url=gateway,
        timeout=timeout,
        follow_redirects=follow_redirects,
        mounts=direct,
        auth=_KeyForGateway(httpx.URL(gateway), key) if key else None,
    )


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
