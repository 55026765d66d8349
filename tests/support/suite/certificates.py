"""Reads the machine's certificates once: HTTPX does for each client, 40 ms, and a test of the gateway has four."""

from __future__ import annotations

import os
import ssl
from functools import cache
from typing import Any

import pytest
from httpx._transports import default

_make = default.create_ssl_context


@cache
def _usual() -> ssl.SSLContext:
    return _make()


def _shared(verify: Any = True, cert: Any = None, trust_env: bool = True) -> ssl.SSLContext:
    """HTTPX's function, with one answer for all clients that ask for nothing of their own."""
    is_usual = verify is True and cert is None and not {"SSL_CERT_FILE", "SSL_CERT_DIR"} & os.environ.keys()
    return _usual() if is_usual else _make(verify, cert, trust_env)


def pytest_configure(config: pytest.Config) -> None:
    """Put it in the place of HTTPX's."""
    default.create_ssl_context = _shared
