"""Tell this machine's own addresses from those of others."""

from __future__ import annotations

import ipaddress


def is_own(address: str) -> bool:
    """Return whether an address is this machine's own, for which limits of addresses do not hold."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:  # a test client's or a Unix socket's name
        return True
