"""HTTP client of the command line for requests to a gateway."""

from __future__ import annotations

import httpx

_TIMEOUT = httpx.Timeout(30.0)
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def client_of(gateway: str, *, timeout: httpx.Timeout = _TIMEOUT, follow_redirects: bool = False) -> httpx.Client:
    """Create an HTTP client for this gateway. Proxies of the environment are not used for the local machine."""
    direct: dict[str, httpx.BaseTransport | None] = {f"all://{host}": None for host in _LOOPBACK}
    return httpx.Client(base_url=gateway, timeout=timeout, follow_redirects=follow_redirects, mounts=direct)
