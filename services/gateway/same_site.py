"""Refuse requests that another web site makes through a visitor's browser.

Two ways in: a page elsewhere sends a form or a script's request here (cross-site request forgery), or its own host name
is made to resolve to this machine, so that the browser takes the gateway for that site (DNS rebinding). The first is
told by the headers that browsers add to requests (F. Valsorda 2025, "Cross-Site Request Forgery"), the second by the
`Host` header.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Collection
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.sentences.sentence import say

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_OWN_SITE = frozenset({"same-origin", "none"})  # "none": typed, or opened from a bookmark
# Names that no stranger can have: multicast DNS stays on the local network, and localhost on this machine.
_LOCAL_SUFFIXES = (".local", ".localhost")
_NAME = re.compile(r"[A-Za-z0-9._-]+", re.ASCII)


@dataclass(frozen=True, slots=True)
class SiteRules:
    """Hosts by which this gateway is known, and origins of other sites that may change things; "*" is any."""

    hosts: Collection[str]
    origins: Collection[str]

    @classmethod
    def of(cls, settings: GatewaySettings) -> SiteRules:
        """Build the rules from the settings: allowed hosts, the public URL's host and this machine's name."""
        public = urlsplit(settings.public_url).hostname or ""
        hosts = {*(host.lower() for host in settings.allowed_hosts), public, socket.gethostname().lower()}
        return cls(hosts, settings.cors_origins)

    def check(self, method: str, headers: Headers) -> None:
        """Raises Problem HOST_UNKNOWN for a host that is not ours, CROSS_SITE for a change by another site's page."""
        self._check_host(headers.get("host", ""))
        if method not in _SAFE_METHODS:
            self._check_origin(headers)

    def _check_host(self, host: str) -> None:
        name = _host_name(host)
        if not host or "*" in self.hosts or name in self.hosts or _is_nobodys(name):
            return
        raise Problem(
            421,
            "HOST_UNKNOWN",
            say("gateway_does_not_answer_host", name=name[:100]),
            hints=(
                say("use_address"),
                say("operator_can_add_name"),
            ),
        )

    def _check_origin(self, headers: Headers) -> None:
        origin, site = headers.get("origin", ""), headers.get("sec-fetch-site", "")
        if "*" in self.origins or origin in self.origins:
            return
        # Browsers before 2023 send only Origin. A client that is no browser sends neither, and nobody can make it.
        own = site in _OWN_SITE if site else not origin or _authority(origin) == headers.get("host", "").lower()
        if not own:
            raise Problem(
                403,
                "CROSS_SITE",
                say("another_web_site_asked_change"),
                hints=(say("use_gateway_own_pages"), say("operator_can_add_site")),
            )


def _host_name(host: str) -> str:
    """Return the name in a Host header without its port, in lower case; the header itself where it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname or host
    except ValueError:
        return host


def _authority(origin: str) -> str:
    return origin.partition("://")[2].lower()


def _is_nobodys(name: str) -> bool:
    """Return whether a host is local (an IP address, a name without a dot, .local), so that no web site can own it.

    Other characters than those of names may be read as a dot elsewhere, as those of Chinese and Japanese are.
    """
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return _NAME.fullmatch(name) is not None and ("." not in name or name.endswith(_LOCAL_SUFFIXES))
    return True
